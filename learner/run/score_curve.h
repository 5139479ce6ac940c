// The learning curve of a run, in bounded memory.

#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "learner/run/score.h"

namespace craftfleet {

// Keeps points of a series of any length: every n-th, where n doubles whenever there are too many, and the last one.
// Thread-compatible.
template <typename Point>
class ThinnedSeries {
 public:
  static constexpr size_t kMaxPoints = 512;  // that Points returns

  void Add(const Point& point) {
    last_ = point;
    last_is_kept_ = ++added_ % stride_ == 0;
    if (!last_is_kept_) return;
    kept_.push_back(point);
    if (kept_.size() < kMaxPoints) return;
    stride_ *= 2;
    for (size_t i = 0; i < kept_.size() / 2; ++i) kept_[i] = kept_[2 * i + 1];
    kept_.resize(kept_.size() / 2);
    last_is_kept_ = added_ % stride_ == 0;
  }

  // In the order of Add.
  std::vector<Point> Points() const {
    std::vector<Point> points = kept_;
    if (added_ > 0 && !last_is_kept_) points.push_back(last_);
    return points;
  }

 private:
  int64_t added_ = 0;
  int64_t stride_ = 1;
  std::vector<Point> kept_;
  Point last_ = {};
  bool last_is_kept_ = false;
};

struct CurvePoint {
  int64_t episodes = 0;  // finished so far
  int64_t steps = 0;     // environment steps so far
  double reward = 0;     // mean of the last 100 episodes
  double score = 0;      // Crafter's score over all episodes so far, 0..100
};

// A point after each episode. It counts the steps of finished episodes in the order of stats.jsonl (iteration, lane,
// step). The run's own count is higher, because it includes unfinished episodes. Thread-compatible.
class ScoreCurve {
 public:
  // `board` includes the episode, of `length` steps.
  void Add(int64_t length, const ScoreBoard& board) {
    steps_ += length;
    series_.Add({board.episodes(), steps_, board.RecentReward(), board.Score()});
  }
  std::vector<CurvePoint> Points() const { return series_.Points(); }

 private:
  int64_t steps_ = 0;
  ThinnedSeries<CurvePoint> series_;
};

}  // namespace craftfleet
