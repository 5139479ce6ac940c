#include "common/wire/access.h"

#include <fnmatch.h>
#include <grpc/grpc_security_constants.h>

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include <absl/strings/ascii.h>
#include <absl/strings/escaping.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <grpcpp/security/auth_context.h>
#include <grpcpp/security/auth_metadata_processor.h>
#include <grpcpp/server_context.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/config/text_format.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"
#include "common/wire/certificates.h"
#include "common/wire/grpc_status.h"

namespace craftfleet::wire {
namespace {

constexpr size_t kMaxLogged = 120;  // bytes of text from unknown clients

struct ServiceRight {
  absl::string_view prefix;
  v1::Right right;
};
constexpr ServiceRight kRights[] = {
    {"/grpc.health.v1.Health/", v1::RIGHT_UNSPECIFIED},    {"/craftfleet.v1.StatusService/", v1::WATCH},
    {"/craftfleet.v1.LearnerService/Announce", v1::SERVE}, {"/craftfleet.v1.LearnerService/", v1::PLAY},
    {"/craftfleet.v1.EnvironmentService/", v1::PLAY},      {"/craftfleet.v1.AdminService/", v1::STEER},
};
constexpr absl::string_view kWantedRights = "want WATCH, PLAY, SERVE or STEER";

// `digest` is the digest of the caller's token; nullopt: it sent none.
bool Fits(const v1::AccessClient& client, const Caller& caller, const std::optional<std::string>& digest) {
  if (client.certificate().empty()) return digest == client.token_sha256();
  return std::any_of(caller.certificate_names.begin(), caller.certificate_names.end(), [&](const std::string& name) {
    return fnmatch(client.certificate().c_str(), name.c_str(), 0) == 0;
  });
}

std::string Escaped(absl::string_view text) { return absl::CHexEscape(text.substr(0, kMaxLogged)); }

// "craftfleet-actor/host/12 (certificate actor-1)".
std::string Describe(const Caller& caller) {
  const std::string names = Escaped(absl::StrJoin(caller.certificate_names, ", "));
  return absl::StrCat(Escaped(caller.program), names.empty() ? " (no certificate" : " (certificate ", names,
                      caller.token.has_value() ? ", a token)" : ")");
}

absl::Status CheckClient(const v1::AccessClient& client) {
  if (client.name().empty()) return absl::InvalidArgumentError("a client has no name; the log needs one");
  if (client.certificate().empty() == client.token_sha256().empty()) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "client \"%s\" has %s, want certificate for a process (\"*\": any), token_sha256 for a reader of the live page",
        client.name(),
        client.certificate().empty() ? "neither certificate nor token_sha256" : "both certificate and token_sha256"));
  }
  const std::string& digest = client.token_sha256();
  const bool hexadecimal = std::all_of(digest.begin(), digest.end(), [](char c) { return absl::ascii_isxdigit(c); });
  if (!digest.empty() && (digest.size() != 64 || !hexadecimal)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("client \"%s\": token_sha256 has %d characters, want 64 hexadecimal digits: printf %%s "
                        "\"$TOKEN\" | sha256sum",
                        client.name(), digest.size()));
  }
  if (client.right().empty()) {
    return absl::InvalidArgumentError(absl::StrFormat("client \"%s\" has no right, %s", client.name(), kWantedRights));
  }
  for (const int right : client.right()) {
    if (right != v1::RIGHT_UNSPECIFIED && v1::Right_IsValid(right)) continue;
    return absl::InvalidArgumentError(
        absl::StrFormat("client \"%s\" has right %d, %s", client.name(), right, kWantedRights));
  }
  return absl::OkStatus();
}

// The caller, from `metadata` and the certificate of `context`.
Caller MakeCaller(const std::multimap<grpc::string_ref, grpc::string_ref>& metadata, const grpc::AuthContext* context) {
  Caller caller;
  for (const char* property : {GRPC_X509_CN_PROPERTY_NAME, GRPC_X509_SAN_PROPERTY_NAME}) {
    if (context == nullptr) break;  // a context that belongs to no call
    for (const grpc::string_ref& name : context->FindPropertyValues(property)) {
      caller.certificate_names.emplace_back(name.data(), name.size());
    }
  }
  const auto agent = metadata.find("user-agent");
  if (agent != metadata.end()) caller.program = std::string(agent->second.data(), agent->second.size());
  return caller;
}

Caller CallerOf(const grpc::ServerContextBase& context) {
  return MakeCaller(context.client_metadata(), context.auth_context().get());
}

class AccessProcessor : public grpc::AuthMetadataProcessor {
 public:
  explicit AccessProcessor(std::shared_ptr<AccessControl> access) : access_(std::move(access)) {}

  bool IsBlocking() const override { return false; }

  grpc::Status Process(const InputMetadata& metadata, grpc::AuthContext* context, OutputMetadata* /*consumed*/,
                       OutputMetadata* /*response*/) override {
    absl::string_view path;
    for (const auto& [key, value] : metadata) {
      if (key == ":path") path = absl::string_view(value.data(), value.size());
    }
    return ToGrpc(access_->Check(MakeCaller(metadata, context), path));
  }

 private:
  const std::shared_ptr<AccessControl> access_;
};

}  // namespace

v1::Right RightFor(absl::string_view path) {
  for (const ServiceRight& entry : kRights) {
    if (absl::StartsWith(path, entry.prefix)) return entry.right;
  }
  return v1::STEER;
}

absl::StatusOr<v1::Access> ParseAccess(absl::string_view text, absl::string_view filename) {
  v1::Access access;
  CRAFTFLEET_RETURN_IF_ERROR(ParseTextFormat(text, filename, &access));
  // More likely an emptied or half-written file than the wish to lock everybody out.
  if (access.client().empty()) return absl::InvalidArgumentError(absl::StrCat(filename, ": it lists no client"));
  for (v1::AccessClient& client : *access.mutable_client()) {
    CRAFTFLEET_RETURN_IF_ERROR(WithPrefix(filename, CheckClient(client)));
    absl::AsciiStrToLower(client.mutable_token_sha256());
  }
  return access;
}

absl::Status CheckAccess(const v1::Access& access, const Caller& caller, absl::string_view path) {
  const v1::Right needed = RightFor(path);
  if (needed == v1::RIGHT_UNSPECIFIED) return absl::OkStatus();
  std::optional<std::string> digest;
  if (caller.token.has_value()) digest = Sha256Hex(*caller.token);
  std::vector<std::string> known;
  for (const v1::AccessClient& client : access.client()) {
    if (!Fits(client, caller, digest)) continue;
    known.push_back(client.name());
    if (std::find(client.right().begin(), client.right().end(), needed) != client.right().end()) {
      return absl::OkStatus();
    }
  }
  if (!known.empty()) {
    return absl::PermissionDeniedError(absl::StrFormat("%s: it is \"%s\" in the access file, without the right to %s",
                                                       Describe(caller), absl::StrJoin(known, "\", \""),
                                                       absl::AsciiStrToLower(v1::Right_Name(needed))));
  }
  if (caller.token.has_value()) {
    return absl::UnauthenticatedError(absl::StrFormat("%s: its token is not in the access file", Describe(caller)));
  }
  if (caller.certificate_names.empty()) {
    return absl::UnauthenticatedError(
        absl::StrFormat("%s: it sent neither a token nor a certificate with a name", Describe(caller)));
  }
  return absl::PermissionDeniedError(
      absl::StrFormat("%s: the access file has no client with this certificate", Describe(caller)));
}

absl::StatusOr<std::shared_ptr<AccessControl>> AccessControl::Create(const std::string& path) {
  std::shared_ptr<AccessControl> control(new AccessControl);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, WithPrefix("--access_file", ReadFile(path)));
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::Access access, ParseAccess(text, path));
  control->snapshot_ = std::make_shared<Snapshot>(std::move(access));
  control->watch_ = std::make_unique<FileWatch>(path, text, [snapshot = control->snapshot_, path](std::string now) {
    absl::StatusOr<v1::Access> access = ParseAccess(now, path);
    if (!access.ok()) {
      LogError("%s; the former access file remains in effect", access.status().message());
      return;
    }
    LogInfo("--access_file=%s was read again: %d clients", path, access->client_size());
    snapshot->Set(*std::move(access));
  });
  return control;
}

absl::Status AccessControl::Check(const Caller& caller, absl::string_view path) const {
  const absl::Status status = CheckAccess(*snapshot_->Get(), caller, path);
  if (status.ok()) return status;
  // By right and certificate, which callers do not choose as freely as program, token and path.
  log_.Warn(absl::StrCat(absl::StatusCodeToString(status.code()), " ", v1::Right_Name(RightFor(path)),
                         caller.token.has_value() ? " token " : " ", absl::StrJoin(caller.certificate_names, ", ")),
            absl::StrFormat("refused %s: %s", Escaped(path), status.message()));
  return absl::Status(status.code(), "not allowed; the log of the process that was called says why");
}

absl::Status AccessControl::Check(const grpc::ServerContextBase& context, absl::string_view path) const {
  return Check(CallerOf(context), path);
}

bool AccessControl::Allows(const Caller& caller, absl::string_view path) const {
  return CheckAccess(*snapshot_->Get(), caller, path).ok();
}

std::string Identify(const grpc::ServerContextBase& context) {
  const Caller caller = CallerOf(context);
  if (caller.certificate_names.empty()) return "";
  const std::set<std::string> names(caller.certificate_names.begin(), caller.certificate_names.end());
  return absl::StrCat("certificate ", absl::StrJoin(names, ", "));
}

std::shared_ptr<grpc::AuthMetadataProcessor> MakeAccessProcessor(std::shared_ptr<AccessControl> access) {
  return std::make_shared<AccessProcessor>(std::move(access));
}

}  // namespace craftfleet::wire
