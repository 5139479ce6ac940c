#include "learner/run/score_curve.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

TEST(ThinnedSeries, KeepsShortSeriesWhole) {
  ThinnedSeries<int> series;
  EXPECT_THAT(series.Points(), IsEmpty());
  for (int i = 1; i <= 3; ++i) series.Add(i);
  EXPECT_THAT(series.Points(), ElementsAre(1, 2, 3));
}

TEST(ThinnedSeries, LongSeriesStayBoundedEvenAndCurrent) {
  ThinnedSeries<int> series;
  for (int i = 1; i <= 100'000; ++i) {
    series.Add(i);
    ASSERT_LE(series.Points().size(), ThinnedSeries<int>::kMaxPoints) << i;
    ASSERT_EQ(series.Points().back(), i);
  }
  const std::vector<int> points = series.Points();
  EXPECT_GE(points.size(), ThinnedSeries<int>::kMaxPoints / 4);
  const int stride = points[0];
  for (size_t i = 0; i + 1 < points.size(); ++i) EXPECT_EQ(points[i], stride * static_cast<int>(i + 1));
}

TEST(ScoreCurve, HasThePointOfEachEpisode) {
  ScoreCurve curve;
  ScoreBoard board;
  for (int i = 1; i <= 2; ++i) {
    Episode episode;
    episode.length = 10 * i;
    episode.reward = i;
    episode.achievements[0] = 1;
    board.Add(episode);
    curve.Add(episode.length, board);
  }
  const std::vector<CurvePoint> points = curve.Points();
  ASSERT_EQ(points.size(), 2U);
  EXPECT_EQ(points[1].episodes, 2);
  EXPECT_EQ(points[1].steps, 30);
  EXPECT_EQ(points[1].reward, 1.5);
  EXPECT_EQ(points[1].score, board.Score());
}

}  // namespace
}  // namespace craftfleet
