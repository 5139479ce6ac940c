#include "tests/bench/wire/game_player.h"

#include <memory>
#include <utility>

#include <absl/time/time.h>

#include "actor/fragment_builder.h"
#include "common/base/check.h"
#include "common/io/paths.h"
#include "common/io/snapshot_envelope.h"
#include "common/io/texture_digest.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"

namespace craftfleet {
namespace {

v1::SessionHello Hello(FrameFormat frames) {
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.set_run_id("bench");
  hello.set_texture_digest(*TextureDigest(*DefaultTextureDir()));
  hello.mutable_env()->set_name("crafter");
  hello.mutable_env()->set_frame_size(64);
  hello.mutable_env()->set_length(10000);
  hello.set_client("bench");
  if (frames != FrameFormat::kRaw) hello.add_frame_formats(static_cast<v1::FrameFormat>(frames));
  return hello;
}

}  // namespace

GamePlayer::GamePlayer(const std::string& server, int number, int lanes, FrameFormat frames)
    : client_(wire::Connect(server), Hello(frames), kFrameBytes) {
  CRAFTFLEET_CHECK(client_.Connect(absl::Seconds(10)).ok());
  std::vector<EnvClient::Lane> open;
  for (int i = 0; i < lanes; ++i) {
    lanes_.push_back(i);
    open.push_back({i, int64_t{1000} * number + i, 1, ""});
  }
  CRAFTFLEET_CHECK(client_.Open(open, &frames_).ok());
}

Turn GamePlayer::Step(bool snapshot) {
  std::vector<Action> actions;
  for (const int lane : lanes_) actions.push_back(static_cast<Action>((7 * steps_ + 3 * lane) % kNumActions));
  ++steps_;
  CRAFTFLEET_CHECK(client_.SendStep(lanes_, actions, snapshot).ok() && client_.ReceiveStep(&batch_).ok());
  frames_.swap(batch_.frames);
  Turn turn = {static_cast<int64_t>(lanes_.size()), 0};
  for (const std::string& record : client_.records()) turn.bytes += static_cast<int64_t>(record.size());
  if (client_.records().empty()) turn.bytes = static_cast<int64_t>(frames_.size());
  return turn;
}

Turn GamePlayer::StepAndSave() {
  Turn turn = Step(/*snapshot=*/true);
  turn.bytes = 0;
  for (const std::string& snapshot : batch_.snapshots) turn.bytes += static_cast<int64_t>(snapshot.size());
  return turn;
}

v1::FragmentMessage PlayFragment(int steps, FrameFormat frames) {
  const std::unique_ptr<EnvServiceImpl> envs = *EnvServiceImpl::Create(*DefaultTextureDir());
  wire::Server::Options options;
  options.address = "127.0.0.1:0";
  const std::unique_ptr<wire::Server> server = *wire::Server::Create(options, {envs.get()});
  FragmentBuilder builder;
  {
    GamePlayer player(server->address(), /*number=*/1, /*lanes=*/1, frames);
    builder.Start(/*epoch=*/0, /*lane=*/0, /*number=*/0, /*policy_version=*/0, steps, kFrameBytes, frames);
    for (int step = 0; step < steps; ++step) {
      builder.Append(frames == FrameFormat::kScene ? player.records()[0] : player.frames(), Action{1}, -2.5F, 0.5F,
                     0.1F, StepEnd::kNone);
      player.Step();
    }
  }
  server->Stop(absl::Milliseconds(200));
  LaneSnapshot snapshot;
  snapshot.game = SealSnapshot(/*env_digest=*/0, std::string(kSnapshotBytes, 's'));
  return wire::ToProto(builder.Finish(/*bootstrap_value=*/0, std::move(snapshot)));
}

}  // namespace craftfleet
