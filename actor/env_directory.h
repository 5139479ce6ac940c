// The list of currently known environment servers.

#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/base/mutex.h"
#include "common/wire/channel.h"

namespace craftfleet {

// Thread-safe.
class EnvDirectory {
 public:
  // A fixed list.
  explicit EnvDirectory(std::vector<wire::Endpoint> servers);

  // Parses `list`, the value of flag `flag`: entries joined by commas.
  //   HOST:PORT, unix:PATH   a server
  //   dns:HOST:PORT          one server at each address of the name, which is resolved again every few seconds
  //   learner                the servers registered with the learner
  //   InvalidArgument: an entry has none of these forms; names it.
  // With TLS, certificates must have the name of the dns: entry.
  static absl::StatusOr<std::shared_ptr<EnvDirectory>> Parse(absl::string_view flag, absl::string_view list,
                                                             const wire::ChannelSecurity& security = {});
  ~EnvDirectory();

  // Whether the list includes the servers registered with the learner.
  bool uses_registry() const { return uses_registry_; }
  // Whether the list never changes.
  bool fixed() const { return !uses_registry_ && names_.empty(); }
  // Sets the addresses of the servers registered with the learner.
  void SetRegistered(std::vector<std::string> addresses) ABSL_LOCKS_EXCLUDED(mu_);

  // The servers, ordered by address. Only endpoints given to the constructor may have channels; EnvClient connects.
  std::vector<wire::Endpoint> Servers() const ABSL_LOCKS_EXCLUDED(mu_);
  // A number that changes whenever Servers() changes.
  int64_t generation() const { return generation_; }

 private:
  struct Name {
    std::string host;
    std::string port;
  };

  explicit EnvDirectory(const wire::ChannelSecurity& security) : security_(security) {}
  // Resolves names until destruction.
  void KeepLookingUp() ABSL_LOCKS_EXCLUDED(mu_);
  // Replaces the addresses of `source`.
  void Replace(const std::string& source, std::vector<std::string> addresses) ABSL_LOCKS_EXCLUDED(mu_);

  const wire::ChannelSecurity security_;
  bool uses_registry_ = false;
  std::vector<Name> names_;

  mutable Mutex mu_;
  CondVar changed_;
  std::map<std::string, std::vector<std::string>> addresses_ ABSL_GUARDED_BY(mu_);  // by source
  std::map<std::string, wire::Endpoint> servers_ ABSL_GUARDED_BY(mu_);              // by address
  std::atomic<int64_t> generation_{1};
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread resolver_;
};

}  // namespace craftfleet
