#include "actor/learner_replies.h"

#include <limits>
#include <set>
#include <string>

#include <absl/strings/str_format.h>

#include "actor/evaluator.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/config/config.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"

namespace craftfleet {
namespace {

using wire::kMaxCount;
constexpr int kMaxServers = 1 << 16;
constexpr int64_t kMaxSeed = std::numeric_limits<int32_t>::max();  // also of episodes, whose seeds follow from it
// A shorter lease would lapse between two requests; a longer one makes no sense.
constexpr int kMinLeaseMs = 100;
constexpr int kMaxLeaseMs = 24 * 3600 * 1000;

absl::Status CheckPermit(absl::string_view field, const v1::Permit& permit, int lanes) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount(absl::StrFormat("%s: lane", field), permit.lane(), 0, lanes - 1));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount(absl::StrFormat("%s: fragment", field), permit.fragment(), 0, kMaxCount));
  return wire::CheckCount(absl::StrFormat("%s: policy_version", field), permit.policy_version(), 0, kMaxCount);
}

absl::Status CheckEvaluation(const v1::EvaluationTask& task, int frame_size) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("evaluation.id", task.id(), 1, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("evaluation.seed", task.seed(), 0, kMaxSeed));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("evaluation.first_episode", task.first_episode(), 1, kMaxSeed));
  EvaluationOptions options;
  options.first_episode = task.first_episode();
  options.episodes = task.episodes();
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  // A policy has one frame size.
  return wire::CheckCount("evaluation.env.frame_size", task.env().frame_size(), frame_size, frame_size);
}

}  // namespace

absl::Status CheckJoinReply(v1::JoinReply* reply) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("run_id", reply->run_id()));
  if (reply->run_id().empty()) return absl::InvalidArgumentError("run_id is empty, want the run's");
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("texture_digest", reply->texture_digest()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("program_version", reply->program_version()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("game_canary", reply->game_canary()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("epoch", reply->epoch(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("lease_ms", reply->lease_ms(), kMinLeaseMs, kMaxLeaseMs));
  CRAFTFLEET_ASSIGN_OR_RETURN(*reply->mutable_config(), WithPrefix("config", ResolveRunConfig(reply->config())));
  return absl::OkStatus();
}

absl::Status CheckPermitReply(const v1::PermitRequest& request, int lanes, int frame_size,
                              const v1::PermitReply& reply) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("lost permits", reply.lost_size(), 0, request.active_size()));
  for (const v1::Permit& permit : reply.lost()) CRAFTFLEET_RETURN_IF_ERROR(CheckPermit("lost", permit, lanes));
  std::set<int> granted;
  for (const v1::Permit& permit : reply.granted()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckPermit("granted", permit, lanes));
    if (!granted.insert(permit.lane()).second) {
      return absl::InvalidArgumentError(absl::StrFormat("granted: lane %d twice, want each lane once", permit.lane()));
    }
  }
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("granted permits", reply.granted_size(), 0, request.capacity()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("env_servers", reply.env_servers_size(), 0, kMaxServers));
  for (const std::string& address : reply.env_servers()) {
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("env_servers", address));
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("env_servers", address));
  }
  return reply.has_evaluation() ? CheckEvaluation(reply.evaluation(), frame_size) : absl::OkStatus();
}

absl::Status CheckWeightsChunk(const v1::WeightsChunk& chunk, int64_t max_bytes, int64_t version, int64_t total_bytes,
                               int64_t received) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("weights: policy_version", chunk.policy_version(),
                                              version < 0 ? 0 : version, version < 0 ? kMaxCount : version));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckCount("weights of the run's agent: total_bytes", chunk.total_bytes(),
                                              version < 0 ? 1 : total_bytes, version < 0 ? max_bytes : total_bytes));
  return wire::CheckCount("weights: bytes of data received", received + static_cast<int64_t>(chunk.data().size()), 0,
                          chunk.total_bytes());
}

absl::StatusOr<LaneSnapshot> ReadSnapshot(v1::SnapshotReply* reply, int state_size) {
  CRAFTFLEET_RETURN_IF_ERROR(
      wire::CheckCount("bytes of the snapshot", static_cast<int64_t>(reply->snapshot().size()), 0, kMaxSnapshotBytes));
  return wire::FromProto(reply, state_size);
}

}  // namespace craftfleet
