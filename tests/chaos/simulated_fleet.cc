// Many actors over real connections that send made-up fragments, to load a learner. Prints figures as JSON. Started by
// scale.py.
//   many_actors --learner=HOST:PORT --actors=200 --seconds=600

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "actor/learner_client.h"
#include "common/agent/agent_spec.h"
#include "common/agent/canary.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "common/io/snapshot_envelope.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"

ABSL_FLAG(std::string, learner, "127.0.0.1:50051", "address of the learner");
ABSL_FLAG(int32_t, actors, 200, "actors, each with a connection and a thread of its own");
ABSL_FLAG(int32_t, seconds, 600, "how long");

namespace craftfleet {
namespace {

constexpr size_t kSnapshotBytes = 12000;

// Requests permits and answers each with a fragment of black frames.
class EmptyActor {
 public:
  EmptyActor(const std::string& learner, int number, const std::string& canary)
      : client_(wire::Connect(learner)), name_(absl::StrCat("empty-", number)), canary_(canary) {}

  // Starts when all have joined (`absent` is 0), so that they share the lanes from the first fragment on.
  absl::Status Play(std::atomic<int>* absent, const std::atomic<bool>& stopping) {
    v1::JoinRequest join;
    join.set_protocol_version(wire::kProtocolVersion);
    join.set_actor(name_);
    join.set_canary(canary_);
    const absl::StatusOr<v1::JoinReply> reply = client_.Join(join);
    --*absent;
    if (!reply.ok()) return reply.status();
    const v1::JoinReply& joined = *reply;
    CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(joined.config()));
    CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName env, EnvName::Parse(joined.config().env().name()));
    const int64_t length = joined.config().env().length() != 0 ? joined.config().env().length() : kEpisodeLength;
    snapshot_ = SealSnapshot(EnvDigest(env.WorldName(), length), std::string(kSnapshotBytes, 's'));
    while (*absent > 0) absl::SleepFor(absl::Milliseconds(10));
    grpc::ClientContext context;
    const auto stream = client_.PushFragments(&context);
    while (!stopping) {
      v1::PermitRequest request;
      request.set_actor(name_);
      request.set_epoch(joined.epoch());
      request.set_capacity(4096);
      request.set_wait_ms(500);
      CRAFTFLEET_ASSIGN_OR_RETURN(const v1::PermitReply reply, client_.GetPermits(request));
      if (reply.finished()) break;
      for (const v1::Permit& permit : reply.granted()) {
        v1::FragmentMessage message = Fill(joined, spec, permit);
        v1::FragmentVerdict verdict;
        if (!stream->Write(message) || !stream->Read(&verdict)) return absl::UnavailableError("the stream ended");
        if (verdict.verdict() == v1::FragmentVerdict::ACCEPTED) ++fragments_;
      }
    }
    stream->WritesDone();
    stream->Finish();
    client_.Leave(name_);
    return absl::OkStatus();
  }

  int64_t fragments() const { return fragments_; }

 private:
  v1::FragmentMessage Fill(const v1::JoinReply& joined, const AgentSpec& spec, const v1::Permit& permit) const {
    const int steps = joined.config().fragment_steps();
    Fragment fragment;
    fragment.epoch = joined.epoch();
    fragment.lane = permit.lane();
    fragment.number = permit.fragment();
    fragment.policy_version = permit.policy_version();
    fragment.frames.assign(steps * spec.frame_bytes(), '\0');
    fragment.actions.assign(steps, '\0');
    fragment.log_probs.assign(steps, -2.833F);
    fragment.values.assign(steps, 0);
    fragment.rewards.assign(steps, 0);
    for (int t = 0; t < steps; ++t) fragment.rewards[t] = static_cast<float>((permit.lane() + t) % 2);
    fragment.ends.assign(steps, StepEnd::kNone);
    fragment.snapshot.game = snapshot_;
    v1::FragmentMessage message = wire::ToProto(std::move(fragment));
    message.set_actor(name_);
    return message;
  }

  const LearnerClient client_;
  const std::string name_;
  const std::string canary_;
  std::string snapshot_;  // in the envelope of the run's environment
  std::atomic<int64_t> fragments_{0};
};

absl::Status Run() {
  const std::string address = absl::GetFlag(FLAGS_learner);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string canary, PolicyCanary());
  std::atomic<bool> stopping{false};
  std::vector<std::unique_ptr<EmptyActor>> actors;
  std::vector<std::thread> threads;
  std::atomic<int> failed{0};
  std::atomic<int> absent{absl::GetFlag(FLAGS_actors)};
  for (int i = 0; i < absl::GetFlag(FLAGS_actors); ++i) {
    actors.push_back(std::make_unique<EmptyActor>(address, i, canary));
    threads.emplace_back([&, actor = actors.back().get()] {
      const absl::Status status = actor->Play(&absent, stopping);
      if (!status.ok() && ++failed == 1) std::fprintf(stderr, "an actor ended: %s\n", status.ToString().c_str());
    });
  }
  absl::SleepFor(absl::Seconds(absl::GetFlag(FLAGS_seconds)));
  stopping = true;
  for (std::thread& thread : threads) thread.join();

  std::vector<int64_t> fragments;
  fragments.reserve(actors.size());
  for (const auto& actor : actors) fragments.push_back(actor->fragments());
  const auto [fewest, most] = std::minmax_element(fragments.begin(), fragments.end());
  std::printf("%s\n", absl::StrFormat(R"({"actors": %d, "failed": %d, "fewest_fragments": %d, "most_fragments": %d})",
                                      actors.size(), failed.load(), *fewest, *most)
                          .c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags("many_actors", "Many actors that play nothing; see tests/chaos/README.md.", argc, argv);
  return craftfleet::ExitCode("many_actors", craftfleet::Run());
}
