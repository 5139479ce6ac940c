// Plays: one thread that turns permits into fragments.

#ifndef CRAFTFLEET_ACTOR_ACTOR_LOOP_H_
#define CRAFTFLEET_ACTOR_ACTOR_LOOP_H_

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "actor/env_pool.h"
#include "actor/fragment_builder.h"
#include "actor/fragment_sender.h"
#include "actor/learner_client.h"
#include "actor/permit_book.h"
#include "actor/policy_source.h"
#include "common/agent/policy.h"
#include "common/rate_meter.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Where a loop's time goes, in nanoseconds, and what it did. Written by the loop, read by anyone.
struct LoopCounters {
  std::atomic<int64_t> steps{0};      // environment steps
  std::atomic<int64_t> abandoned{0};  // fragments begun and not finished
  std::atomic<int64_t> policy_ns{0};  // in the policy
  std::atomic<int64_t> env_ns{0};     // waiting for environment servers
  std::atomic<int64_t> send_ns{0};    // handing over fragments
};

// Takes what the permit book has for it and plays those lanes side by side, one fragment each. A lane that it holds at
// that fragment goes on; another is restored from the learner's snapshot. Run is called from one thread.
class ActorLoop {
 public:
  struct Options {
    int index = 0;  // of this loop, for the permit book
    v1::RunConfig config;
    int frame_bytes = 0;
    int state_size = 0;  // of the agent's recurrent state
  };

  // Steps are counted into `rate`.
  ActorLoop(const Options& options, const LearnerClient* learner, PermitBook* permits, PolicySource* policies,
            FragmentSender* sender, std::unique_ptr<EnvPool> envs, RateMeter* rate);

  // Plays until the permit book closes. Returns ok then, or the first error that waiting can't mend.
  absl::Status Run();
  // Ends the environment sessions: a blocked step returns. From any thread.
  void Cancel() { envs_->Cancel(); }

  const LoopCounters& counters() const { return counters_; }

 private:
  // A lane whose game is open here.
  struct Held {
    int64_t epoch = 0;
    int64_t next_fragment = 0;
    std::string frame;         // uint8[H,W,3]: its current observation
    std::vector<float> state;  // [state_size] before it
  };

  // Plays one fragment of each permit's lane, all under one version.
  absl::Status RunFragment(const std::vector<HeldPermit>& permits);
  absl::Status OpenLanes(const std::vector<HeldPermit>& permits);
  // Takes the observations and states of the lanes, arranged, and begins their fragments.
  void StartFragments(const std::vector<HeldPermit>& permits);
  // T steps of the lanes, arranged; builders_ hold the result, frames_ and states_ what the policy sees next.
  absl::Status PlaySteps(const Policy& policy, const std::vector<HeldPermit>& permits);
  absl::Status AppendStep(const Policy& policy, const std::vector<int>& lanes, const ActResult& act);
  absl::Status SendFragments(const Policy& policy, const std::vector<HeldPermit>& permits);
  void Abandon(const std::vector<HeldPermit>& permits);
  absl::string_view Frame(const std::string& frames, size_t row) const {
    return absl::string_view(frames).substr(row * options_.frame_bytes, options_.frame_bytes);
  }
  absl::Span<float> State(size_t row) {
    return absl::MakeSpan(states_).subspan(row * options_.state_size, options_.state_size);
  }

  const Options options_;
  const LearnerClient* const learner_;
  PermitBook* const permits_;
  PolicySource* const policies_;
  FragmentSender* const sender_;
  const std::unique_ptr<EnvPool> envs_;
  RateMeter* const rate_;

  std::map<int, Held> held_;               // by lane
  std::vector<FragmentBuilder> builders_;  // by row
  std::string frames_;                     // uint8[n,H,W,3]: what the policy sees next
  std::vector<float> states_;              // [n,state_size] before it
  StepBatch batch_;                        // reused
  LoopCounters counters_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ACTOR_LOOP_H_
