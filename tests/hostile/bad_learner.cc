#include "tests/hostile/bad_learner.h"

#include <algorithm>
#include <limits>
#include <string>

#include <absl/status/statusor.h>
#include <absl/time/clock.h>

#include "common/config/config.h"
#include "common/process/version.h"

namespace craftfleet {
namespace {

constexpr size_t kChunkBytes = 2 << 20;
constexpr int64_t kWeightsBytes = int64_t{2} << 30;  // no agent needs as many
constexpr int kLanes = 8;

}  // namespace

bool BadLearnerService::Ignored(const grpc::ServerContext& context) const {
  if (misdeed_ != LearnerMisdeed::kSilent) return false;
  while (!context.IsCancelled()) absl::SleepFor(absl::Milliseconds(50));
  return true;
}

grpc::Status BadLearnerService::Join(grpc::ServerContext* context, const v1::JoinRequest* /*request*/,
                                     v1::JoinReply* reply) {
  if (Ignored(*context)) return grpc::Status::CANCELLED;
  const absl::StatusOr<v1::RunConfig> config = ResolveRunConfig({});
  if (!config.ok()) return {grpc::StatusCode::INTERNAL, std::string(config.status().message())};
  reply->set_run_id("bad");
  reply->set_epoch(1);
  *reply->mutable_config() = *config;
  reply->set_lease_ms(5000);
  reply->set_program_version(std::string(ProgramVersion()));
  if (misdeed_ == LearnerMisdeed::kLying) {
    switch (joined_++ % 4) {
      case 0:
        reply->mutable_config()->set_lanes(std::numeric_limits<int32_t>::max());
        break;
      case 1:
        reply->set_lease_ms(-1);
        break;
      case 2:
        reply->mutable_config()->set_agent("no such agent");
        break;
      default:
        break;  // a valid reply; invalid permits follow
    }
  }
  return grpc::Status::OK;
}

grpc::Status BadLearnerService::Play(grpc::ServerContext* context,
                                     grpc::ServerReaderWriter<v1::LearnerMessage, v1::ActorMessage>* stream) {
  if (Ignored(*context)) return grpc::Status::CANCELLED;
  v1::ActorMessage message;
  while (stream->Read(&message)) {
    v1::LearnerMessage answer;
    if (message.has_permits()) {
      AnswerRequest(message.permits(), answer.mutable_permits());
    } else {
      answer.mutable_verdict()->set_reason(std::string(1 << 20, '\x1b'));
    }
    stream->Write(answer);
  }
  return grpc::Status::OK;
}

void BadLearnerService::AnswerRequest(const v1::PermitRequest& request, v1::PermitReply* reply) {
  absl::SleepFor(absl::Milliseconds(100));
  const bool lies = misdeed_ == LearnerMisdeed::kLying;
  const int count = lies && asked_++ % 2 == 0 ? 100000 : std::min(request.capacity(), kLanes);
  for (int i = request.active_size(); i < count; ++i) reply->add_granted()->set_lane(lies ? -i : i);
  if (lies) reply->add_env_servers(std::string(1 << 20, '\x1b'));
}

grpc::Status BadLearnerService::GetWeights(grpc::ServerContext* context, const v1::WeightsRequest* /*request*/,
                                           grpc::ServerWriter<v1::WeightsChunk>* writer) {
  if (Ignored(*context)) return grpc::Status::CANCELLED;
  v1::WeightsChunk chunk;
  chunk.set_total_bytes(misdeed_ == LearnerMisdeed::kLying ? -1 : kWeightsBytes);
  chunk.set_data(std::string(kChunkBytes, 'w'));
  while (writer->Write(chunk)) {
  }
  return grpc::Status::OK;
}

grpc::Status BadLearnerService::GetSnapshot(grpc::ServerContext* context, const v1::SnapshotRequest* /*request*/,
                                            v1::SnapshotReply* reply) {
  if (Ignored(*context)) return grpc::Status::CANCELLED;
  reply->set_snapshot(std::string(80 << 20, 'x'));
  return grpc::Status::OK;
}

grpc::Status BadLearnerService::Announce(grpc::ServerContext* context, const v1::Announcement* /*request*/,
                                         v1::AnnounceReply* reply) {
  if (Ignored(*context)) return grpc::Status::CANCELLED;
  reply->set_run_id(std::string(1 << 20, '\x1b'));
  reply->set_lease_ms(misdeed_ == LearnerMisdeed::kLying ? -1 : 1);
  return grpc::Status::OK;
}

}  // namespace craftfleet
