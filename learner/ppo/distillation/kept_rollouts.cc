#include "learner/ppo/distillation/kept_rollouts.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include <absl/status/statusor.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>

#include "common/base/check.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr char kIterationKey[] = "kept.iteration";  // of the first rollout
constexpr char kCountKey[] = "kept.count";
constexpr char kAtStartKey[] = "kept.at_start";

std::string TensorName(int64_t index, absl::string_view what) { return absl::StrCat("kept.", index, ".", what); }

absl::string_view BytesOf(const std::vector<float>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)};
}

std::vector<float> FloatsOf(absl::string_view bytes) {
  std::vector<float> values(bytes.size() / sizeof(float));
  std::memcpy(values.data(), bytes.data(), values.size() * sizeof(float));
  return values;
}

absl::StatusOr<absl::string_view> FindTensor(const SafeTensors& file, const std::string& name, SafeTensor::Type type) {
  for (const SafeTensor& tensor : file.tensors) {
    if (tensor.name == name && tensor.type == type) return tensor.data;
  }
  return absl::InvalidArgumentError(absl::StrCat("the optimiser has no tensor \"", name, "\""));
}

absl::Status BadTensor(const std::string& name) {
  return absl::InvalidArgumentError(absl::StrCat("the optimiser's tensor \"", name, "\" has another shape or content"));
}

absl::Status ReadCount(const SafeTensors& file, const char* key, int64_t* count) {
  const auto entry = file.metadata.find(key);
  if (entry != file.metadata.end() && absl::SimpleAtoi(entry->second, count) && *count >= 0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("the optimiser's metadata \"", key, "\" is not a count"));
}

}  // namespace

std::vector<StepRange> WholeEpisodes(absl::Span<const uint8_t> is_start) {
  std::vector<StepRange> episodes;
  int first = -1;  // of the episode being read; -1: none has begun yet
  for (int t = 0; t < static_cast<int>(is_start.size()); ++t) {
    if (!is_start[t]) continue;
    if (first >= 0) episodes.push_back({first, t});
    first = t;
  }
  return episodes;
}

std::vector<int> GoalSteps(absl::Span<const uint8_t> unlocked) {
  std::vector<int> goals;
  for (int t = 0; t + 1 < static_cast<int>(unlocked.size()); ++t) {
    if (unlocked[t]) goals.push_back(t);
  }
  return goals;
}

FramePair NextGoal(absl::Span<const int> goals, int length, int t) {
  const auto* const next = std::lower_bound(goals.begin(), goals.end(), t);
  return next == goals.end() ? FramePair{length - 1, kNoFrame} : FramePair{*next, *next + 1};
}

KeptRollouts::KeptRollouts(int lanes, int64_t frame_bytes, int memory_size)
    : lanes_(lanes), frame_bytes_(frame_bytes), memory_size_(memory_size), at_start_(lanes, '0') {}

void KeptRollouts::Add(int64_t iteration, const Rollout& rollout) {
  DropFrom(iteration);
  CRAFTFLEET_CHECK(rollout.size() % lanes_ == 0 && (kept_.empty() || rollout.size() == kept_.front().returns.size()));
  Kept kept;
  kept.iteration = iteration;
  kept.returns = rollout.returns;
  kept.frames.reserve(rollout.size() * frame_bytes_);
  const std::vector<float> zero(memory_size_);
  const float* last = zero.data();
  for (size_t row = 0; row < rollout.size(); ++row) {
    kept.frames.append(reinterpret_cast<const char*>(rollout.frames[row]), frame_bytes_);
    kept.steps.push_back(static_cast<char>(rollout.actions[row]));
    kept.steps.push_back(UnlocksAchievement(rollout.rewards[row]) ? 1 : 0);
    kept.steps.push_back(rollout.ends[row] == StepEnd::kNone ? 0 : 1);
    const float* memory = rollout.states.empty() || rollout.states[row] == nullptr ? zero.data() : rollout.states[row];
    const auto equals = [&](const float* other) { return std::equal(memory, memory + memory_size_, other); };
    const MemoryChange change = equals(last) ? kSame : equals(zero.data()) ? kZero : kNew;
    kept.steps.push_back(change);
    if (change == kNew) kept.memories.insert(kept.memories.end(), memory, memory + memory_size_);
    last = memory;
  }
  IndexMemories(&kept);
  kept_.push_back(std::move(kept));
}

int KeptRollouts::IndexMemories(Kept* kept) {
  int count = 0;
  int memory = kNoMemory;
  for (size_t row = 0; row < kept->returns.size(); ++row) {
    const char change = kept->steps[row * kStepBytes + kMemory];
    if (change == kNew) memory = count++;
    if (change == kZero) memory = kNoMemory;
    kept->memory_of.push_back(memory);
  }
  return count;
}

void KeptRollouts::DropFrom(int64_t iteration) {
  kept_.erase(std::remove_if(kept_.begin(), kept_.end(), [&](const Kept& kept) { return kept.iteration >= iteration; }),
              kept_.end());
}

void KeptRollouts::Clear() {
  if (kept_.empty()) return;
  const int steps = static_cast<int>(kept_.size()) * lane_steps();
  for (int lane = 0; lane < lanes_; ++lane) at_start_[lane] = StepByteOf(lane, steps - 1, kEnded) != 0 ? '1' : '0';
  kept_.clear();
}

int KeptRollouts::RowOf(int lane, int step) const {
  return step / lane_steps() * rows_each() + lane * lane_steps() + step % lane_steps();
}

char KeptRollouts::StepByteOf(int lane, int step, StepByte byte) const {
  const int row = RowOf(lane, step);
  return kept_[row / rows_each()].steps[row % rows_each() * kStepBytes + byte];
}

std::vector<KeptEpisode> KeptRollouts::Episodes() const {
  std::vector<KeptEpisode> episodes;
  const int steps = static_cast<int>(kept_.size()) * lane_steps();
  for (int lane = 0; lane < lanes_; ++lane) {
    std::vector<uint8_t> is_start;
    std::vector<uint8_t> unlocked;
    for (int t = 0; t < steps; ++t) {
      is_start.push_back(t == 0 ? at_start_[lane] == '1' : StepByteOf(lane, t - 1, kEnded) != 0);
      unlocked.push_back(StepByteOf(lane, t, kUnlocked));
    }
    for (const StepRange& range : WholeEpisodes(is_start)) {
      KeptEpisode episode;
      episode.goals = GoalSteps(absl::MakeConstSpan(unlocked).subspan(range.first, range.end - range.first));
      if (episode.goals.empty()) continue;
      for (int t = range.first; t < range.end; ++t) episode.rows.push_back(RowOf(lane, t));
      episodes.push_back(std::move(episode));
    }
  }
  return episodes;
}

int KeptRollouts::rows() const { return static_cast<int>(kept_.size()) * rows_each(); }

const uint8_t* KeptRollouts::frame(int row) const {
  const std::string& frames = kept_[row / rows_each()].frames;
  return reinterpret_cast<const uint8_t*>(frames.data()) + row % rows_each() * frame_bytes_;
}

Action KeptRollouts::action(int row) const {
  return static_cast<Action>(kept_[row / rows_each()].steps[row % rows_each() * kStepBytes + kAction]);
}

float KeptRollouts::return_of(int row) const { return kept_[row / rows_each()].returns[row % rows_each()]; }

const float* KeptRollouts::memory(int row) const {
  const Kept& kept = kept_[row / rows_each()];
  const int memory = kept.memory_of[row % rows_each()];
  return memory == kNoMemory ? nullptr : &kept.memories[static_cast<size_t>(memory) * memory_size_];
}

void KeptRollouts::Save(SafeTensors* file) const {
  file->metadata[kAtStartKey] = at_start_;
  file->metadata[kCountKey] = absl::StrCat(kept_.size());
  file->metadata[kIterationKey] = absl::StrCat(kept_.empty() ? 0 : kept_.front().iteration);
  int64_t i = 0;
  for (const Kept& kept : kept_) {
    const auto rows = static_cast<int64_t>(kept.returns.size());
    const auto memories = static_cast<int64_t>(kept.memories.size()) / std::max(memory_size_, 1);
    file->tensors.push_back({TensorName(i, "returns"), {rows}, BytesOf(kept.returns)});
    file->tensors.push_back({TensorName(i, "memories"), {memories, memory_size_}, BytesOf(kept.memories)});
    file->tensors.push_back({TensorName(i, "frames"), {rows, frame_bytes_}, kept.frames, SafeTensor::Type::kUint8});
    file->tensors.push_back({TensorName(i, "steps"), {rows, kStepBytes}, kept.steps, SafeTensor::Type::kUint8});
    ++i;
  }
}

absl::Status KeptRollouts::LoadOne(const SafeTensors& file, int64_t index, Kept* kept) const {
  constexpr auto kFloat32 = SafeTensor::Type::kFloat32;
  constexpr auto kUint8 = SafeTensor::Type::kUint8;
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::string_view returns,
                              FindTensor(file, TensorName(index, "returns"), kFloat32));
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::string_view memories,
                              FindTensor(file, TensorName(index, "memories"), kFloat32));
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::string_view frames, FindTensor(file, TensorName(index, "frames"), kUint8));
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::string_view steps, FindTensor(file, TensorName(index, "steps"), kUint8));
  kept->returns = FloatsOf(returns);
  kept->memories = FloatsOf(memories);
  kept->frames = std::string(frames);
  kept->steps = std::string(steps);
  const size_t rows = kept->returns.size();
  if (rows == 0 || rows % lanes_ != 0) return BadTensor(TensorName(index, "returns"));
  if (frames.size() != rows * frame_bytes_) return BadTensor(TensorName(index, "frames"));
  if (steps.size() != rows * kStepBytes) return BadTensor(TensorName(index, "steps"));
  for (size_t row = 0; row < rows; ++row) {
    const char* step = &kept->steps[row * kStepBytes];
    if (static_cast<uint8_t>(step[kAction]) >= kNumActions) return BadTensor(TensorName(index, "steps"));
  }
  const int count = IndexMemories(kept);
  if (kept->memories.size() != static_cast<size_t>(count) * memory_size_) {
    return BadTensor(TensorName(index, "memories"));
  }
  return absl::OkStatus();
}

absl::Status KeptRollouts::Load(const SafeTensors& file) {
  int64_t count = 0;
  int64_t iteration = 0;
  CRAFTFLEET_RETURN_IF_ERROR(ReadCount(file, kCountKey, &count));
  CRAFTFLEET_RETURN_IF_ERROR(ReadCount(file, kIterationKey, &iteration));
  const auto at_start = file.metadata.find(kAtStartKey);
  if (at_start == file.metadata.end() || at_start->second.size() != static_cast<size_t>(lanes_)) {
    return absl::InvalidArgumentError(
        absl::StrCat("the optimiser's metadata \"", kAtStartKey, "\" does not have ", lanes_, " lanes"));
  }
  std::vector<Kept> kept;
  for (int64_t i = 0; i < count; ++i) {
    kept.emplace_back();
    kept.back().iteration = iteration + i;
    CRAFTFLEET_RETURN_IF_ERROR(LoadOne(file, i, &kept.back()));
    if (kept.back().returns.size() != kept.front().returns.size()) return BadTensor(TensorName(i, "returns"));
  }
  kept_ = std::move(kept);
  at_start_ = at_start->second;
  return absl::OkStatus();
}

}  // namespace craftfleet
