// The replies of a learner and an environment server to an actor. The first byte selects the message.

#include "common/base/check.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

constexpr int kLanes = 3;
constexpr int kFrameBytes = 12;
constexpr int kPictureBytes = 27;
constexpr int kStateSize = 2;

}  // namespace

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view bytes = input.substr(1);
  if (input[0] % 2 == 0) {
    v1::PlayReply reply;
    StepBatch batch;
    if (!reply.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
    const auto moments = wire::MomentsFromProto(&reply, kLanes, kFrameBytes, kPictureBytes);
    CRAFTFLEET_CHECK(!moments.ok() || moments->size() == kLanes);
    if (!wire::FromProto(&reply, kLanes, kFrameBytes, &batch).ok()) return;
    CRAFTFLEET_CHECK(batch.rewards.size() == kLanes && batch.ends.size() == kLanes);
    CRAFTFLEET_CHECK(batch.frames.size() == kLanes * kFrameBytes && batch.last_frames.size() % kFrameBytes == 0);
  } else {
    v1::SnapshotReply reply;
    if (!reply.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
    const auto snapshot = wire::FromProto(&reply, kStateSize);
    CRAFTFLEET_CHECK(!snapshot.ok() || snapshot->state.size() == kStateSize);
  }
}

std::vector<std::string> SoundInputs() {
  StepBatch batch = SampleStepBatch();
  v1::PlayReply reply;
  wire::ToProto(&batch, &reply);
  wire::ToProto(std::vector<Moment>{SampleMoment(1), SampleMoment(2), SampleMoment(3)}, &reply);
  v1::SnapshotReply snapshot;
  snapshot.set_snapshot("a game");
  snapshot.add_state(0.5F);
  snapshot.add_state(-1);
  return {'\0' + reply.SerializeAsString(), '\1' + snapshot.SerializeAsString()};
}

}  // namespace craftfleet
