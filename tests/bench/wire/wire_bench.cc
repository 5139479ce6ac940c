// The cost of the fleet's messages: bytes, and CPU time of both ends. Servers are in one process, their clients in
// another; there is no training and no policy.

#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/time/time.h>

#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "learner/service/learner_service.h"
#include "tests/bench/wire/game_player.h"
#include "tests/bench/wire/measure.h"

ABSL_FLAG(double, seconds, 3, "duration of each measurement, seconds");
ABSL_FLAG(int32_t, clients, 4, "number of concurrent clients");
ABSL_FLAG(bool, unix_sockets, false, "Unix sockets instead of TCP over loopback");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "wire_bench";
constexpr char kUsage[] = "wire_bench prints the cost of the fleet's messages; see tests/bench/README.md.";
constexpr int kFragmentSteps[] = {256, 32, 4};
constexpr int kServices = std::size(kFragmentSteps);
constexpr int kLanesOfClient = 16;
constexpr int kMany = 10000;
constexpr size_t kWeightBytes = 2'441'040;  // of ppo_cnn
constexpr absl::Duration kLease = absl::Seconds(60);

struct Addresses {
  char learners[kServices][128] = {};  // by fragment length
  char crowded[128] = {};              // one with kMany lanes and servers
  char env_server[128] = {};
};

// A learner's service that accepts fragments of `steps` steps and drops them.
class Intake {
 public:
  Intake(int steps, int lanes, const std::string& address)
      : registry_(RegistryOptions(lanes), std::vector<LaneRecord>(lanes), &clock_),
        service_(ServiceOptions(steps, lanes), &registry_, &weights_, &fragments_) {
    registry_.lanes()->rollouts().OpenIteration(int64_t{1} << 60, 0);
    weights_.Publish(0, std::make_shared<const std::string>(kWeightBytes, 'w'));
    wire::Server::Options options;
    options.address = address;
    absl::StatusOr<std::unique_ptr<wire::Server>> server = wire::Server::Create(options, {&service_});
    CRAFTFLEET_CHECK(server.ok());
    server_ = *std::move(server);
    drain_ = std::thread([this] {
      while (fragments_.Pop(absl::InfiniteDuration()).has_value()) {
      }
    });
  }
  ~Intake() {
    registry_.Close();
    fragments_.Close();
    drain_.join();
    server_->Stop(absl::Milliseconds(200));
  }
  const std::string& address() const { return server_->address(); }

 private:
  static WorkerRegistry::Options RegistryOptions(int lanes) {
    WorkerRegistry::Options options;
    options.lanes.lanes = lanes;
    options.lanes.lease = kLease;
    options.max_names_per_client = 2 * kMany;
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
    Call(&v1::LearnerService::Stub::Join, request, &reply);
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

  // Requests the snapshots of the held lanes.
  Turn GetSnapshots() {
    Turn turn;
    for (const v1::Permit& permit : active_) {
      v1::SnapshotRequest request;
      request.set_lane(permit.lane());
      request.set_fragment(permit.fragment());
      v1::SnapshotReply reply;
      Call(&v1::LearnerService::Stub::GetSnapshot, request, &reply);
      ++turn.calls;
      turn.bytes += static_cast<int64_t>(request.ByteSizeLong() + reply.ByteSizeLong());
    }
    return turn;
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

  Turn Announce(int number) {
    v1::Announcement request;
    request.set_protocol_version(wire::kProtocolVersion);
    request.set_name(absl::StrCat("host-5678-bench-", number));
    request.set_address(absl::StrCat("10.0.0.1:", number));
    v1::AnnounceReply reply;
    Call(&v1::LearnerService::Stub::Announce, request, &reply);
    return {1, static_cast<int64_t>(request.ByteSizeLong() + reply.ByteSizeLong())};
  }

 private:
  template <typename Request, typename Reply>
  void Call(grpc::Status (v1::LearnerService::Stub::*method)(grpc::ClientContext*, const Request&, Reply*),
            const Request& request, Reply* reply) {
    grpc::ClientContext context;
    const grpc::Status status = (stub_.get()->*method)(&context, request, reply);
    if (!status.ok()) std::fprintf(stderr, "%s\n", status.error_message().c_str());
    CRAFTFLEET_CHECK(status.ok());
  }

  v1::PermitReply GetPermits(const std::vector<v1::Permit>& active, int64_t* bytes = nullptr) {
    v1::ActorMessage message;
    v1::PermitRequest& request = *message.mutable_permits();
    request.set_actor(name_);
    request.set_capacity(kLanesOfClient);
    request.set_wants_env_servers(true);
    request.set_env_servers_generation(env_servers_generation_);
    for (const v1::Permit& permit : active) *request.add_active() = permit;
    v1::LearnerMessage answer;
    CRAFTFLEET_CHECK(stream_->Write(message) && stream_->Read(&answer) && answer.has_permits());
    env_servers_generation_ = answer.permits().env_servers_generation();
    if (bytes != nullptr) *bytes = static_cast<int64_t>(message.ByteSizeLong() + answer.ByteSizeLong());
    return std::move(*answer.mutable_permits());
  }

  const std::string name_;
  const std::unique_ptr<v1::LearnerService::Stub> stub_;
  grpc::ClientContext context_;
  const std::unique_ptr<grpc::ClientReaderWriter<v1::ActorMessage, v1::LearnerMessage>> stream_;
  v1::ActorMessage fragment_;
  std::vector<v1::Permit> active_;
  int64_t env_servers_generation_ = 0;
};

std::vector<std::unique_ptr<Actor>> ConnectActors(const std::string& learner, int count, int steps,
                                                  FrameFormat frames) {
  const v1::FragmentMessage fragment = PlayFragment(steps, frames);
  std::vector<std::unique_ptr<Actor>> actors;
  actors.reserve(count);
  for (int k = 0; k < count; ++k) actors.push_back(std::make_unique<Actor>(learner, k, fragment));
  return actors;
}

void MeasureFragments(const Addresses& addresses, int clients, Meter* meter) {
  for (int i = 0; i < kServices; ++i) {
    for (const FrameFormat frames : {FrameFormat::kRaw, FrameFormat::kScene}) {
      const auto actors = ConnectActors(addresses.learners[i], clients, kFragmentSteps[i], frames);
      meter->Measure(
          absl::StrCat("fragment of ", kFragmentSteps[i], " steps, ", NameOf(frames), ", 1/16 request for permits"),
          clients, [&](int client) { return actors[client]->Play(); });
    }
  }
  const auto actors = ConnectActors(addresses.learners[kServices - 1], clients, 4, FrameFormat::kRaw);
  for (const auto& actor : actors) actor->TakePermits();
  meter->Measure("snapshot of a lane", clients, [&](int client) { return actors[client]->GetSnapshots(); });
  meter->Measure("request that renews 16 permits", clients, [&](int client) { return actors[client]->RenewPermits(); });
  meter->Measure("announcement of an environment server", clients,
                 [&](int client) { return actors[client]->Announce(client); });
  meter->Measure("weights of ppo_cnn", clients, [&](int client) { return actors[client]->GetWeights(); });
}

// Calls whose cost depends on the number of lanes and workers.
void MeasureCrowd(const Addresses& addresses, int clients, Meter* meter) {
  constexpr int kCrowd = kMany / kLanesOfClient;
  const auto actors = ConnectActors(addresses.crowded, kCrowd, 4, FrameFormat::kRaw);
  for (int k = 0; k < clients; ++k) actors[k]->TakePermits();
  for (int server = 0; server < kMany; ++server) actors[0]->Announce(server);
  meter->Measure(absl::StrCat("request for permits; ", kMany, " lanes, ", kMany, " servers, ", kCrowd, " actors"),
                 clients, [&](int client) { return actors[client]->RenewPermits(); });
  std::vector<int> servers(clients);
  meter->Measure(absl::StrCat("announcement of one of ", kMany, " environment servers"), clients, [&](int client) {
    return actors[client]->Announce(client + clients * (servers[client]++ % (kMany / clients)));
  });
}

void MeasureLearners(const Addresses& addresses, int clients, Meter* meter) {
  MeasureFragments(addresses, clients, meter);
  MeasureCrowd(addresses, clients, meter);
}

void MeasureEnvServer(const Addresses& addresses, int clients, Meter* meter) {
  for (const FrameFormat frames : {FrameFormat::kRaw, FrameFormat::kScene}) {
    for (const int lanes : {1, 16, 64}) {
      std::vector<std::unique_ptr<GamePlayer>> players;
      players.reserve(clients);
      for (int k = 0; k < clients; ++k) {
        players.push_back(std::make_unique<GamePlayer>(addresses.env_server, k, lanes, frames));
      }
      meter->Measure(absl::StrCat("step of a game, ", NameOf(frames), ", ", lanes, " in a message (with the game)"),
                     clients, [&](int client) { return players[client]->Step(); });
      if (lanes != 16) continue;
      meter->Measure(absl::StrCat("step with snapshot, ", NameOf(frames), ", 16 in a message (its bytes)"), clients,
                     [&](int client) { return players[client]->StepAndSave(); });
    }
  }
}

std::string ListenAddress(const std::string& name) {
  if (!absl::GetFlag(FLAGS_unix_sockets)) return "127.0.0.1:0";
  return absl::StrCat("unix:/tmp/wire_bench-", getpid(), "-", name);
}

void SendAndPrint(const Addresses& addresses, int from_child, int to_child) {
  CRAFTFLEET_CHECK(write(to_child, &addresses, sizeof(addresses)) == sizeof(addresses));
  PrintMeasurements(from_child, to_child);
}

void ServeLearners(int from_child, int to_child) {
  Addresses addresses;
  std::vector<std::unique_ptr<Intake>> learners;
  for (int i = 0; i < kServices; ++i) {
    learners.push_back(std::make_unique<Intake>(kFragmentSteps[i], kLanesOfClient * absl::GetFlag(FLAGS_clients),
                                                ListenAddress(absl::StrCat(i))));
    learners.back()->address().copy(addresses.learners[i], sizeof(addresses.learners[i]) - 1);
  }
  Intake crowded(4, kMany, ListenAddress("crowded"));
  crowded.address().copy(addresses.crowded, sizeof(addresses.crowded) - 1);
  SendAndPrint(addresses, from_child, to_child);
}

void ServeEnvironments(int from_child, int to_child) {
  Addresses addresses;
  const std::unique_ptr<EnvServiceImpl> envs = *EnvServiceImpl::Create(*DefaultTextureDir());
  wire::Server::Options options;
  options.address = ListenAddress("env");
  const std::unique_ptr<wire::Server> server = *wire::Server::Create(options, {envs.get()});
  server->address().copy(addresses.env_server, sizeof(addresses.env_server) - 1);
  SendAndPrint(addresses, from_child, to_child);
}

// A kind of server, and what its clients measure.
struct Part {
  void (*serve)(int from_child, int to_child);
  void (*measure)(const Addresses& addresses, int clients, Meter* meter);
};

constexpr Part kParts[] = {{ServeLearners, MeasureLearners}, {ServeEnvironments, MeasureEnvServer}};

void RunClients(const Part& part, int to_parent, int from_parent) {
  wire::PollFewConnections();  // as craftfleet-actor
  Addresses addresses;
  CRAFTFLEET_CHECK(read(from_parent, &addresses, sizeof(addresses)) == sizeof(addresses));
  Meter meter(to_parent, from_parent, absl::GetFlag(FLAGS_seconds));
  part.measure(addresses, absl::GetFlag(FLAGS_clients), &meter);
}

// Forks the clients and serves them. Must be called in a process without other threads.
int RunPart(const Part& part) {
  int to_parent[2];
  int to_child[2];
  if (pipe(to_parent) != 0 || pipe(to_child) != 0) return 1;
  const pid_t child = fork();
  if (child == 0) {
    close(to_parent[0]);
    close(to_child[1]);
    RunClients(part, to_parent[1], to_child[0]);
    return 0;
  }
  close(to_parent[1]);
  close(to_child[0]);
  part.serve(to_parent[0], to_child[1]);
  int status = 0;
  waitpid(child, &status, 0);
  return status == 0 ? 0 : 1;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({craftfleet::kProgram, craftfleet::kUsage}, argc, argv);
  for (const craftfleet::Part& part : craftfleet::kParts) {
    const pid_t child = fork();
    if (child == 0) return craftfleet::RunPart(part);
    int status = 0;
    waitpid(child, &status, 0);
    if (status != 0) return 1;
  }
  return 0;
}
