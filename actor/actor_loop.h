// Plays: one thread that turns permits into fragments.

#ifndef CRAFTFLEET_ACTOR_ACTOR_LOOP_H_
#define CRAFTFLEET_ACTOR_ACTOR_LOOP_H_

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "actor/env_pool.h"
#include "actor/error_policy.h"
#include "actor/fragment_builder.h"
#include "actor/fragment_sender.h"
#include "actor/learner_client.h"
#include "actor/permit_book.h"
#include "actor/policy_source.h"
#include "actor/server_book.h"
#include "common/activity_meter.h"
#include "common/agent/policy.h"
#include "common/clock.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

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

  // What it sees of the environment servers goes to `servers`.
  ActorLoop(const Options& options, const LearnerClient* learner, PermitBook* permits, PolicySource* policies,
            FragmentSender* sender, std::unique_ptr<EnvPool> envs, ServerBook* servers);

  // Plays until the permit book closes. Returns ok then, or the first error that waiting can't mend.
  absl::Status Run();
  // Ends the environment sessions: a blocked step returns. From any thread.
  void Cancel() { envs_->Cancel(); }

  // Where its time goes, and the environment steps that it played. From any thread, like the next two.
  const ActivityMeter& meter() const { return meter_; }
  // Fragments begun and not finished.
  int64_t abandoned() const { return abandoned_.load(); }
  // Version of the policy that it last played with; -1: none yet.
  int64_t policy_version() const { return policy_version_.load(); }

 private:
  // A lane whose game is open here.
  struct Held {
    int64_t epoch = 0;
    int64_t next_fragment = 0;
    int64_t policy_version = -1;  // under which it was last played here; -1: not yet
    std::string frame;            // uint8[H,W,3]: its current observation
    std::vector<float> state;     // [state_size] before it
  };

  // Plays one fragment of each permit's lane, all under one version. Leaves in `permits` what was played, or after an
  // error was to be played: without those that an environment server lost, which are given back.
  absl::Status RunFragment(std::vector<HeldPermit>* permits);
  // Before the first fragment under `version`: closes the games that were not played here under the last one, since
  // somebody else plays their lanes by now.
  absl::Status CloseLanesOfOthers(int64_t version);
  // Leaves in `permits` those whose lanes can be played.
  absl::Status OpenLanes(std::vector<HeldPermit>* permits);
  // Opens the games of `missing`, which are not open here. Takes out of `permits` those that can't be.
  absl::Status OpenMissing(const std::vector<HeldPermit>& missing, std::vector<HeldPermit>* permits);
  // Gives `permit` back for good: there is no game to play it from.
  void Fail(const HeldPermit& permit, const std::string& reason, std::vector<HeldPermit>* permits);
  // Takes the observations and states of the lanes, arranged, and begins their fragments.
  void StartFragments(const std::vector<HeldPermit>& permits);
  // T steps of the lanes, arranged; builders_ hold the result, frames_ and states_ what the policy sees next.
  absl::Status PlaySteps(const Policy& policy, std::vector<HeldPermit>* permits);
  // Takes the lanes that an environment server lost out of the fragments under way.
  void DropRows(const std::vector<int>& lost, std::vector<HeldPermit>* permits, ActResult* act);
  absl::Status AppendStep(const Policy& policy, const std::vector<HeldPermit>& permits, const ActResult& act);
  absl::Status SendFragments(const Policy& policy, const std::vector<HeldPermit>& permits);
  void Abandon(const std::vector<HeldPermit>& permits);
  // Forgets games that are no longer open.
  void Forget(const std::vector<int>& lanes);
  void ReportServers();
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
  ServerBook* const servers_;

  // Whose trouble an error is; nothing: our own, which does not pass.
  std::optional<Called> called_;
  std::map<int, Held> held_;               // by lane
  std::vector<FragmentBuilder> builders_;  // by row
  std::string frames_;                     // uint8[n,H,W,3]: what the policy sees next
  std::vector<float> states_;              // [n,state_size] before it
  StepBatch batch_;                        // reused

  RealClock clock_;
  ActivityMeter meter_{&clock_, Activity::kPermits};
  absl::Time reported_ = absl::InfinitePast();  // when servers_ was last told
  std::atomic<int64_t> abandoned_{0};
  std::atomic<int64_t> policy_version_{-1};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ACTOR_LOOP_H_
