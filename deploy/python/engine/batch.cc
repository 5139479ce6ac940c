#include "engine/batch.h"

#include <unistd.h>

#include <algorithm>
#include <system_error>
#include <utility>

#include <absl/cleanup/cleanup.h>
#include <absl/strings/str_cat.h>

#include "common/base/openmp_places.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kPartsPerThread = 4;  // lanes take unequal time: a reset as much as a hundred steps

template <typename T>
void CopyRow(int row, const std::vector<T>& from, std::vector<T>* to, size_t width) {
  std::copy_n(from.begin() + row * width, width, to->begin() + row * width);
}

}  // namespace

// Returns from the enclosing method if another thread is in one; otherwise keeps the others out until its end.
#define CRAFTFLEET_ENTER_OR_RETURN()                                                                           \
  if (busy_.exchange(true)) {                                                                                  \
    return absl::FailedPreconditionError("another thread is in a call of this VectorEnv, want one at a time"); \
  }                                                                                                            \
  const absl::Cleanup leave = [this] { busy_ = false; }

Batch::Rows::Rows(const Setup& setup, int lanes, bool with_semantic)
    : frame_bytes(setup.renderer().frame_bytes()),
      semantic_bytes(with_semantic ? size_t{1} * setup.world().width * setup.world().height : 0),
      frames(lanes * frame_bytes),
      semantic(lanes * semantic_bytes),
      inventory(size_t{1} * lanes * kNumItems),
      achievements(size_t{1} * lanes * kNumAchievements),
      positions(size_t{2} * lanes),
      rewards(lanes),
      discounts(lanes) {}

void Batch::Rows::Fill(int lane, const Lane& game, double reward) {
  const World& world = game.world();
  const Player& player = world.player();
  std::copy(player.inventory.begin(), player.inventory.end(), inventory.begin() + lane * kNumItems);
  std::copy(player.achievements.begin(), player.achievements.end(), achievements.begin() + lane * kNumAchievements);
  positions[2 * lane] = world.player_position().x;
  positions[2 * lane + 1] = world.player_position().y;
  rewards[lane] = reward;
  discounts[lane] = player.health() > 0 ? 1 : 0;
  if (semantic_bytes > 0) {
    world.SemanticView(absl::MakeSpan(semantic).subspan(lane * semantic_bytes, semantic_bytes));
  }
}

void Batch::Rows::Copy(int lane, const Rows& from) {
  CopyRow(lane, from.frames, &frames, frame_bytes);
  CopyRow(lane, from.semantic, &semantic, semantic_bytes);
  CopyRow(lane, from.inventory, &inventory, kNumItems);
  CopyRow(lane, from.achievements, &achievements, kNumAchievements);
  CopyRow(lane, from.positions, &positions, 2);
  CopyRow(lane, from.rewards, &rewards, 1);
  CopyRow(lane, from.discounts, &discounts, 1);
}

Batch::Batch(std::shared_ptr<const Setup> setup, const Options& options)
    : setup_(std::move(setup)),
      options_(options),
      lanes_(options.lanes, Lane(setup_, 0)),
      rows_(*setup_, options.lanes, options.semantic),
      final_rows_(*setup_, options.autoreset == Autoreset::kSameStep ? options.lanes : 0, options.semantic),
      step_rewards_(options.lanes),
      terminated_(new bool[options.lanes]()),
      truncated_(new bool[options.lanes]()),
      pool_owner_(getpid()) {}

Batch::~Batch() {
  if (pool_owner_ != getpid()) pool_.release();  // NOLINT(bugprone-unused-return-value): its threads are not here
}

absl::Status Batch::Reset(const std::vector<int>& lanes, const std::vector<bool>& seeded,
                          const std::vector<int64_t>& seeds) {
  CRAFTFLEET_ENTER_OR_RETURN();
  return ForEach(static_cast<int>(lanes.size()), [&](int i) {
    const int lane = lanes[i];
    if (seeded[lane]) lanes_[lane] = Lane(setup_, seeds[lane]);
    ResetLane(lane);
  });
}

absl::Status Batch::Step(absl::Span<const int64_t> actions) {
  CRAFTFLEET_ENTER_OR_RETURN();
  // Copied, because another thread may write the array meanwhile: what was checked is what is played.
  actions_.assign(actions.begin(), actions.end());
  CRAFTFLEET_RETURN_IF_ERROR(CheckStep());
  return ForEach(options_.lanes, [&](int lane) { StepLane(lane, static_cast<Action>(actions_[lane])); });
}

absl::StatusOr<std::string> Batch::Save(int lane) {
  CRAFTFLEET_ENTER_OR_RETURN();
  CRAFTFLEET_RETURN_IF_ERROR(CheckStarted(lane));
  return lanes_[lane].Save();
}

absl::Status Batch::Restore(int lane, absl::string_view snapshot) {
  CRAFTFLEET_ENTER_OR_RETURN();
  Lane& game = lanes_[lane];
  CRAFTFLEET_RETURN_IF_ERROR(game.Restore(snapshot));
  game.Redraw(setup_->renderer(), rows_.frame(lane));
  rows_.Fill(lane, game, 0);
  SetEnd(lane, game.world().end());
  return absl::OkStatus();
}

absl::Status Batch::Redraw(int lane, const Renderer& renderer, absl::Span<uint8_t> frame) {
  CRAFTFLEET_ENTER_OR_RETURN();
  CRAFTFLEET_RETURN_IF_ERROR(CheckStarted(lane));
  lanes_[lane].Redraw(renderer, frame);
  return absl::OkStatus();
}

absl::Status Batch::CheckStarted(int lane) const {
  if (started(lane)) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("lane ", lane, ": no game yet, want reset() first"));
}

absl::Status Batch::CheckStep() const {
  for (int lane = 0; lane < options_.lanes; ++lane) {
    const int64_t action = actions_[lane];
    if (action < 0 || action >= kNumActions) {
      return absl::InvalidArgumentError(absl::StrCat("actions[", lane, "] ", action, ", want 0..", kNumActions - 1));
    }
    CRAFTFLEET_RETURN_IF_ERROR(CheckStarted(lane));
    if (options_.autoreset == Autoreset::kDisabled && lanes_[lane].world().end() != StepEnd::kNone) {
      return absl::FailedPreconditionError(
          absl::StrCat("lane ", lane, ": its episode is over, want reset(options={\"reset_mask\": ...}) first"));
    }
  }
  return absl::OkStatus();
}

void Batch::ResetLane(int lane) {
  lanes_[lane].Reset(rows_.frame(lane));
  rows_.Fill(lane, lanes_[lane], 0);
  step_rewards_[lane] = 0;
  SetEnd(lane, StepEnd::kNone);
}

void Batch::StepLane(int lane, Action action) {
  Lane& game = lanes_[lane];
  // Not from terminated_ and truncated_: callers get these arrays, and may write to them.
  if (options_.autoreset == Autoreset::kNextStep && game.world().end() != StepEnd::kNone) return ResetLane(lane);
  const StepOutcome outcome = game.Step(action, rows_.frame(lane));
  rows_.Fill(lane, game, outcome.reward);
  step_rewards_[lane] = options_.reward ? outcome.reward : 0;
  SetEnd(lane, outcome.end);
  if (options_.autoreset == Autoreset::kSameStep && outcome.end != StepEnd::kNone) {
    final_rows_.Copy(lane, rows_);
    game.Reset(rows_.frame(lane));
    rows_.Fill(lane, game, 0);
  }
}

void Batch::SetEnd(int lane, StepEnd end) {
  terminated_[lane] = end == StepEnd::kTerminated;
  truncated_[lane] = end == StepEnd::kTruncated;
}

absl::Status Batch::ForEach(int count, const std::function<void(int)>& part) {
  const int parts = options_.threads == 1 ? 1 : std::min(count, options_.threads * kPartsPerThread);
  if (parts <= 1) {
    for (int i = 0; i < count; ++i) part(i);
    return absl::OkStatus();
  }
  CRAFTFLEET_RETURN_IF_ERROR(StartThreads());
  pool_->Run(parts, [&](int p) {
    const int end = static_cast<int>(int64_t{p + 1} * count / parts);
    for (int i = static_cast<int>(int64_t{p} * count / parts); i < end; ++i) part(i);
  });
  return absl::OkStatus();
}

absl::Status Batch::StartThreads() {
  if (pool_ != nullptr && pool_owner_ == getpid()) return absl::OkStatus();
  pool_.release();  // NOLINT(bugprone-unused-return-value): null, or its threads are not in this process
  pool_owner_ = getpid();
  try {
    pool_ = std::make_unique<WorkerPool>(options_.threads, UseAllOpenMpPlaces);
  } catch (const std::system_error& error) {
    return absl::FailedPreconditionError(
        absl::StrCat("threads ", options_.threads, ": the system starts no more (", error.what(),
                     "), want fewer, or a higher limit (ulimit -u, pids.max of the container)"));
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
