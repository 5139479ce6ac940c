#include "actor/recording/episode_table.h"

#include <cmath>
#include <utility>

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

template <typename T>
void AppendBytes(const T& value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Rewards are multiples of 0.1, which the float32 of the protocol does not hold exactly.
double InTenths(float reward) { return std::round(double{reward} * 10) / 10; }

}  // namespace

EpisodeTable::EpisodeTable(int frame_size, const Moment& first)
    : frame_size_(frame_size), images_(first.frame), semantics_(kWorldSize * kWorldSize, '\0'), table_(1) {}

void EpisodeTable::Add(const ObservedStep& step, const Moment& moment) {
  images_ += moment.frame;
  semantics_ += moment.semantic;
  Row& row = table_.emplace_back();
  row.action = step.action;
  row.reward = InTenths(step.reward);
  row.done = step.end != StepEnd::kNone;
  row.discount = step.end == StepEnd::kTerminated ? 0 : 1;
  row.player_pos = {moment.player_x, moment.player_y};
  row.achievements = moment.achievements;
  row.inventory = moment.inventory;
}

std::vector<NpyArray> EpisodeTable::Arrays() const {
  const auto rows = static_cast<int64_t>(table_.size());
  std::vector<NpyArray> arrays;
  arrays.push_back({"image", "|u1", {rows, frame_size_, frame_size_, 3}, images_});
  // Appends `value(row)` of each row to the bytes of a column.
  const auto add = [&](std::string name, const char* dtype, std::vector<int64_t> shape, auto value) {
    NpyArray& array = arrays.emplace_back();
    array.name = std::move(name);
    array.dtype = dtype;
    array.shape = std::move(shape);
    for (const Row& row : table_) AppendBytes(value(row), &array.data);
  };
  add("action", "<i8", {rows}, [](const Row& row) { return static_cast<int64_t>(row.action); });
  add("reward", "<f8", {rows}, [](const Row& row) { return row.reward; });
  add("done", "|b1", {rows}, [](const Row& row) { return row.done; });
  add("discount", "<f8", {rows}, [](const Row& row) { return row.discount; });
  arrays.push_back({"semantic", "|u1", {rows, kWorldSize, kWorldSize}, semantics_});
  add("player_pos", "<i8", {rows, 2}, [](const Row& row) { return row.player_pos; });
  for (int i = 0; i < kNumAchievements; ++i) {
    add(absl::StrCat("achievement_", kAchievementNames[i]), "<i8", {rows},
        [i](const Row& row) { return int64_t{row.achievements[i]}; });
  }
  for (int i = 0; i < kNumItems; ++i) {
    add(absl::StrCat("ainventory_", kItemNames[i]), "<i8", {rows},
        [i](const Row& row) { return int64_t{row.inventory[i]}; });
  }
  return arrays;
}

}  // namespace craftfleet
