#include "learner/evaluation_book.h"

#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLease = absl::Seconds(5);

Evaluation SampleEvaluation(int64_t number, int64_t first_episode, int episodes) {
  return {number, number * 1000, first_episode, episodes, false, std::make_shared<std::string>("weights")};
}

std::vector<Episode> Episodes(int count, int64_t length) {
  std::vector<Episode> episodes(count);
  for (Episode& episode : episodes) episode.length = length;
  return episodes;
}

class EvaluationBookTest : public testing::Test {
 protected:
  FakeClock clock_;
  EvaluationBook book_{kLease, &clock_};
};

TEST_F(EvaluationBookTest, AnEvaluationIsAnArgmaxTaskAndASampledOneOfTheNextEpisodes) {
  EXPECT_FALSE(book_.Take("a").has_value());
  book_.Add(SampleEvaluation(3, 21, 5));
  const auto argmax = book_.Take("a");
  const auto sampled = book_.Take("b");
  ASSERT_TRUE(argmax.has_value() && sampled.has_value());
  EXPECT_TRUE(argmax->greedy);
  EXPECT_EQ(argmax->first_episode, 21);
  EXPECT_EQ(argmax->episodes, 5);
  EXPECT_FALSE(sampled->greedy);
  EXPECT_EQ(sampled->first_episode, 26);
  EXPECT_EQ(sampled->episodes, 5);
  EXPECT_NE(argmax->id, sampled->id);
  EXPECT_FALSE(book_.Take("c").has_value());
  EXPECT_EQ(*book_.Weights(argmax->id), "weights");
}

TEST_F(EvaluationBookTest, ResultsComeBackInOrderAndStayUntilTheyAreTakenOut) {
  book_.Add(SampleEvaluation(1, 1, 2));
  book_.Add(SampleEvaluation(2, 5, 2));
  std::vector<EvaluationBook::Task> tasks;
  while (const auto task = book_.Take("a")) tasks.push_back(*task);
  ASSERT_EQ(tasks.size(), 4u);
  EXPECT_THAT(book_.Finish(tasks[2].id, Episodes(2, 30)), IsOk());
  EXPECT_THAT(book_.Finish(tasks[3].id, Episodes(2, 40)), IsOk());
  EXPECT_THAT(book_.Finish(tasks[1].id, Episodes(2, 20)), IsOk());
  EXPECT_FALSE(book_.Front(absl::ZeroDuration()).has_value()) << "the first is not over";
  EXPECT_THAT(book_.Finish(tasks[0].id, Episodes(2, 10)), IsOk());

  for (int look = 0; look < 2; ++look) {
    const auto first = book_.Front(absl::ZeroDuration());
    ASSERT_TRUE(first.has_value());
    EXPECT_EQ(first->evaluation.number, 1);
    EXPECT_EQ(first->argmax[0].length, 10);
    EXPECT_EQ(first->sampled[1].length, 20);
    EXPECT_EQ(book_.Pending().size(), 2u);
  }
  book_.Pop();
  EXPECT_EQ(book_.Front(absl::ZeroDuration())->evaluation.number, 2);
  EXPECT_EQ(book_.Pending().size(), 1u);
}

// An actor that speaks and never answers must not hold up the end of a run.
TEST_F(EvaluationBookTest, ATaskThatTakesTooLongGoesToAnotherToo) {
  book_.Add(SampleEvaluation(1, 1, 2));
  const auto stuck = book_.Take("stuck");
  const auto other = book_.Take("good");
  clock_.Advance(absl::Seconds(20));
  EXPECT_THAT(book_.Finish(other->id, Episodes(2, 30)), IsOk());
  const auto wait = [&](int seconds) {
    for (int i = 0; i < seconds; ++i) {
      clock_.Advance(absl::Seconds(1));
      book_.Renew("stuck", stuck->id);
    }
  };
  wait(100);
  EXPECT_FALSE(book_.Take("good").has_value()) << "two minutes";
  wait(1);
  EXPECT_FALSE(book_.Take("stuck").has_value()) << "it has it";
  const auto again = book_.Take("good");
  ASSERT_TRUE(again.has_value());
  EXPECT_EQ(again->id, stuck->id);
  EXPECT_FALSE(book_.Take("third").has_value());
  EXPECT_THAT(book_.Finish(stuck->id, Episodes(2, 40)), IsOk()) << "whoever answers first";
  EXPECT_TRUE(book_.Front(absl::ZeroDuration()).has_value());
}

TEST_F(EvaluationBookTest, ATaskLapsesUnlessItsActorSpeaksOfIt) {
  book_.Add(SampleEvaluation(1, 1, 1));
  const auto task = book_.Take("a");
  ASSERT_TRUE(book_.Take("b").has_value());
  clock_.Advance(kLease - absl::Seconds(1));
  book_.Renew("a", task->id);
  clock_.Advance(absl::Seconds(2));
  EXPECT_FALSE(book_.Take("c")->greedy) << "b's, which said nothing";
  EXPECT_FALSE(book_.Take("c").has_value()) << "a's was renewed";
  clock_.Advance(kLease);
  EXPECT_EQ(book_.Take("c")->id, task->id);
}

TEST_F(EvaluationBookTest, ATaskThatItsActorNoLongerNamesIsFreeAtOnce) {
  book_.Add(SampleEvaluation(1, 1, 1));
  const auto task = book_.Take("a");
  ASSERT_TRUE(book_.Take("b").has_value());
  book_.Renew("a", 0);
  EXPECT_EQ(book_.Take("c")->id, task->id);
}

TEST_F(EvaluationBookTest, TheFirstResultCountsAndLaterOnesAreLeftAlone) {
  book_.Add(SampleEvaluation(1, 1, 1));
  const int64_t argmax = book_.Take("a")->id;
  const int64_t sampled = book_.Take("a")->id;
  EXPECT_THAT(book_.Finish(argmax, Episodes(1, 10)), IsOk());
  EXPECT_THAT(book_.Finish(argmax, Episodes(1, 99)), IsOk());
  EXPECT_EQ(book_.Weights(argmax), nullptr);
  EXPECT_THAT(book_.Finish(sampled, Episodes(1, 20)), IsOk());
  EXPECT_EQ(book_.Front(absl::ZeroDuration())->argmax[0].length, 10);
  book_.Pop();
  EXPECT_THAT(book_.Finish(argmax, Episodes(1, 10)), IsOk()) << "it came too late, which harms nobody";
}

TEST_F(EvaluationBookTest, AWrongNumberOfEpisodesIsRefused) {
  book_.Add(SampleEvaluation(1, 1, 5));
  const int64_t id = book_.Take("a")->id;
  EXPECT_THAT(book_.Finish(id, Episodes(4, 10)),
              StatusIs(absl::StatusCode::kInvalidArgument, testing::HasSubstr("4 episodes, want 5")));
  EXPECT_NE(book_.Weights(id), nullptr);
}

TEST_F(EvaluationBookTest, FrontWaitsForTheResult) {
  book_.Add(SampleEvaluation(1, 1, 1));
  const int64_t argmax = book_.Take("a")->id;
  const int64_t sampled = book_.Take("a")->id;
  std::thread actor([&] {
    EXPECT_TRUE(book_.Finish(argmax, Episodes(1, 10)).ok());
    EXPECT_TRUE(book_.Finish(sampled, Episodes(1, 20)).ok());
  });
  EXPECT_TRUE(book_.Front(absl::Seconds(60)).has_value());
  actor.join();
}

}  // namespace
}  // namespace craftfleet
