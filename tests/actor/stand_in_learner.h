// A fake learner for the actor's tests, and its small run.

#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <absl/time/time.h>

#include "common/agent/agent_spec.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/convert.h"
#include "common/wire/server.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/sample_policy.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {

inline constexpr int kLanes = 4;
inline constexpr int kSteps = 8;                      // of a fragment
inline constexpr int64_t kFragmentsPerIteration = 2;  // of a lane
inline constexpr int kLength = 11;                    // of an episode; one ends in most fragments
inline constexpr int kFrameBytes = 64 * 64 * 3;
inline constexpr absl::Duration kLease = absl::Hours(1);  // no test waits for a lease to lapse, or races with it

// Fragments of recurrent agents have the state before each step, so that tests see its whole course.
inline v1::RunConfig Config(const std::string& agent) {
  v1::RunConfig config;
  config.set_agent(agent);
  config.mutable_ppo()->set_recurrent_batches(v1::PpoConfig::PUBLISHED);
  *config.mutable_env() = SampleHello(kLength).env();
  config.mutable_eval()->set_env("crafter");
  config.set_seed(3);
  config.set_lanes(kLanes);
  config.set_fragment_steps(kSteps);
  config.set_tile(2);
  return config;
}

inline wire::FragmentShape Shape(const std::string& agent) {
  const int state_size = FindAgent(agent)->state_size;
  wire::FragmentShape shape = {kLanes, kSteps, kFrameBytes, state_size, kSteps};
  shape.hidden = 256;
  shape.max_length = kLength;
  shape.env_digest = EnvDigest("crafter", kLength);
  return shape;
}

inline std::vector<LaneRecord> NewLanes(const std::string& agent) {
  return std::vector<LaneRecord>(kLanes, {0, {"", std::vector<float>(FindAgent(agent)->state_size)}});
}

// A learner that grants permits but does not train: iteration i is played with weights i.
class StandInLearner {
 public:
  StandInLearner(const std::string& agent, const std::string& address, int64_t epoch, std::vector<LaneRecord> lanes,
                 const std::string& texture_digest = "")
      : agent_(agent),
        registry_(Lanes(), std::move(lanes), &clock_),
        service_({"run-a", epoch, Config(agent), texture_digest, Shape(agent), absl::Seconds(5)}, &registry_, &weights_,
                 &fragments_),
        server_(*wire::Server::Create({address}, {&service_})) {}

  void Open(int64_t iteration) { Open(iteration, SampleWeights(iteration, agent_)); }
  void Open(int64_t iteration, std::string weights) {
    Publish(iteration, std::move(weights));
    registry_.OpenIteration((iteration + 1) * kFragmentsPerIteration, iteration);
  }
  // Returns the fragments of the open iteration, in order; fewer if they don't arrive within a minute.
  std::vector<Fragment> Collect() {
    std::vector<Fragment> fragments;
    while (fragments.size() < kLanes * kFragmentsPerIteration) {
      auto fragment = fragments_.Pop(absl::Minutes(1));
      if (!fragment.has_value()) break;
      fragments.push_back(*std::move(fragment));
    }
    std::sort(fragments.begin(), fragments.end(), [](const Fragment& a, const Fragment& b) {
      return std::tie(a.lane, a.number) < std::tie(b.lane, b.number);
    });
    return fragments;
  }
  void Publish(int64_t version) { Publish(version, SampleWeights(version, agent_)); }
  void Publish(int64_t version, std::string weights) {
    weights_.Publish(version, std::make_shared<HostWeights>(std::move(weights)));
  }
  // The outstanding permits of each actor. Empties the fragment queue, so that actors can continue.
  std::vector<int> OutstandingPermits() {
    while (fragments_.Pop(absl::ZeroDuration()).has_value()) {
    }
    std::vector<int> permits;
    for (const LaneActor& actor : registry_.Actors()) permits.push_back(static_cast<int>(actor.permits.size()));
    return permits;
  }
  TestRegistry& registry() { return registry_; }
  FragmentQueue& fragments() { return fragments_; }
  wire::Endpoint Connect() const { return wire::Connect(server_->address()); }

 private:
  static LaneScheduler::Options Lanes() {
    LaneScheduler::Options options;
    options.lanes = kLanes;
    options.lease = kLease;
    return options;
  }

  const std::string agent_;
  RealClock clock_;
  TestRegistry registry_;
  WeightStore weights_;
  FragmentQueue fragments_{100};
  LearnerServiceImpl service_;
  std::unique_ptr<wire::Server> server_;
};

}  // namespace craftfleet
