#include "actor/env_directory.h"

#include <netdb.h>
#include <resolv.h>
#include <sys/socket.h>

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>
#include <absl/time/time.h>

#include "common/base/numeric_host.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLookUpEvery = absl::Seconds(3);
constexpr char kListed[] = "listed";
constexpr char kRegistry[] = "learner";
constexpr absl::string_view kDnsPrefix = "dns:";

// Resolves host:port to addresses in gRPC's notation. NotFound: none; gives the reason.
absl::StatusOr<std::vector<std::string>> LookUp(const std::string& host, const std::string& port) {
  addrinfo hints = {};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int error = getaddrinfo(host.c_str(), port.c_str(), &hints, &found); error != 0) {
    return absl::NotFoundError(absl::StrCat("--envservers: no address for ", host, ": ", gai_strerror(error)));
  }
  std::set<std::string> addresses;
  for (const addrinfo* entry = found; entry != nullptr; entry = entry->ai_next) {
    const std::string numeric = NumericHost(entry->ai_addr);
    if (numeric.empty()) continue;
    addresses.insert(entry->ai_family == AF_INET6 ? absl::StrCat("[", numeric, "]:", port)
                                                  : absl::StrCat(numeric, ":", port));
  }
  freeaddrinfo(found);
  return std::vector<std::string>(addresses.begin(), addresses.end());
}

}  // namespace

EnvDirectory::EnvDirectory(std::vector<wire::Endpoint> servers) {
  for (wire::Endpoint& server : servers) {
    std::string address = server.address;
    servers_.emplace(std::move(address), std::move(server));
  }
}

absl::StatusOr<std::shared_ptr<EnvDirectory>> EnvDirectory::Parse(absl::string_view flag, absl::string_view list,
                                                                  const wire::ChannelSecurity& security) {
  const std::vector<std::string> entries = absl::StrSplit(list, ',', absl::SkipWhitespace());
  if (entries.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("--", flag, " is empty, want HOST:PORT, dns:HOST:PORT or learner, more of them after commas"));
  }
  std::shared_ptr<EnvDirectory> directory(new EnvDirectory(security));
  std::vector<std::string> listed;
  for (const std::string& entry : entries) {
    absl::string_view address = entry;
    if (entry == kRegistry) {
      directory->uses_registry_ = true;
    } else if (absl::ConsumePrefix(&address, kDnsPrefix)) {
      // The address of a Unix socket has no name.
      if (absl::StartsWith(address, wire::kUnix) || !wire::CheckAddress(flag, address).ok()) {
        return absl::InvalidArgumentError(
            absl::StrFormat("--%s: \"%s\" is not an address, want dns:HOST:PORT", flag, entry));
      }
      const size_t colon = address.rfind(':');
      directory->names_.push_back({WithoutBrackets(address.substr(0, colon)), std::string(address.substr(colon + 1))});
    } else {
      CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress(flag, entry));
      listed.push_back(entry);
    }
  }
  directory->Replace(kListed, std::move(listed));
  if (!directory->names_.empty()) {
    directory->resolver_ = std::thread([raw = directory.get()] { raw->KeepLookingUp(); });
  }
  return directory;
}

EnvDirectory::~EnvDirectory() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
  }
  if (resolver_.joinable()) resolver_.join();
}

void EnvDirectory::SetRegistered(std::vector<std::string> addresses) { Replace(kRegistry, std::move(addresses)); }

std::vector<wire::Endpoint> EnvDirectory::Servers() const {
  const MutexLock lock(&mu_);
  std::vector<wire::Endpoint> servers;
  for (const auto& [address, server] : servers_) servers.push_back(server);
  return servers;
}

void EnvDirectory::KeepLookingUp() {
  // A name server that does not answer must not delay shutdown: two attempts of one second.
  res_init();
  _res.retrans = 1;
  _res.retry = 2;
  std::map<std::string, std::string> last_errors;  // by source
  while (true) {
    for (const Name& name : names_) {
      const std::string source = absl::StrCat(kDnsPrefix, name.host, ":", name.port);
      std::string& last_error = last_errors[source];
      absl::StatusOr<std::vector<std::string>> addresses = LookUp(name.host, name.port);
      // If a name can't be looked up, its last addresses remain valid.
      if (addresses.ok()) {
        Replace(source, *std::move(addresses));
        last_error.clear();
      } else if (last_error != addresses.status().message()) {
        last_error = std::string(addresses.status().message());
        LogWarning("%s; trying again every %s", last_error, absl::FormatDuration(kLookUpEvery));
      }
    }
    const MutexLock lock(&mu_);
    changed_.WaitFor(&mu_, kLookUpEvery, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_; });
    if (stopping_) return;
  }
}

void EnvDirectory::Replace(const std::string& source, std::vector<std::string> addresses) {
  std::sort(addresses.begin(), addresses.end());
  const MutexLock lock(&mu_);
  if (addresses_[source] == addresses) return;
  addresses_[source] = std::move(addresses);
  std::map<std::string, wire::Endpoint> servers;
  for (const auto& [name, list] : addresses_) {
    absl::string_view host = name;
    const bool is_dns = absl::ConsumePrefix(&host, kDnsPrefix);
    const wire::ChannelSecurity security = is_dns ? security_.ForServer(host.substr(0, host.rfind(':'))) : security_;
    for (const std::string& address : list) {
      servers[address] = {address, /*channel=*/nullptr, security};
    }
  }
  servers_ = std::move(servers);
  ++generation_;
}

}  // namespace craftfleet
