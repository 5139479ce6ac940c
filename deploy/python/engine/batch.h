// Many games stepped together on several threads, for craftfleet.VectorEnv.

#pragma once

#include <sys/types.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/worker_pool.h"
#include "engine/lane.h"
#include "engine/setup.h"

namespace craftfleet {

// When a lane whose episode has ended starts its next one. Source: Gymnasium's AutoresetMode.
enum class Autoreset {
  kNextStep,  // in the next step, which ignores the action
  kSameStep,  // in the same step; the end is kept in final_rows()
  kDisabled,  // the caller resets it
};

// Thread-compatible: a call while another thread is in one fails, and changes nothing. A forked process may use its
// copy, unless another thread was in a call at the fork: its games may be half stepped, and every call fails.
class Batch {
 public:
  struct Options {
    int lanes = 1;    // 1 or more
    int threads = 1;  // 1 or more, the caller's included
    Autoreset autoreset = Autoreset::kNextStep;
    bool reward = true;     // false: step_rewards() stay 0
    bool semantic = false;  // whether rows have the semantic view
  };

  // What an agent sees of each game, a row for a lane. The arrays never move.
  struct Rows {
    Rows(const Setup& setup, int lanes, bool semantic);

    size_t frame_bytes;
    size_t semantic_bytes;              // 0: none
    std::vector<uint8_t> frames;        // [n][H][W][3]
    std::vector<uint8_t> semantic;      // [n][width][height]: World::SemanticView
    std::vector<int64_t> inventory;     // [n][16], 0..9
    std::vector<int64_t> achievements;  // [n][22]: times unlocked in this episode
    std::vector<int64_t> positions;     // [n][2]: the player's cell
    std::vector<double> rewards;        // [n]: of the step that led here; 0 at an episode's start
    std::vector<double> discounts;      // [n]: 0 at a death, else 1

    absl::Span<uint8_t> frame(int lane) { return absl::MakeSpan(frames).subspan(lane * frame_bytes, frame_bytes); }
    // Fills all of a row but its frame.
    void Fill(int lane, const Lane& game, double reward);
    void Copy(int lane, const Rows& from);
  };

  Batch(std::shared_ptr<const Setup> setup, const Options& options);
  ~Batch();
  Batch(const Batch&) = delete;
  Batch& operator=(const Batch&) = delete;

  // Starts the next episode of each lane of `lanes`; of those in `seeded`, the first one of seeds[lane].
  //   FailedPrecondition: the system does not start the threads; also of Step. No lane moves.
  absl::Status Reset(const std::vector<int>& lanes, const std::vector<bool>& seeded, const std::vector<int64_t>& seeds);
  // One action for each lane.
  //   InvalidArgument: an action out of its range; FailedPrecondition: a lane that is to be reset first. Both name the
  //   lane, and no lane moves.
  absl::Status Step(absl::Span<const int64_t> actions);
  // Lane::Save() and Lane::Restore(); FailedPrecondition: not reset yet.
  absl::StatusOr<std::string> Save(int lane);
  absl::Status Restore(int lane, absl::string_view snapshot);
  // Lane::Redraw().
  absl::Status Redraw(int lane, const Renderer& renderer, absl::Span<uint8_t> frame);

  const Setup& setup() const { return *setup_; }
  const Options& options() const { return options_; }
  bool started(int lane) const { return lanes_[lane].started(); }
  Rows& rows() { return rows_; }
  // With kSameStep: of the lanes that the last step ended, the row at the end.
  Rows& final_rows() { return final_rows_; }
  double* step_rewards() { return step_rewards_.data(); }  // [n]
  bool* terminated() { return terminated_.get(); }         // [n]
  bool* truncated() { return truncated_.get(); }           // [n]

 private:
  absl::Status CheckStep() const;  // of actions_
  absl::Status CheckStarted(int lane) const;
  void ResetLane(int lane);
  void StepLane(int lane, Action action);
  void SetEnd(int lane, StepEnd end);
  // Calls `part` for the numbers 0..count-1 on all threads; for none if they can't be started.
  absl::Status ForEach(int count, const std::function<void(int)>& part);
  absl::Status StartThreads();

  const std::shared_ptr<const Setup> setup_;
  const Options options_;
  std::vector<Lane> lanes_;
  Rows rows_;
  Rows final_rows_;
  std::vector<int64_t> actions_;  // of the step in progress
  std::vector<double> step_rewards_;
  std::unique_ptr<bool[]> terminated_;
  std::unique_ptr<bool[]> truncated_;
  std::atomic<bool> busy_{false};
  std::unique_ptr<WorkerPool> pool_;
  pid_t pool_owner_;  // the process that has the pool's threads: a fork doesn't copy them
};

}  // namespace craftfleet
