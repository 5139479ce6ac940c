// The rollouts since the last phase of distillation, the whole episodes in them, and the steps of these that unlocked
// something (Moon et al. 2023). No LibTorch.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>

#include "common/agent/safetensors.h"
#include "common/base/crafter.h"
#include "learner/ppo/rollout.h"

namespace craftfleet {

// Consecutive steps of one lane: first..end-1.
struct StepRange {
  int first = 0;
  int end = 0;
  friend bool operator==(const StepRange& a, const StepRange& b) { return a.first == b.first && a.end == b.end; }
};

// The episodes that begin within a lane's kept steps and end before the last of them. `is_start[t]`: step t is the
// first of an episode. What comes before the first start and after the last one belongs to episodes that are not whole.
std::vector<StepRange> WholeEpisodes(absl::Span<const uint8_t> is_start);

// The steps of an episode that unlocked an achievement, ascending. An unlock by the last step is none: no frame of the
// episode shows its effect.
std::vector<int> GoalSteps(absl::Span<const uint8_t> unlocked);

constexpr int kNoFrame = -1;

// Two frames of an episode, by step, whose features differ by an achievement.
struct FramePair {
  int before = 0;
  int after = 0;  // kNoFrame: nothing comes
};

// What step t, 0..length-1, should foresee: the next goal, its own included; after the last one, the end of the
// episode.
FramePair NextGoal(absl::Span<const int> goals, int length, int t);

// A whole episode with at least one achievement.
struct KeptEpisode {
  std::vector<int> rows;   // [L] of the kept rollouts, in the order of its steps
  std::vector<int> goals;  // steps 0..L-2 that unlocked something, ascending (GoalSteps)
};

// Rows are numbered over all kept rollouts, each as in Rollout. Copies of their frames are kept, and a memory for each
// achievement instead of each row. Thread-compatible.
class KeptRollouts {
 public:
  // Rollouts of `lanes` lanes, equal in size. `memory_size`: floats of the agent's memory; 0: none.
  KeptRollouts(int lanes, int64_t frame_bytes, int memory_size);

  // Adds the rollout of `iteration`, after dropping it and later ones.
  void Add(int64_t iteration, const Rollout& rollout);
  // Drops the rollouts of `iteration` and later ones.
  void DropFrom(int64_t iteration);
  // Drops all, but keeps in mind which lanes are at the start of an episode.
  void Clear();

  // Lane by lane, each in the order of time. Those of lanes that were in an episode when the run, or the kept rollouts,
  // began are not whole.
  std::vector<KeptEpisode> Episodes() const;

  int rows() const;
  const uint8_t* frame(int row) const;  // uint8[H,W,3]
  Action action(int row) const;         // taken
  float return_of(int row) const;       // from GAE of its iteration
  const float* memory(int row) const;   // float[memory_size] before the step; null: zero

  // Adds their tensors and metadata to `file`, whose tensors share this object's memory. For rollout I = 0, 1, ... with
  // n rows, lane by lane: kept.I.frames uint8[n,bytes], kept.I.steps uint8[n,4] (StepByte), kept.I.returns float32[n]
  // and kept.I.memories float32[k,F]. Metadata: kept.count, kept.iteration of the first one, kept.at_start.
  void Save(SafeTensors* file) const;
  // The inverse.   InvalidArgument: missing or of another shape; names the tensor. Nothing is changed.
  absl::Status Load(const SafeTensors& file);

 private:
  // What is known of a step, a byte each: its action, whether it unlocked an achievement, whether it ended its episode,
  // and a MemoryChange.
  enum StepByte { kAction, kUnlocked, kEnded, kMemory, kStepBytes };
  // The memory before a step, compared with that of the row before.
  enum MemoryChange : char { kSame, kNew, kZero };
  struct Kept {
    int64_t iteration = 0;
    std::string frames;           // uint8[n,H,W,3]
    std::string steps;            // uint8[n,kStepBytes]
    std::vector<float> returns;   // [n]
    std::vector<float> memories;  // float[k,memory_size]: those that are new
    std::vector<int> memory_of;   // [n] into `memories`; kNoMemory: zero
  };
  static constexpr int kNoMemory = -1;

  // Fills `memory_of` from the steps; returns the number of memories.
  static int IndexMemories(Kept* kept);
  absl::Status LoadOne(const SafeTensors& file, int64_t index, Kept* kept) const;
  // What `byte` says of step `step` of `lane`, over all kept rollouts.
  char StepByteOf(int lane, int step, StepByte byte) const;
  int RowOf(int lane, int step) const;
  int rows_each() const { return kept_.empty() ? 0 : static_cast<int>(kept_.front().returns.size()); }
  int lane_steps() const { return rows_each() / lanes_; }  // of one rollout

  const int lanes_;
  const int64_t frame_bytes_;
  const int memory_size_;
  std::vector<Kept> kept_;
  std::string at_start_;  // [lanes] '1': the lane's first kept step is the first of an episode, else '0'
};

}  // namespace craftfleet
