#include "common/wire/handshake_log.h"

#include <grpc/support/log.h>

#include <deque>
#include <mutex>
#include <set>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/telemetry/limited_log.h"

namespace craftfleet::wire {
namespace {

constexpr absl::string_view kListenersFile = "chttp2_server.cc";  // logs handshakes with clients only
constexpr absl::string_view kFailed = "Handshaking failed: ";
constexpr size_t kMaxRecent = 8;
constexpr absl::Duration kRecent = absl::Seconds(2);

// Global, because gRPC's log function is global and has no context argument.
struct State {
  RealClock clock;
  LimitedLog log{&clock};
  Mutex mu;
  std::deque<std::pair<absl::Time, std::string>> recent ABSL_GUARDED_BY(mu);  // connections
};

State& TheState() {
  static State& state = *new State;  // never destroyed: gRPC's threads may outlive main
  return state;
}

std::string RecentClients() {
  State& state = TheState();
  const MutexLock lock(&state.mu);
  std::set<std::string> clients;
  for (const auto& [time, client] : state.recent) {
    if (SteadyNow() - time < kRecent) clients.insert(client);
  }
  return absl::StrJoin(clients, ", ");
}

void OnGrpcLog(gpr_log_func_args* line) {
  if (!absl::EndsWith(line->file, kListenersFile)) return;
  const std::string reason = ExplainHandshake(line->message);
  if (reason.empty()) return;
  const std::string clients = RecentClients();
  TheState().log.Warn(reason, absl::StrCat("TLS: refused a client: ", reason,
                                           clients.empty() ? "" : "; connected just before: " + clients));
}

}  // namespace

void LogFailedHandshakes() {
  static std::once_flag once;
  std::call_once(once, [] {
    gpr_set_log_function(OnGrpcLog);
    gpr_set_log_verbosity(GPR_LOG_SEVERITY_DEBUG);
  });
}

void NoteConnection(absl::string_view address) {
  State& state = TheState();
  const MutexLock lock(&state.mu);
  state.recent.emplace_back(SteadyNow(), std::string(address));
  if (state.recent.size() > kMaxRecent) state.recent.pop_front();
}

std::string ExplainHandshake(absl::string_view line) {
  if (!absl::StartsWith(line, kFailed)) return "";
  const struct {
    absl::string_view text;
    absl::string_view meaning;
  } meanings[] = {
      {"peer did not return a certificate", "it shows no certificate"},
      {"certificate verify failed", "its certificate has expired or is not from an authority in --tls_ca"},
      {"wrong version number", "it does not speak TLS"},
      {"http request", "it does not speak TLS but HTTP"},
      {"unknown ca", "it does not know the authority of our certificate"},
      {"certificate expired", "it says that our certificate has expired"},
      {"bad certificate", "it does not accept our certificate"},
      {"Socket closed", "it left during the handshake, as clients do that don't accept our certificate"},
      {"imed out", "it did not finish the handshake in time"},
  };
  for (const auto& entry : meanings) {
    if (absl::StrContains(line, entry.text)) return std::string(entry.meaning);
  }
  constexpr absl::string_view kRoutines = "SSL routines::";
  const size_t begin = line.find(kRoutines);
  if (begin == absl::string_view::npos) return "the handshake failed";
  const absl::string_view reason = line.substr(begin + kRoutines.size());
  return std::string(reason.substr(0, reason.find(" {")));
}

}  // namespace craftfleet::wire
