// The cost of the fleet's messages: bytes, and CPU time of both ends. Servers are in processes of their own, their
// clients in this one; there is no training and no policy.

#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "actor/env_client.h"
#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/config/config.h"
#include "common/io/paths.h"
#include "common/io/snapshot_envelope.h"
#include "common/io/texture_digest.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "learner/service/learner_service.h"

ABSL_FLAG(double, seconds, 3, "duration of each measurement, seconds");
ABSL_FLAG(int32_t, clients, 4, "number of concurrent clients");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "wire_bench";
constexpr char kUsage[] = "wire_bench prints the cost of the fleet's messages; see tests/bench/README.md.";
constexpr int kFragmentSteps[] = {256, 32};
constexpr int kLanesOfClient = 16;
constexpr int kFrameBytes = 64 * 64 * 3;
constexpr size_t kSnapshotBytes = 8000;
constexpr size_t kWeightBytes = 2'441'040;  // of ppo_cnn
constexpr absl::Duration kLease = absl::Seconds(60);

double CpuSeconds(clockid_t clock) {
  timespec time = {};
  CRAFTFLEET_CHECK(clock_gettime(clock, &time) == 0);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

// A server in a child process. Must be started in a process without other threads.
class ServerProcess {
 public:
  // `serve` passes the address on which it listens to its argument, which does not return.
  explicit ServerProcess(const std::function<void(const std::function<void(const std::string&)>&)>& serve) {
    int ends[2];
    CRAFTFLEET_CHECK(pipe(ends) == 0);
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      serve([&](const std::string& address) {
        CRAFTFLEET_CHECK(write(ends[1], address.data(), address.size()) > 0);
        while (true) pause();
      });
    }
    char address[128];
    const ssize_t size = read(ends[0], address, sizeof(address));
    CRAFTFLEET_CHECK(size > 0 && clock_getcpuclockid(pid_, &clock_) == 0);
    address_.assign(address, size);
    for (const int end : ends) close(end);
  }
  ~ServerProcess() {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  ServerProcess(const ServerProcess&) = delete;
  ServerProcess& operator=(const ServerProcess&) = delete;

  const std::string& address() const { return address_; }
  double cpu_seconds() const { return CpuSeconds(clock_); }

 private:
  pid_t pid_ = 0;
  clockid_t clock_ = {};
  std::string address_;
};

// The work of a client in one turn.
struct Turn {
  int64_t calls = 0;
  int64_t bytes = 0;  // of the messages, both ways
};

// Prints a row: threads, one for each client, make turns concurrently until the time is over.
void Measure(const std::string& what, const ServerProcess& server, const std::function<Turn(int client)>& turn) {
  const int clients = absl::GetFlag(FLAGS_clients);
  for (int client = 0; client < clients; ++client) turn(client);  // warm-up: connects and touches memory
  std::atomic<int64_t> calls{0};
  std::atomic<int64_t> bytes{0};
  const double server_s = server.cpu_seconds();
  const double client_s = CpuSeconds(CLOCK_PROCESS_CPUTIME_ID);
  const absl::Time start = absl::Now();
  const absl::Time end = start + absl::Seconds(absl::GetFlag(FLAGS_seconds));
  std::vector<std::thread> threads;
  threads.reserve(clients);
  for (int client = 0; client < clients; ++client) {
    threads.emplace_back([&, client] {
      while (absl::Now() < end) {
        const Turn done = turn(client);
        calls += done.calls;
        bytes += done.bytes;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  const double seconds = absl::ToDoubleSeconds(absl::Now() - start);
  const auto count = static_cast<double>(std::max<int64_t>(1, calls));
  std::printf("%-60s %10.0f %9.1f %11.0f %14.1f %14.1f\n", what.c_str(), count / seconds,
              1e-6 * static_cast<double>(bytes) / seconds, static_cast<double>(bytes) / count,
              1e6 * (server.cpu_seconds() - server_s) / count,
              1e6 * (CpuSeconds(CLOCK_PROCESS_CPUTIME_ID) - client_s) / count);
  std::fflush(stdout);
}

// A learner's service that accepts fragments of `steps` steps and drops them.
class Intake {
 public:
  Intake(int steps, int lanes)
      : registry_(RegistryOptions(lanes), std::vector<LaneRecord>(lanes), &clock_),
        service_(ServiceOptions(steps, lanes), &registry_, &weights_, &fragments_) {
    registry_.lanes()->rollouts().OpenIteration(int64_t{1} << 60, 0);
    weights_.Publish(0, std::make_shared<HostWeights>(std::string(kWeightBytes, 'w')));
    server_ = *wire::Server::Create({"127.0.0.1:0"}, {&service_});
    drain_ = std::thread([this] {
      while (fragments_.Pop(absl::InfiniteDuration()).has_value()) {
      }
    });
  }
  const std::string& address() const { return server_->address(); }

 private:
  static WorkerRegistry::Options RegistryOptions(int lanes) {
    WorkerRegistry::Options options;
    options.lanes.lanes = lanes;
    options.lanes.lease = kLease;
    return options;
  }
  static LearnerServiceImpl::Options ServiceOptions(int steps, int lanes) {
    LearnerServiceImpl::Options options;
    options.run_id = "bench";
    options.config = DefaultRunConfig();
    options.config.mutable_env()->set_frame_size(64);
    options.texture_digest = *TextureDigest(*DefaultTextureDir());
    options.shape = {lanes, steps, kFrameBytes, 0, 1};
    options.lease = kLease;
    return options;
  }

  RealClock clock_;
  WorkerRegistry registry_;
  WeightStore weights_;
  FragmentQueue fragments_{64};
  LearnerServiceImpl service_;
  std::unique_ptr<wire::Server> server_;
  std::thread drain_;
};

// A client that calls a learner like an actor.
class Actor {
 public:
  Actor(const std::string& learner, int number, const v1::FragmentMessage& fragment)
      : name_(absl::StrCat("host-1234-bench-", number)),
        stub_(v1::LearnerService::NewStub(wire::Connect(learner).channel)),
        stream_(stub_->Play(&context_)) {
    *fragment_.mutable_fragment() = fragment;
    fragment_.mutable_fragment()->set_actor(name_);
    v1::JoinRequest request;
    request.set_protocol_version(wire::kProtocolVersion);
    request.set_actor(name_);
    v1::JoinReply reply;
    grpc::ClientContext context;
    CRAFTFLEET_CHECK(stub_->Join(&context, request, &reply).ok());
  }
  ~Actor() {
    stream_->WritesDone();
    stream_->Finish();
  }

  // Requests permits, and sends a fragment for each.
  Turn Play() {
    const v1::PermitReply permits = GetPermits({});
    Turn turn;
    v1::LearnerMessage answer;
    for (const v1::Permit& permit : permits.granted()) {
      fragment_.mutable_fragment()->set_lane(permit.lane());
      fragment_.mutable_fragment()->set_number(permit.fragment());
      CRAFTFLEET_CHECK(stream_->Write(fragment_) && stream_->Read(&answer));
      CRAFTFLEET_CHECK(answer.verdict().verdict() == v1::FragmentVerdict::ACCEPTED);
      ++turn.calls;
      turn.bytes += static_cast<int64_t>(fragment_.ByteSizeLong() + answer.ByteSizeLong());
    }
    return turn;
  }

  // Requests permits and holds them.
  void TakePermits() {
    const v1::PermitReply permits = GetPermits({});
    active_.assign(permits.granted().begin(), permits.granted().end());
  }

  // Renews the held permits.
  Turn RenewPermits() {
    int64_t bytes = 0;
    GetPermits(active_, &bytes);
    return {1, bytes};
  }

  Turn GetWeights() {
    grpc::ClientContext context;
    v1::WeightsRequest request;
    const auto stream = stub_->GetWeights(&context, request);
    v1::WeightsChunk chunk;
    Turn turn = {1, 0};
    while (stream->Read(&chunk)) turn.bytes += static_cast<int64_t>(chunk.ByteSizeLong());
    CRAFTFLEET_CHECK(stream->Finish().ok());
    return turn;
  }

 private:
  v1::PermitReply GetPermits(const std::vector<v1::Permit>& active, int64_t* bytes = nullptr) {
    v1::ActorMessage message;
    v1::PermitRequest& request = *message.mutable_permits();
    request.set_actor(name_);
    request.set_capacity(kLanesOfClient);
    for (const v1::Permit& permit : active) *request.add_active() = permit;
    v1::LearnerMessage answer;
    CRAFTFLEET_CHECK(stream_->Write(message) && stream_->Read(&answer) && answer.has_permits());
    if (bytes != nullptr) *bytes = static_cast<int64_t>(message.ByteSizeLong() + answer.ByteSizeLong());
    return std::move(*answer.mutable_permits());
  }

  const std::string name_;
  const std::unique_ptr<v1::LearnerService::Stub> stub_;
  grpc::ClientContext context_;
  const std::unique_ptr<grpc::ClientReaderWriter<v1::ActorMessage, v1::LearnerMessage>> stream_;
  v1::ActorMessage fragment_;
  std::vector<v1::Permit> active_;
};

std::string NameOf(FrameFormat format) { return format == FrameFormat::kScene ? "scene" : "raw"; }

// A client that plays games on an environment server, with a fixed sequence of actions.
class GamePlayer {
 public:
  GamePlayer(const std::string& server, int number, int lanes, FrameFormat frames)
      : client_(wire::Connect(server), Hello(frames), kFrameBytes) {
    CRAFTFLEET_CHECK(client_.Connect(absl::Seconds(10)).ok());
    std::vector<EnvClient::Lane> open;
    for (int i = 0; i < lanes; ++i) {
      lanes_.push_back(i);
      open.push_back({i, int64_t{1000} * number + i, 1, ""});
    }
    CRAFTFLEET_CHECK(client_.Open(open, &frames_).ok());
  }

  // One step of each game. Counts the bytes of frames or scene records.
  Turn Step() {
    std::vector<Action> actions;
    for (const int lane : lanes_) actions.push_back(static_cast<Action>((7 * steps_ + 3 * lane) % kNumActions));
    ++steps_;
    CRAFTFLEET_CHECK(client_.SendStep(lanes_, actions, /*snapshot=*/false).ok() && client_.ReceiveStep(&batch_).ok());
    frames_.swap(batch_.frames);
    Turn turn = {static_cast<int64_t>(lanes_.size()), 0};
    for (const std::string& record : client_.records()) turn.bytes += static_cast<int64_t>(record.size());
    if (client_.records().empty()) turn.bytes = static_cast<int64_t>(frames_.size());
    return turn;
  }
  // Of the first game, before the next step: its pixels, or its scene record.
  const std::string& observation() { return client_.records().empty() ? frames_ : client_.records()[0]; }

 private:
  static v1::SessionHello Hello(FrameFormat frames) {
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

  EnvClient client_;
  std::vector<int> lanes_;
  StepBatch batch_;
  std::string frames_;
  int64_t steps_ = 0;
};

// A fragment of `steps` steps of a game. No actor is named.
v1::FragmentMessage PlayFragment(const std::string& server, int steps, FrameFormat frames) {
  GamePlayer player(server, /*number=*/1, /*lanes=*/1, frames);
  Fragment fragment;
  fragment.frame_format = frames;
  for (int step = 0; step < steps; ++step) {
    fragment.frames += player.observation();
    player.Step();
  }
  fragment.actions.assign(steps, '\1');
  fragment.log_probs.assign(steps, -2.5F);
  fragment.values.assign(steps, 0.5F);
  fragment.rewards.assign(steps, 0);
  fragment.ends.assign(steps, StepEnd::kNone);
  fragment.snapshot.game = SealSnapshot(/*env_digest=*/0, std::string(kSnapshotBytes, 's'));
  return wire::ToProto(std::move(fragment));
}

void MeasureLearner(const ServerProcess& learner, int steps, const ServerProcess& games) {
  std::vector<std::unique_ptr<Actor>> actors;
  for (const FrameFormat frames : {FrameFormat::kRaw, FrameFormat::kScene}) {
    const v1::FragmentMessage fragment = PlayFragment(games.address(), steps, frames);
    actors.clear();
    for (int k = 0; k < absl::GetFlag(FLAGS_clients); ++k) {
      actors.push_back(std::make_unique<Actor>(learner.address(), k, fragment));
    }
    Measure(absl::StrCat("fragment of ", steps, " steps, ", NameOf(frames), ", 1/16 request for permits"), learner,
            [&](int client) { return actors[client]->Play(); });
  }
  if (steps != kFragmentSteps[0]) return;
  for (const auto& actor : actors) actor->TakePermits();
  Measure("request that renews 16 permits", learner, [&](int client) { return actors[client]->RenewPermits(); });
  Measure("weights of ppo_cnn", learner, [&](int client) { return actors[client]->GetWeights(); });
}

void Run() {
  const auto serve_games = [](const auto& listening) {
    const auto envs = *EnvServiceImpl::Create(*DefaultTextureDir());
    const auto server = *wire::Server::Create({"127.0.0.1:0"}, {envs.get()});
    listening(server->address());
  };
  const ServerProcess games(serve_games);
  std::vector<std::unique_ptr<ServerProcess>> learners;
  for (const int steps : kFragmentSteps) {
    learners.push_back(std::make_unique<ServerProcess>([steps](const auto& listening) {
      const Intake intake(steps, kLanesOfClient * absl::GetFlag(FLAGS_clients));
      listening(intake.address());
    }));
  }
  wire::PollFewConnections();  // as craftfleet-actor
  std::printf("%-60s %10s %9s %11s %14s %14s\n", "", "calls/s", "MB/s", "bytes/call", "server us/call",
              "client us/call");
  for (size_t i = 0; i < learners.size(); ++i) MeasureLearner(*learners[i], kFragmentSteps[i], games);
  for (const FrameFormat frames : {FrameFormat::kRaw, FrameFormat::kScene}) {
    std::vector<std::unique_ptr<GamePlayer>> players;
    for (int k = 0; k < absl::GetFlag(FLAGS_clients); ++k) {
      players.push_back(std::make_unique<GamePlayer>(games.address(), k, kLanesOfClient, frames));
    }
    Measure(absl::StrCat("step of a game, ", NameOf(frames), ", 16 in a message (with the game)"), games,
            [&](int client) { return players[client]->Step(); });
  }
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({craftfleet::kProgram, craftfleet::kUsage}, argc, argv);
  craftfleet::Run();
  return 0;
}
