#include "envserver/env_service.h"

#include <grpc/grpc.h>

#include <algorithm>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/io/texture_digest.h"
#include "common/wire/access.h"
#include "common/wire/status_service.h"
#include "envserver/canary.h"

namespace craftfleet {
namespace {

// A session without games that has at least so many bytes, for the tables of large pictures, makes room when it ends.
constexpr int64_t kWorthEnding = 1 << 20;

}  // namespace

absl::StatusOr<std::unique_ptr<EnvServiceImpl>> EnvServiceImpl::Create(const std::string& texture_dir) {
  return Create(texture_dir, {});
}

absl::StatusOr<std::unique_ptr<EnvServiceImpl>> EnvServiceImpl::Create(const std::string& texture_dir,
                                                                       const Options& options) {
  CRAFTFLEET_RETURN_IF_ERROR(options.budget.Validate());
  std::shared_ptr<const Textures> textures;
  std::string digest;
  if (texture_dir.empty()) {
    textures = Textures::BuiltIn();
    digest = TextureDigest(BuiltInTextures());
  } else {
    CRAFTFLEET_ASSIGN_OR_RETURN(textures, Textures::Load(texture_dir));
    CRAFTFLEET_ASSIGN_OR_RETURN(digest, TextureDigest(texture_dir));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string canary, GameCanary(*textures));
  return std::unique_ptr<EnvServiceImpl>(
      new EnvServiceImpl(std::move(textures), std::move(digest), std::move(canary), options));
}

EnvServiceImpl::EnvServiceImpl(std::shared_ptr<const Textures> textures, std::string texture_digest, std::string canary,
                               const Options& options)
    : textures_(std::move(textures)),
      texture_digest_(std::move(texture_digest)),
      canary_(std::move(canary)),
      options_(options),
      budget_(options.budget, [this](const std::string* client) { EndIdlest(client); }),
      game_threads_(options.game_threads),
      slow_threads_(options.game_threads) {}

void EnvServiceImpl::SetRun(absl::string_view run_id) {
  const MutexLock lock(&mu_);
  own_run_id_ = std::string(run_id);
}

std::string EnvServiceImpl::ClientOf(const grpc::ServerContextBase& context) const {
  std::string identity = wire::Identify(context);
  return identity.empty() ? wire::ClientOfPeer(context.peer()) : identity;
}

bool EnvServiceImpl::IsBoundLocked() const {
  return std::any_of(sessions_.begin(), sessions_.end(),
                     [](const Session* session) { return !session->run_id.empty(); });
}

void EnvServiceImpl::EndIdlest(const std::string* client) {
  const MutexLock lock(&mu_);
  const Session* idlest = nullptr;
  int64_t idlest_since = std::numeric_limits<int64_t>::max();
  for (const Session* session : sessions_) {
    if (client != nullptr && session->share->client() != *client) continue;
    const int64_t since = session->idle_since;
    const bool frees_room = session->lanes > 0 || session->bytes >= kWorthEnding;
    if (!frees_room || since == 0 || since >= idlest_since) continue;
    idlest = session;
    idlest_since = since;
  }
  if (idlest == nullptr) return;
  const absl::Duration idle = SteadyNow() - absl::FromUnixNanos(idlest_since);
  if (idle < options_.gives_way) return;
  const std::string reason = absl::StrFormat("sent nothing for %s while others need room for games",
                                             absl::FormatDuration(absl::Trunc(idle, absl::Milliseconds(1))));
  log_.Warn("idle", absl::StrFormat("session of %s ended: it %s", idlest->address, reason));
  // TryCancel() cannot pass a reason.
  grpc_call_cancel_with_status(idlest->context->c_call(), GRPC_STATUS_RESOURCE_EXHAUSTED,
                               absl::StrCat("this session ", reason).c_str(), nullptr);
}

void EnvServiceImpl::WaitUntilEmpty(absl::Duration timeout) {
  const MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    for (const Session* session : sessions_) {
      if (session->lanes > 0) return false;
    }
    return true;
  });
}

Work EnvServiceImpl::TotalWorkLocked() const {
  Work work = ended_;
  for (const Session* session : sessions_) work.Add(session->meter.Total());
  return work;
}

v1::ProcessSummary EnvServiceImpl::Summary() const {
  const MutexLock lock(&mu_);
  return SummaryLocked();
}

v1::ProcessSummary EnvServiceImpl::SummaryLocked() const {
  v1::ProcessSummary summary;
  Work recent;
  int lanes = 0;
  for (const Session* session : sessions_) {
    recent.Add(session->meter.Recent());
    lanes += session->lanes;
  }
  summary.set_lanes(lanes);
  summary.set_policy_version(-1);
  wire::FillWork(TotalWorkLocked(), recent, static_cast<int>(sessions_.size()), &summary);
  wire::FillUsage(&summary);
  return summary;
}

v1::ProcessSummary EnvServiceImpl::RecentSummary() {
  const MutexLock lock(&mu_);
  if (clock_.Now() - summarized_ >= kSummarizeEvery) {
    summarized_ = clock_.Now();
    recent_summary_ = SummaryLocked();
  }
  return recent_summary_;
}

void EnvServiceImpl::FillStatus(v1::StatusReply* reply) const {
  const MutexLock lock(&mu_);
  reply->set_run_id(run_id_);
  for (const Session* session : sessions_) {
    v1::Peer* peer = reply->add_peers();
    peer->set_name(session->name);
    peer->set_role("actor");
    peer->set_address(session->address);
    peer->set_state(absl::StrFormat("%d lanes", session->lanes));
  }
  *reply->mutable_summary() = SummaryLocked();
  wire::AddMetric("sessions", static_cast<double>(sessions_.size()), reply);
  wire::AddMetric("sessions_rejected", static_cast<double>(rejected_.load()), reply);
  wire::AddMetric("env_steps", static_cast<double>(TotalWorkLocked().done), reply);
  wire::AddMetric("games_memory", static_cast<double>(budget_.bytes()), reply);
  wire::AddMetric("episodes", static_cast<double>(episodes_.load()), reply);
}

}  // namespace craftfleet
