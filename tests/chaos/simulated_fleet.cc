// Many actors and environment servers that play nothing, to load a learner: each actor asks for permits, renews them
// while it "plays" and answers each with a fragment of black frames; each server announces itself. All of them are
// callbacks on gRPC's few threads. Prints figures as JSON. Started by scale.py.
//   simulated_fleet --learner=HOST:PORT --actors=200 --seconds=600
// Real workers would also download weights and snapshots and open sessions with each other.

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>
#include <grpcpp/alarm.h>

#include "common/agent/agent_spec.h"
#include "common/agent/canary.h"
#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "common/io/snapshot_envelope.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "craftfleet/v1/status.grpc.pb.h"

ABSL_FLAG(std::string, learner, "127.0.0.1:50051", "address of the learner");
ABSL_FLAG(int32_t, actors, 200, "actors");
ABSL_FLAG(int32_t, servers, 0, "environment servers");
ABSL_FLAG(int32_t, share, 1, "workers on one connection, 1..60: the learner takes 128 calls on each");
ABSL_FLAG(int32_t, play_ms, 0, "mean time to play a fragment; 0: none");
ABSL_FLAG(int32_t, seconds, 600, "how long");
ABSL_FLAG(bool, probe, false, "only measure how long the learner's status takes to come, once a second");

namespace craftfleet {
namespace {

constexpr size_t kSnapshotBytes = 12000;
constexpr int kPollMs = 500;  // as actors do
constexpr absl::Duration kBetweenStarts = absl::Microseconds(500);
constexpr int kServersPerHost = 4;

// Calls `function` later, on a thread of gRPC.
void After(absl::Duration delay, std::function<void()> function) {
  auto* const alarm = new grpc::Alarm;
  alarm->Set(absl::ToChronoTime(absl::Now() + delay), [alarm, function = std::move(function)](bool /*ok*/) {
    function();
    delete alarm;
  });
}

// What all workers share.
struct Fleet {
  std::string canary;
  absl::Duration play;
  std::atomic<bool> stopping{false};
  std::atomic<int> absent{0};  // actors that have not joined yet
  std::atomic<int> failed{0};
  std::atomic<int> calls{0};  // under way
  Mutex mu;
  std::vector<float> verdict_ms ABSL_GUARDED_BY(mu);
  std::vector<float> answer_ms ABSL_GUARDED_BY(mu);  // of announcements

  void Fail(const char* what, const grpc::Status& status) {
    if (++failed == 1) {
      std::fprintf(stderr, "%s: %d %s\n", what, status.error_code(), status.error_message().c_str());
    }
  }
  void Note(std::vector<float>* times, absl::Duration time) {
    const MutexLock lock(&mu);
    times->push_back(static_cast<float>(absl::ToDoubleMilliseconds(time)));
  }
};

// A unary call with all that must outlive it.
template <typename Request, typename Reply>
struct Call {
  grpc::ClientContext context;
  Request request;
  Reply reply;
};

v1::ProcessSummary Summary(const char* activity) {
  v1::ProcessSummary summary;
  summary.set_steps_per_second(100);
  summary.set_lanes(1);
  summary.set_memory_bytes(1 << 27);
  summary.set_threads(1);
  v1::ActivityTime* const time = summary.add_times();
  time->set_activity(activity);
  time->set_seconds(1);
  time->set_share(1);
  return summary;
}

// Requests permits and answers each with a fragment of black frames; sends one fragment after the other.
class EmptyActor final : public grpc::ClientBidiReactor<v1::ActorMessage, v1::LearnerMessage> {
 public:
  EmptyActor(std::shared_ptr<grpc::Channel> channel, int number, Fleet* fleet)
      : stub_(v1::LearnerService::NewStub(std::move(channel))),
        name_(absl::StrCat("empty-", number)),
        random_(number),
        fleet_(fleet) {}

  void Join() {
    auto call = std::make_shared<Call<v1::JoinRequest, v1::JoinReply>>();
    call->request.set_protocol_version(wire::kProtocolVersion);
    call->request.set_actor(name_);
    call->request.set_canary(fleet_->canary);
    wire::SetDeadline(&call->context, absl::Seconds(30));
    ++fleet_->calls;
    stub_->async()->Join(&call->context, &call->request, &call->reply, [this, call](const grpc::Status& status) {
      OnJoined(status, call->reply);
      --fleet_->calls;
    });
  }

  int64_t fragments() const { return fragments_; }

 private:
  struct Held {
    Permit permit;
    absl::Time since;
  };

  void OnJoined(const grpc::Status& status, const v1::JoinReply& joined) {
    --fleet_->absent;
    if (!status.ok()) return fleet_->Fail("Join", status);
    epoch_ = joined.epoch();
    steps_ = joined.config().fragment_steps();
    const AgentSpec spec = MakeAgentSpec(joined.config()).value();
    frame_bytes_ = spec.frame_bytes();
    const EnvName env = EnvName::Parse(joined.config().env().name()).value();
    const int64_t length = joined.config().env().length() != 0 ? joined.config().env().length() : kEpisodeLength;
    env_digest_ = EnvDigest(env.WorldName(), length);
    AwaitOthers();
  }
  // Without time to play, starts when all have joined, so that they share the lanes from the first fragment on. The
  // leases of thousands of actors would lapse meanwhile.
  void AwaitOthers() {
    if (fleet_->play == absl::ZeroDuration() && fleet_->absent > 0 && !fleet_->stopping) {
      return After(absl::Milliseconds(100), [this] { AwaitOthers(); });
    }
    stub_->async()->Play(&stream_context_, this);
    ++fleet_->calls;
    AddHold();  // for writes outside of its own callbacks
    StartRead(&answer_);
    StartCall();
    Ask();
  }

  void Ask() {
    if (fleet_->stopping) return End();
    const MutexLock lock(&mu_);
    v1::PermitRequest& request = *request_.mutable_permits();
    request.Clear();
    request.set_actor(name_);
    request.set_epoch(epoch_);
    request.set_capacity(4096);
    request.set_wait_ms(kPollMs);
    request.set_wants_env_servers(true);
    *request.mutable_summary() = Summary("environment");
    request.set_env_servers_generation(generation_);
    for (const auto& [lane, held] : held_) {
      v1::Permit* const permit = request.add_active();
      permit->set_lane(lane);
      permit->set_fragment(held.permit.fragment);
      permit->set_policy_version(held.permit.policy_version);
    }
    asks_ = true;
    WriteNext();
  }

  void OnPermits(const v1::PermitReply& reply) {
    {
      const MutexLock lock(&mu_);
      generation_ = reply.env_servers_generation();
      for (const v1::Permit& lost : reply.lost()) held_.erase(lost.lane());
      for (const v1::Permit& granted : reply.granted()) {
        held_[granted.lane()] = {{granted.lane(), granted.fragment(), granted.policy_version()}, SteadyNow()};
      }
    }
    for (const v1::Permit& granted : reply.granted()) Play(granted.lane());
    if (reply.finished()) return End();
    Ask();
  }

  void Play(int lane) {
    if (fleet_->play == absl::ZeroDuration()) return Send(lane);
    const double factor = std::uniform_real_distribution<double>(0.5, 1.5)(random_);
    After(factor * fleet_->play, [this, lane] { Send(lane); });
  }

  void Send(int lane) {
    const MutexLock lock(&mu_);
    if (held_.count(lane) == 0) return;
    ready_.push_back(lane);
    WriteNext();
  }
  // Requests come first, as in real actors.
  void WriteNext() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (writing_ || ended_) return;
    if (asks_) {
      asks_ = false;
      writing_ = true;
      StartWrite(&request_);
    } else if (!ready_.empty() && !is_sent_) {
      *fragment_.mutable_fragment() = Fill(held_[ready_.front()].permit);
      is_sent_ = true;
      writing_ = true;
      sent_ = SteadyNow();
      StartWrite(&fragment_);
    }
  }
  void OnWriteDone(bool ok) override {
    const MutexLock lock(&mu_);
    fragment_.Clear();
    writing_ = false;
    if (ok) WriteNext();
  }
  void OnReadDone(bool ok) override {
    if (!ok) return End();  // without which OnDone does not come
    if (answer_.has_permits()) {
      OnPermits(answer_.permits());
    } else {
      OnVerdict(answer_.verdict());
    }
    StartRead(&answer_);
  }
  void OnVerdict(const v1::FragmentVerdict& verdict) {
    const MutexLock lock(&mu_);
    fleet_->Note(&fleet_->verdict_ms, SteadyNow() - sent_);
    if (verdict.verdict() == v1::FragmentVerdict::ACCEPTED) ++fragments_;
    held_.erase(ready_.front());
    ready_.pop_front();
    is_sent_ = false;
    WriteNext();
  }
  void OnDone(const grpc::Status& status) override {
    if (!fleet_->stopping) fleet_->Fail("Play", status);
    --fleet_->calls;
  }

  void End() {
    {
      const MutexLock lock(&mu_);
      if (std::exchange(ended_, true)) return;
    }
    stream_context_.TryCancel();
    RemoveHold();
  }

  v1::FragmentMessage Fill(const Permit& permit) const {
    Fragment fragment;
    fragment.epoch = epoch_;
    fragment.lane = permit.lane;
    fragment.number = permit.fragment;
    fragment.policy_version = permit.policy_version;
    fragment.frames.assign(steps_ * frame_bytes_, '\0');
    fragment.actions.assign(steps_, '\0');
    fragment.log_probs.assign(steps_, -2.833F);
    fragment.values.assign(steps_, 0);
    for (int t = 0; t < steps_; ++t) fragment.rewards.push_back(t % 64 == permit.lane % 64 ? 1.0F : 0.0F);
    fragment.ends.assign(steps_, StepEnd::kNone);
    fragment.snapshot.game = SealSnapshot(env_digest_, std::string(kSnapshotBytes, 's'));
    v1::FragmentMessage message = wire::ToProto(std::move(fragment));
    message.set_actor(name_);
    return message;
  }

  const std::unique_ptr<v1::LearnerService::Stub> stub_;
  const std::string name_;
  std::mt19937 random_;  // of the thread that takes the permits, one at a time
  Fleet* const fleet_;
  int64_t epoch_ = 0;
  int steps_ = 0;
  size_t frame_bytes_ = 0;
  uint64_t env_digest_ = 0;  // of the run's environment
  grpc::ClientContext stream_context_;
  std::atomic<int64_t> fragments_{0};
  v1::LearnerMessage answer_;

  Mutex mu_;
  v1::ActorMessage request_ ABSL_GUARDED_BY(mu_);
  v1::ActorMessage fragment_ ABSL_GUARDED_BY(mu_);
  absl::Time sent_ ABSL_GUARDED_BY(mu_);       // when the fragment was
  bool asks_ ABSL_GUARDED_BY(mu_) = false;     // the request is to be written
  bool is_sent_ ABSL_GUARDED_BY(mu_) = false;  // the fragment of the first lane of `ready_` was written
  bool writing_ ABSL_GUARDED_BY(mu_) = false;
  std::map<int, Held> held_ ABSL_GUARDED_BY(mu_);  // permits, by lane
  std::deque<int> ready_ ABSL_GUARDED_BY(mu_);     // lanes whose fragment is to be sent
  int64_t generation_ ABSL_GUARDED_BY(mu_) = 0;    // of its list of servers
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
};

// Announces itself as often as environment servers do.
class EmptyServer {
 public:
  EmptyServer(std::shared_ptr<grpc::Channel> channel, int number, const std::string& texture_digest,
              const std::string& canary, Fleet* fleet)
      : stub_(v1::LearnerService::NewStub(std::move(channel))), fleet_(fleet) {
    announcement_.set_protocol_version(wire::kProtocolVersion);
    announcement_.set_name(absl::StrCat("server-", number));
    announcement_.set_address(absl::StrFormat("10.%d.%d.%d:%d", number / kServersPerHost / 256 / 256,
                                              number / kServersPerHost / 256 % 256, number / kServersPerHost % 256,
                                              50061 + number % kServersPerHost));
    announcement_.set_texture_digest(texture_digest);
    announcement_.set_canary(canary);
    *announcement_.mutable_summary() = Summary("environment");
  }

  void Announce() {
    if (fleet_->stopping) return;
    auto call = std::make_shared<Call<v1::Announcement, v1::AnnounceReply>>();
    wire::SetDeadline(&call->context, absl::Seconds(10));
    ++fleet_->calls;
    stub_->async()->Announce(&call->context, &announcement_, &call->reply,
                             [this, call, start = SteadyNow()](const grpc::Status& status) {
                               if (!status.ok() && !fleet_->stopping) fleet_->Fail("Announce", status);
                               fleet_->Note(&fleet_->answer_ms, SteadyNow() - start);
                               const int lease_ms = status.ok() ? call->reply.lease_ms() : 8000;
                               After(absl::Milliseconds(lease_ms) / 8, [this] { Announce(); });
                               --fleet_->calls;
                             });
  }

 private:
  const std::unique_ptr<v1::LearnerService::Stub> stub_;
  Fleet* const fleet_;
  v1::Announcement announcement_;
};

std::string Figures(std::vector<float> times_ms) {
  if (times_ms.empty()) return "{}";
  std::sort(times_ms.begin(), times_ms.end());
  return absl::StrFormat(R"({"count": %d, "median": %.2f, "p99": %.2f, "slowest": %.1f})", times_ms.size(),
                         times_ms[times_ms.size() / 2], times_ms[times_ms.size() * 99 / 100], times_ms.back());
}

absl::StatusOr<v1::JoinReply> AskLearner(const std::string& address) {
  const wire::Endpoint learner = wire::Connect(address);
  v1::JoinRequest request;
  request.set_protocol_version(wire::kProtocolVersion);
  request.set_actor("empty-asks");
  request.set_only_ask(true);
  v1::JoinReply reply;
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(30));
  const auto stub = v1::LearnerService::NewStub(learner.channel);
  CRAFTFLEET_RETURN_IF_ERROR(wire::FromCall(stub->Join(&context, request, &reply), "learner", learner));
  return reply;
}

absl::Status Probe(const std::string& address) {
  const wire::Endpoint learner = wire::Connect(address);
  const auto stub = v1::StatusService::NewStub(learner.channel);
  std::vector<float> answers_ms;
  const absl::Time end = absl::Now() + absl::Seconds(absl::GetFlag(FLAGS_seconds));
  // The first query includes the connection and does not count.
  for (bool connected = false; absl::Now() < end || answers_ms.empty(); absl::SleepFor(absl::Seconds(1))) {
    grpc::ClientContext context;
    wire::SetDeadline(&context, absl::Seconds(10));
    v1::StatusReply reply;
    const absl::Time start = absl::Now();
    CRAFTFLEET_RETURN_IF_ERROR(wire::FromCall(stub->GetStatus(&context, {}, &reply), "status", learner));
    if (connected) answers_ms.push_back(static_cast<float>(absl::ToDoubleMilliseconds(absl::Now() - start)));
    connected = true;
  }
  std::printf("%s\n", Figures(answers_ms).c_str());
  return absl::OkStatus();
}

absl::Status Run() {
  const std::string address = absl::GetFlag(FLAGS_learner);
  if (absl::GetFlag(FLAGS_probe)) return Probe(address);
  const int share = absl::GetFlag(FLAGS_share);
  Fleet fleet;
  fleet.play = absl::Milliseconds(absl::GetFlag(FLAGS_play_ms));
  CRAFTFLEET_ASSIGN_OR_RETURN(fleet.canary, PolicyCanary());
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::JoinReply run, AskLearner(address));
  std::shared_ptr<grpc::Channel> channel;
  int workers = 0;
  const auto next_channel = [&] {
    if (workers++ % share == 0) channel = wire::Connect(address).channel;
    return channel;
  };
  std::vector<std::unique_ptr<EmptyServer>> servers;
  for (int i = 0; i < absl::GetFlag(FLAGS_servers); ++i) {
    servers.push_back(
        std::make_unique<EmptyServer>(next_channel(), i, run.texture_digest(), run.game_canary(), &fleet));
    servers.back()->Announce();
    absl::SleepFor(kBetweenStarts);
  }
  std::vector<std::unique_ptr<EmptyActor>> actors;
  fleet.absent = absl::GetFlag(FLAGS_actors);
  const absl::Time start = SteadyNow();
  for (int i = 0; i < absl::GetFlag(FLAGS_actors); ++i) {
    actors.push_back(std::make_unique<EmptyActor>(next_channel(), i, &fleet));
    actors.back()->Join();
    absl::SleepFor(kBetweenStarts);
  }
  while (fleet.absent > 0) absl::SleepFor(absl::Milliseconds(10));
  const double joining_s = absl::ToDoubleSeconds(SteadyNow() - start);
  absl::SleepFor(absl::Seconds(absl::GetFlag(FLAGS_seconds)));
  fleet.stopping = true;
  while (fleet.calls > 0) absl::SleepFor(absl::Milliseconds(10));

  std::vector<int64_t> fragments;
  fragments.reserve(actors.size());
  for (const auto& actor : actors) fragments.push_back(actor->fragments());
  const auto [fewest, most] = std::minmax_element(fragments.begin(), fragments.end());
  const MutexLock lock(&fleet.mu);
  std::printf("%s\n", absl::StrFormat(
                          R"({"actors": %d, "servers": %d, "failed": %d, "joining_s": %.1f, "fewest_fragments": %d, )"
                          R"("most_fragments": %d, "verdict_ms": %s, "announcement_ms": %s})",
                          actors.size(), servers.size(), fleet.failed.load(), joining_s, *fewest, *most,
                          Figures(fleet.verdict_ms), Figures(fleet.answer_ms))
                          .c_str());
  // Alarms may still hold pointers to workers; the process ends here.
  std::fflush(stdout);
  std::_Exit(0);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({"simulated_fleet", "Many workers that play nothing; see tests/chaos/README.md."}, argc, argv);
  return craftfleet::ExitCode("simulated_fleet", craftfleet::Run());
}
