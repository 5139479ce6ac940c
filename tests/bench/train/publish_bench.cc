// Measures what lies between an update and the next step of play in one process: saving the weights, fetching them and
// making a policy of them.

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "actor/learner_client.h"
#include "actor/policy_source.h"
#include "common/agent/agent_spec.h"
#include "common/agent/initial_weights.h"
#include "common/agent/weights.h"
#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/process/program.h"
#include "common/wire/server.h"
#include "learner/service/learner_service.h"

ABSL_FLAG(std::string, agent, "ppo_spcnn", "agent");
ABSL_FLAG(int32_t, rounds, 8, "updates to publish, after one that is not counted");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "publish_bench";
constexpr int kTile = 16;
constexpr char kUsage[] =
    "publish_bench prints how long an update's weights take until an actor in the same process can play with them; see "
    "tests/bench/README.md.";

double Seconds(absl::Time since) { return absl::ToDoubleSeconds(absl::Now() - since); }

absl::Status Run() {
  v1::RunConfig config = DefaultRunConfig();
  config.set_agent(absl::GetFlag(FLAGS_agent));
  CRAFTFLEET_ASSIGN_OR_RETURN(config, ResolveRunConfig(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  RealClock clock;
  WorkerRegistry registry({}, std::vector<LaneRecord>(LaneScheduler::Options().lanes), &clock);
  WeightStore store;
  FragmentQueue fragments(1);
  LearnerServiceImpl::Options options;
  options.config = config;
  LearnerServiceImpl service(options, &registry, &store, &fragments);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<wire::Server> server, wire::Server::Create({}, {&service}));
  const LearnerClient client(server->InProcess());
  const auto find = [&](int64_t version) {
    const WeightStore::Weights weights = store.Find(version);
    return VersionedWeights(weights.version, weights.bytes);
  };
  PolicySource by_call(&client, spec, kTile);
  PolicySource local(&client, spec, kTile, "cpu", find);

  const std::vector<float> weights = InitialWeights(spec, /*seed=*/1);
  const int rounds = absl::GetFlag(FLAGS_rounds);
  std::array<double, 3> sums = {};  // seconds: saving, a policy by a call, one in the process
  for (int version = 0; version <= rounds; ++version) {
    const absl::Time start = absl::Now();
    store.Publish(version, std::make_shared<const std::string>(SaveWeights(spec, weights)));
    const double saved = Seconds(start);
    CRAFTFLEET_RETURN_IF_ERROR(by_call.Get(/*epoch=*/0, version).status());
    const double called = Seconds(start);
    CRAFTFLEET_RETURN_IF_ERROR(local.Get(/*epoch=*/0, version).status());
    if (version == 0) continue;
    sums[0] += saved;
    sums[1] += called - saved;
    sums[2] += Seconds(start) - called;
  }
  absl::PrintF("%s, %.1f MiB of weights: saved in %.1f ms; a policy of them by a call in %.1f ms, without in %.1f ms\n",
               spec.name, static_cast<double>(weights.size()) * sizeof(float) / (1 << 20), 1e3 * sums[0] / rounds,
               1e3 * sums[1] / rounds, 1e3 * sums[2] / rounds);
  server->Stop(absl::Milliseconds(200));
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({craftfleet::kProgram, craftfleet::kUsage}, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
