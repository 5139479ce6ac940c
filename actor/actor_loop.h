// A playing thread: turns permits into fragments.

#pragma once

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
#include "actor/env_server_tracker.h"
#include "actor/error_policy.h"
#include "actor/learner_client.h"
#include "actor/learner_stream.h"
#include "actor/permit_tracker.h"
#include "actor/policy_source.h"
#include "common/agent/policy.h"
#include "common/base/clock.h"
#include "common/telemetry/activity_meter.h"
#include "common/telemetry/limited_log.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Takes its waiting permits and plays their lanes side by side, one fragment each. A lane continues if its game is open
// here at that fragment; others are restored from the learner's snapshots. Run is called from one thread.
class ActorLoop {
 public:
  struct Options {
    int index = 0;  // of this loop, for the permit tracker
    v1::RunConfig config;
    int frame_bytes = 0;
    int state_size = 0;              // of the agent's recurrent state or memory
    bool keeps_every_state = false;  // fragments hold the state before each step (KeepsEveryState)
    // The format in which fragments are sent now if their games' frames have it or are raw; outlives the loop. Null:
    // raw.
    const std::atomic<FrameFormat>* format = nullptr;
  };

  // Reports the state of the environment servers to `servers`.
  ActorLoop(const Options& options, const LearnerClient* learner, PermitTracker* permits, PolicySource* policies,
            LearnerStream* stream, std::unique_ptr<EnvPool> envs, EnvServerTracker* servers);

  // Plays until the permit tracker closes. Returns ok then, or the first error that waiting does not resolve.
  absl::Status Run();
  // Ends the environment sessions, so that a blocked step returns. May be called from any thread.
  void Cancel() { envs_->Cancel(); }

  // How the time is spent, and the number of steps played. This and the next two may be called from any thread.
  const ActivityMeter& meter() const { return meter_; }
  // The number of fragments whose permits were returned unplayed or unfinished.
  int64_t abandoned() const { return abandoned_.load(); }
  // The version of the policy last used; -1: none yet.
  int64_t policy_version() const { return policy_version_.load(); }

 private:
  // A lane whose game is open here.
  struct Game {
    int64_t epoch = 0;
    int64_t next_fragment = 0;
    int64_t policy_version = -1;  // version it was last played with here; -1: none
    std::string frame;            // uint8[H,W,3]: its current observation
    std::string record;           // the scene record of that; empty: its server sends raw frames
    std::vector<float> state;     // [state_size] before it
  };
  // A lane whose fragment is being played.
  struct Row {
    HeldPermit permit;
    Fragment fragment;   // its steps so far
    std::string record;  // of the current observation, as in Game
  };

  // Plays one fragment of each permit's lane; all have one version of the weights. After an error, rows_ has the
  // permits that must still be released; those of lanes lost by an environment server have already been released.
  absl::Status RunFragment(const std::vector<HeldPermit>& permits);
  // To be called before the first fragment with `version`: closes the games that were not played here with the previous
  // version, or the max_staleness before it, since other actors now play their lanes.
  absl::Status CloseLanesOfOthers(int64_t version);
  // Opens the games of all rows; removes the rows whose lanes can't be played.
  absl::Status OpenLanes();
  // Opens the games of `missing`, which are not open here.
  absl::Status OpenMissing(const std::vector<HeldPermit>& missing);
  // Reports that the lane of `permit` can't be played from its snapshot, releases the permit and removes its row.
  void Fail(const HeldPermit& permit, const std::string& reason);
  // Puts the rows in the order in which the pool steps them.
  void ArrangeRows();
  std::vector<int> Lanes() const;
  // Takes the observations and states of the rows, and begins their fragments.
  void StartFragments();
  // Plays T steps. The rows' fragments get the results; frames_ and states_ become the policy's next input.
  absl::Status PlaySteps(const Policy& policy);
  // Appends a step to the rows that were not lost in it.
  absl::Status AppendStep(const Policy& policy, const ActResult& act, EnvPool::Stepped* stepped);
  // Agents with a memory: updates those of the rows that unlocked an achievement in this step and play on.
  absl::Status UpdateMemories(const Policy& policy, const EnvPool::Stepped& stepped);
  // Removes the rows of lanes that an environment server lost.
  void DropRows(const std::vector<int>& lost);
  absl::Status SendFragments(const Policy& policy);
  // Releases the permits of the rows, and closes all games.
  void Abandon();
  // Forgets games that are no longer open.
  void Forget(const std::vector<int>& lanes);
  void ReportServers();
  absl::string_view Frame(size_t row) const {
    return absl::string_view(frames_).substr(row * options_.frame_bytes, options_.frame_bytes);
  }
  absl::Span<float> State(size_t row) {
    return absl::MakeSpan(states_).subspan(row * options_.state_size, options_.state_size);
  }

  const Options options_;
  const LearnerClient* const learner_;
  PermitTracker* const permits_;
  PolicySource* const policies_;
  LearnerStream* const stream_;
  const std::unique_ptr<EnvPool> envs_;
  EnvServerTracker* const servers_;

  std::optional<CallKind> call_;  // the current call; unset: our own code, whose errors are not retried
  std::map<int, Game> games_;     // by lane
  std::vector<Row> rows_;
  std::string frames_;         // uint8[n,H,W,3]: the policy's next input, by row
  std::vector<float> states_;  // [n,state_size] before it

  RealClock clock_;
  LimitedLog log_{&clock_};  // of what is tried again as long as no server can be used
  ActivityMeter meter_{&clock_, Activity::kPermits};
  absl::Time reported_ = absl::InfinitePast();  // when servers_ was last updated
  std::atomic<int64_t> abandoned_{0};
  std::atomic<int64_t> policy_version_{-1};
};

}  // namespace craftfleet
