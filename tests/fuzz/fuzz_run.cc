// What only a learner reads, and a process's status as people see it.

#include <algorithm>
#include <cmath>

#include <absl/strings/ascii.h>

#include "common/agent/agent_spec.h"
#include "common/agent/safetensors.h"
#include "common/base/check.h"
#include "common/io/files.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/access.h"
#include "deploy/cli/status_text.h"
#include "learner/training/records/lane_loading.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

// Weights as bytes: refused, or tensors that survive being written and read again.
namespace weights {

void TryInput(absl::string_view input) {
  const auto file = ReadSafetensors(input);
  if (!file.ok()) return;
  const std::string bytes = WriteSafetensors(*file);
  const auto again = ReadSafetensors(bytes);
  CRAFTFLEET_CHECK(again.ok() && again->tensors.size() == file->tensors.size());
  for (size_t i = 0; i < file->tensors.size(); ++i) {
    CRAFTFLEET_CHECK(again->tensors[i].name == file->tensors[i].name);
    CRAFTFLEET_CHECK(again->tensors[i].data == file->tensors[i].data);
  }
}

std::vector<std::string> SoundInputs() {
  const std::string data(4 * 6, '\x3f');
  SafeTensors file{{{"action_net.weight", {2, 2}, absl::string_view(data).substr(0, 16)},
                    {"action_net.bias", {2}, absl::string_view(data).substr(16)}},
                   {{"steps", "7"}}};
  return {WriteSafetensors(file), WriteSafetensors({})};
}

const FuzzTarget kTarget("weights", TryInput, SoundInputs);

}  // namespace weights

// An access file: if it is accepted, a client without credentials may only check health.
namespace access {

void TryInput(absl::string_view input) {
  const auto access = wire::ParseAccess(input, "input");
  if (!access.ok()) return;
  wire::Caller anonymous;
  wire::Caller authenticated;
  authenticated.certificate_names = {"actor", "host.example.com"};
  authenticated.token = "a token";
  for (const char* path : {"/craftfleet.v1.StatusService/GetStatus", "/craftfleet.v1.LearnerService/Join",
                           "/craftfleet.v1.AdminService/Stop", "/something.else/Call"}) {
    CRAFTFLEET_CHECK(!wire::CheckAccess(*access, anonymous, path).ok());
    wire::CheckAccess(*access, authenticated, path).IgnoreError();
  }
  CRAFTFLEET_CHECK(wire::CheckAccess(*access, anonymous, "/grpc.health.v1.Health/Check").ok());
}

std::vector<std::string> SoundInputs() {
  return {R"(client { name: "workers" certificate: "actor" right: PLAY }
client { name: "ops" certificate: "*.example.com" right: WATCH right: STEER })",
          R"(client { name: "monitor" right: WATCH
  token_sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855" })"};
}

const FuzzTarget kTarget("access", TryInput, SoundInputs);

}  // namespace access

// The status of a process, as `craftfleet status` shows it: lines of printable ASCII.
namespace status_reply {

void TryInput(absl::string_view input) {
  v1::StatusReply reply;
  if (!reply.ParseFromArray(input.data(), static_cast<int>(input.size()))) return;
  for (const char c : StatusText(reply)) CRAFTFLEET_CHECK(c == '\n' || absl::ascii_isprint(c));
}

std::vector<std::string> SoundInputs() {
  v1::StatusReply reply;
  reply.set_role("learner");
  reply.set_name("host-12-ab");
  reply.set_run_id("20231114-221320-abcdef");
  v1::Metric* metric = reply.add_metrics();
  metric->set_name("env_steps");
  metric->set_value(12288);
  v1::ActivityTime* time = reply.mutable_summary()->add_times();
  time->set_activity("update");
  time->set_share(0.9);
  reply.mutable_fleet()->set_bottleneck("learner");
  reply.mutable_fleet()->set_advice("add threads");
  v1::Peer* peer = reply.add_peers();
  peer->set_role("actor");
  peer->set_name("host-13-cd");
  peer->set_address("127.0.0.1:40000");
  *peer->mutable_summary() = reply.summary();
  return {reply.SerializeAsString()};
}

const FuzzTarget kTarget("status_reply", TryInput, SoundInputs);

}  // namespace status_reply

// The lanes of a checkpoint's state: whatever a checkpoint holds, a run has all its lanes afterwards, each with
// snapshots that pass the checks of the wire, and they load unchanged once they are stored again.
namespace lane_loading {

void CheckLoaded(const LaneSnapshot& snapshot) {
  CRAFTFLEET_CHECK(CheckSnapshot(kSampleShape.env_digest, snapshot.game).ok());
  CRAFTFLEET_CHECK(static_cast<int>(snapshot.state.size()) == kSampleShape.state_size);
  for (const float value : snapshot.state) CRAFTFLEET_CHECK(std::isfinite(value));
}

v1::CheckpointState ToState(const LoadedLanes& lanes) {
  v1::CheckpointState state;
  for (const LaneRecord& record : lanes.records) *state.add_lanes() = ToProto(record);
  return state;
}

v1::LaneState SampleLane(const std::string& game, const std::string& previous) {
  v1::LaneState lane;
  lane.set_next_fragment(7);
  lane.set_snapshot(game);
  lane.set_previous_snapshot(previous);
  for (int i = 0; i < kSampleShape.state_size; ++i) {
    lane.add_state(0.5F);
    lane.add_previous_state(-0.5F);
  }
  return lane;
}

void TryInput(absl::string_view input) {
  v1::CheckpointState state;
  if (!state.ParseFromArray(input.data(), static_cast<int>(input.size()))) return;
  const LoadedLanes lanes = LoadLanes(state, kSampleShape);
  CRAFTFLEET_CHECK(static_cast<int>(lanes.records.size()) == kSampleShape.lanes);
  CRAFTFLEET_CHECK(lanes.resets >= 0 && lanes.resets <= kSampleShape.lanes);
  for (const LaneRecord& record : lanes.records) {
    CheckLoaded(*record.snapshot);
    CheckLoaded(*record.previous);
  }
  const v1::CheckpointState stored = ToState(lanes);
  const LoadedLanes again = LoadLanes(stored, kSampleShape);
  CRAFTFLEET_CHECK(again.resets == 0);
  CRAFTFLEET_CHECK(ToState(again).SerializeAsString() == stored.SerializeAsString());
}

std::vector<std::string> SoundInputs() {
  const std::string game = SampleSnapshot("a game");
  v1::CheckpointState sound;
  for (int lane = 0; lane < kSampleShape.lanes; ++lane) *sound.add_lanes() = SampleLane(game, game);
  v1::CheckpointState damaged;
  *damaged.add_lanes() = SampleLane(game.substr(1), game);                    // without an envelope
  *damaged.add_lanes() = SampleLane(game.substr(0, game.size() - 1), game);   // cut off
  *damaged.add_lanes() = SampleLane(SealSnapshot(1, "of another game"), "");  // and no earlier snapshot
  damaged.mutable_lanes(1)->clear_previous_state();
  v1::CheckpointState states;
  *states.add_lanes() = SampleLane(game, game);
  states.mutable_lanes(0)->set_state(0, std::nanf(""));
  *states.add_lanes() = SampleLane(game, game);
  states.mutable_lanes(1)->add_state(1);
  return {sound.SerializeAsString(), damaged.SerializeAsString(), states.SerializeAsString(), ""};
}

const FuzzTarget kTarget("lane_loading", TryInput, SoundInputs);

}  // namespace lane_loading

}  // namespace
}  // namespace craftfleet
