// What the requests of workers cost the learner's registry, by the number of actors. There are as many lanes, and half
// as many environment servers.
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <benchmark/benchmark.h>

#include "common/base/clock.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {
namespace {

// A fleet whose actors have a permit each, or the first to join has all.
class BusyFleet {
 public:
  explicit BusyFleet(int actors, bool one_plays_all = false) : actors_(actors) {
    WorkerRegistry::Options options;
    options.lanes.lanes = actors;
    options.lanes.lease = absl::Hours(1);
    options.server_lease = absl::Hours(1);
    options.names.max_names_per_client = 4 * actors;
    const SharedSnapshot snapshot(std::string(12000, 's'), {});
    registry =
        std::make_unique<WorkerRegistry>(options, std::vector<LaneRecord>(actors, {0, snapshot, snapshot}), &clock_);
    for (int i = 0; i < actors / 2; ++i) Announce(i);
    if (one_plays_all) {
      Join(0);
      Open();
      Ask(0, {});
    }
    for (int i = 0; i < actors; ++i) Join(i);
    if (one_plays_all) return;
    Open();
    for (int i = 0; i < actors; ++i) Ask(i, {});
  }

  static std::string NameOf(int actor) { return absl::StrCat("host-", actor, "-0123456789abcdef"); }
  static std::string HostOf(int worker) { return absl::StrCat("ipv4:10.0.", worker / 256, ".", worker % 256); }
  void Join(int i) { registry->Join({"", HostOf(i)}, NameOf(i), "", {}).IgnoreError(); }
  void Announce(int i) {
    registry->Announce({"", HostOf(i)}, absl::StrCat("server-", i), absl::StrCat("server", i, ":50061"), 1, {})
        .IgnoreError();
  }
  void Open() {
    ++last_fragment_;
    registry->lanes()->rollouts().OpenIteration(last_fragment_, /*policy_version=*/last_fragment_);
  }
  // The actor's request, which reports `active`.
  WorkerRegistry::PermitReply Ask(int actor, std::vector<Permit> active) {
    WorkerRegistry::PermitRequest request;
    request.client.host = HostOf(actor);
    request.actor = NameOf(actor);
    request.active = std::move(active);
    request.capacity = actors_;
    request.wants_servers = true;
    request.servers_generation = generations_[actor];
    auto given = registry->TryPermits(request, /*first=*/true, /*last=*/true);
    WorkerRegistry::PermitReply reply = (*given).value_or(WorkerRegistry::PermitReply());
    generations_[actor] = reply.servers_generation;
    if (!reply.granted.empty()) permits_[actor] = reply.granted;
    return reply;
  }
  const std::vector<Permit>& PermitsOf(int actor) { return permits_[actor]; }
  void Accept(int actor) {
    for (const Permit& permit : permits_[actor]) {
      registry->Accept(NameOf(actor), permit, {std::string(12000, 's'), {}}).status().IgnoreError();
    }
    permits_[actor].clear();
  }

  std::unique_ptr<WorkerRegistry> registry;

 private:
  const int actors_;
  RealClock clock_;
  int64_t last_fragment_ = 0;
  std::vector<std::vector<Permit>> permits_ = std::vector<std::vector<Permit>>(actors_);
  std::vector<int64_t> generations_ = std::vector<int64_t>(actors_);
};

// An actor renews its permit and gets nothing else.
void Renew(benchmark::State& state) {
  const auto actors = static_cast<int>(state.range(0));
  BusyFleet fleet(actors);
  int i = 0;
  for (auto _ : state) {
    fleet.Ask(i, fleet.PermitsOf(i));
    i = (i + 1) % actors;
  }
}

// An actor whose fragment is accepted has nothing else to play, and asks.
void Idle(benchmark::State& state) {
  const auto actors = static_cast<int>(state.range(0));
  BusyFleet fleet(actors);
  for (int i = 0; i < actors / 2; ++i) fleet.Accept(i);
  int i = 0;
  for (auto _ : state) {
    fleet.Ask(i, {});
    i = (i + 1) % (actors / 2);
  }
}

// An actor that has just joined asks, while the first one still plays all lanes.
void OnePlaysAll(benchmark::State& state) {
  const auto actors = static_cast<int>(state.range(0));
  BusyFleet fleet(actors, /*one_plays_all=*/true);
  int i = 1;
  for (auto _ : state) {
    fleet.Ask(i, {});
    i = i % (actors - 1) + 1;
  }
}

// All actors play a fragment; the time is per fragment.
void Iteration(benchmark::State& state) {
  const auto actors = static_cast<int>(state.range(0));
  BusyFleet fleet(actors);
  for (auto _ : state) {
    for (int i = 0; i < actors; ++i) fleet.Accept(i);
    fleet.Open();
    for (int i = 0; i < actors; ++i) fleet.Ask(i, {});
  }
  state.SetItemsProcessed(state.iterations() * actors);
}

// The learner opens an iteration of which nobody plays anything.
void OpenIteration(benchmark::State& state) {
  BusyFleet fleet(static_cast<int>(state.range(0)));
  for (auto _ : state) fleet.Open();
}

void Announce(benchmark::State& state) {
  const auto servers = static_cast<int>(state.range(0)) / 2;
  BusyFleet fleet(2 * servers);
  int i = 0;
  for (auto _ : state) {
    fleet.Announce(i);
    i = (i + 1) % servers;
  }
}

// A server leaves and returns, and the actors ask for their groups; the time is per such event.
void ServerReturns(benchmark::State& state) {
  const auto actors = static_cast<int>(state.range(0));
  BusyFleet fleet(actors);
  for (auto _ : state) {
    fleet.registry->Leave({"", BusyFleet::HostOf(1)}, WorkerRole::kEnvServer, "server-1", "server1:50061")
        .IgnoreError();
    for (int i = 0; i < actors; ++i) fleet.Ask(i, fleet.PermitsOf(i));
    fleet.Announce(1);
    for (int i = 0; i < actors; ++i) fleet.Ask(i, fleet.PermitsOf(i));
  }
}

// What a status reply takes from the registry, with its lock held.
void Status(benchmark::State& state) {
  BusyFleet fleet(static_cast<int>(state.range(0)));
  for (auto _ : state) {
    benchmark::DoNotOptimize(fleet.registry->Workers());
  }
}

#define FLEETS ->Arg(100)->Arg(1000)->Arg(10000)->Unit(benchmark::kMicrosecond)
BENCHMARK(Renew) FLEETS;
BENCHMARK(Idle) FLEETS;
BENCHMARK(OnePlaysAll) FLEETS;
BENCHMARK(Iteration) FLEETS;
BENCHMARK(OpenIteration) FLEETS;
BENCHMARK(Announce) FLEETS;
BENCHMARK(ServerReturns) FLEETS;
BENCHMARK(Status) FLEETS;

}  // namespace
}  // namespace craftfleet
