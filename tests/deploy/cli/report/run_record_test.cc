#include "deploy/cli/report/run_record.h"

#include <cmath>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "learner/run/checkpoint_store.h"
#include "tests/deploy/cli/report/sample_runs.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

TEST(ReadRun, HasConfigurationAndFiguresOfItsEpisodes) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 3, "agent: 'lstm_cnn'", 38, 11);
  const auto run = ReadRun(folder.path());
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->config.agent(), "lstm_cnn");
  EXPECT_EQ(run->config.seed(), 3U);
  EXPECT_EQ(run->training.episodes, 38);
  EXPECT_NEAR(run->training.score, std::sqrt(101) - 1, 1e-12);
  EXPECT_EQ(run->training.reward, 11);
  EXPECT_EQ(run->training.unlocked, 11);
  EXPECT_EQ(run->training.success[10], 100);
  EXPECT_EQ(run->training.success[11], 0);
  EXPECT_EQ(run->curve.size(), 38U);
  EXPECT_EQ(run->eval_sampled.episodes, 0);
}

TEST(ReadRun, TexturesBelongToItsIdentity) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "", 38, 11);
  const std::string plain = ReadRun(folder.path())->identity;
  WriteTextFile(folder / "run.json", R"({"run_id": "r", "texture_digest": "3024e54bf17f9958"})");
  EXPECT_EQ(ReadRun(folder.path())->identity, plain) << "the built-in textures";
  WriteTextFile(folder / "run.json", R"({"run_id": "r", "texture_digest": "8140aa54698876d7"})");
  EXPECT_NE(ReadRun(folder.path())->identity, plain);
  EXPECT_EQ(ReadRun(folder.path())->texture_digest, "8140aa54698876d7");
  WriteTextFile(folder / "run.json", "{}");
  EXPECT_THAT(ReadRun(folder.path()), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("texture_digest")));
}

TEST(ReadRun, ReadsEvaluationEpisodesOfEachKind) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "", 38, 11);
  WriteTextFile(folder / "eval_argmax.jsonl", SameEpisodes(5, 1));
  WriteTextFile(folder / "eval_sampled.jsonl", SameEpisodes(6, 2));
  WriteTextFile(folder / "final_argmax.jsonl", SameEpisodes(7, 3));
  WriteTextFile(folder / "final_sampled.jsonl", SameEpisodes(8, 4));
  const auto run = ReadRun(folder.path());
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->eval_argmax.episodes, 5);
  EXPECT_EQ(run->eval_argmax.unlocked, 1);
  EXPECT_EQ(run->eval_sampled.unlocked, 2);
  EXPECT_EQ(run->final_argmax.unlocked, 3);
  EXPECT_EQ(run->final_sampled.unlocked, 4);
}

// 30 episodes of 100 steps end within the third iteration of 1,000 steps, 31 within the fourth.
TEST(ReadRun, WithoutCheckpointsItsEpisodesShowItsProgress) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "", 30, 1);
  EXPECT_EQ(ReadRun(folder.path())->steps, 3000);
  EXPECT_FALSE(ReadRun(folder.path())->complete);
  WriteSampleRun(folder.path(), 1, "", 31, 1);
  EXPECT_EQ(ReadRun(folder.path())->steps, 4000);
  EXPECT_TRUE(ReadRun(folder.path())->complete);
  WriteSampleRun(folder.path(), 1, "", 0, 1);
  EXPECT_EQ(ReadRun(folder.path())->steps, 0);
  EXPECT_FALSE(ReadRun(folder.path())->complete);
}

TEST(ReadRun, FinalEpisodesShowThatItIsComplete) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "eval { final_episodes: 4 }", 20, 1);
  WriteTextFile(folder / "final_argmax.jsonl", SameEpisodes(4, 3));
  WriteTextFile(folder / "final_sampled.jsonl", SameEpisodes(3, 4));
  EXPECT_FALSE(ReadRun(folder.path())->complete);
  WriteTextFile(folder / "final_sampled.jsonl", SameEpisodes(4, 4));
  EXPECT_TRUE(ReadRun(folder.path())->complete);
  EXPECT_EQ(ReadRun(folder.path())->steps, 4000);
}

TEST(ReadRun, TheNewestCheckpointDecidesWhereThereIsOne) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "", 39, 1);
  Checkpoint checkpoint = SampleCheckpoint(3);
  checkpoint.state.set_env_steps(3000);
  ASSERT_THAT(CheckpointStore::Open(folder / "checkpoints")->Write(checkpoint), IsOk());
  EXPECT_EQ(ReadRun(folder.path())->steps, 3000);
  EXPECT_FALSE(ReadRun(folder.path())->complete);
}

// The checkpoint at the end of training, of a learner that was stopped before it had all evaluations.
TEST(ReadRun, IsNotCompleteWhileAnEvaluationIsPending) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "eval { final_episodes: 4 }", 39, 1);
  auto store = CheckpointStore::Open(folder / "checkpoints");
  ASSERT_THAT(store, IsOk());
  Checkpoint checkpoint = SampleCheckpoint(4);
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(4);
  const auto is_complete = [&] {
    EXPECT_THAT(store->Write(checkpoint), IsOk());
    checkpoint.state.set_iteration(checkpoint.state.iteration() + 1);
    const auto run = ReadRun(folder.path());
    EXPECT_THAT(run, IsOk());
    EXPECT_EQ(run->steps, 4000);
    return run->complete;
  };
  checkpoint.state.set_env_steps(4000);
  EXPECT_FALSE(is_complete()) << "the final evaluation has not begun";

  checkpoint.state.set_final_evaluation_steps(4000);
  v1::PendingEvaluation* pending = checkpoint.state.add_pending();
  pending->set_number(1);
  pending->set_env_steps(4000);
  pending->set_first_episode(1);
  pending->set_episodes(4);
  pending->set_final(true);
  checkpoint.evaluation_weights = {std::make_shared<const std::string>("weights")};
  EXPECT_FALSE(is_complete()) << "the final evaluation is pending";

  pending->set_final(false);
  EXPECT_FALSE(is_complete()) << "an evaluation of training is pending";

  checkpoint.state.clear_pending();
  checkpoint.evaluation_weights.clear();
  EXPECT_TRUE(is_complete());
}

TEST(ReadRun, IsCompleteWithoutAFinalEvaluationIfNoneIsWanted) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "eval { final_episodes: 0 }", 39, 1);
  Checkpoint checkpoint = SampleCheckpoint(4);
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(0);
  checkpoint.state.set_env_steps(4000);
  ASSERT_THAT(CheckpointStore::Open(folder / "checkpoints")->Write(checkpoint), IsOk());
  EXPECT_TRUE(ReadRun(folder.path())->complete);
}

TEST(ReadRun, NamesTheInvalidFileAndLine) {
  const TempFolder folder;
  WriteSampleRun(folder.path(), 1, "", 3, 1);
  WriteTextFile(folder / "stats.jsonl", SameEpisodes(2, 1) + "{\"length\": 3}\n");
  EXPECT_THAT(ReadRun(folder.path()), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("/stats.jsonl:3: ")));
  WriteSampleRun(folder.path(), 1, "", 3, 1);
  WriteTextFile(folder / "eval_argmax.jsonl", "nonsense\n");
  EXPECT_THAT(ReadRun(folder.path()), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("/eval_argmax.jsonl:1: ")));
  WriteSampleRun(folder.path(), 1, "", 3, 1);
  WriteTextFile(folder / "config.txt", "seed: 1\nagnet: 'x'\n");
  EXPECT_THAT(ReadRun(folder.path()), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("/config.txt:2:")));
  WriteTextFile(folder / "config.txt", "ppo { gamma: 2 }");
  EXPECT_THAT(ReadRun(folder.path()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("/config.txt: ppo.gamma")));
}

TEST(FindRuns, FindsEachRunInOrBelowTheFoldersOnceInOrder) {
  const TempFolder folder;
  WriteSampleRun(folder / "b/c/seed2", 2, "", 3, 1);
  WriteSampleRun(folder / "b/c/seed1", 1, "", 3, 1);
  WriteSampleRun(folder / "a", 1, "", 3, 1);
  WriteTextFile(folder / "b/config.txt", "no run, it has no stats.jsonl");
  const auto found = FindRuns({folder.path(), folder / "a", folder / "b"});
  ASSERT_THAT(found, IsOk());
  ASSERT_EQ(found->runs.size(), 3U);
  EXPECT_EQ(found->runs[0].folder, folder / "a");
  EXPECT_EQ(found->runs[2].folder, folder / "b/c/seed2");
  EXPECT_TRUE(found->unreadable.empty());
}

TEST(FindRuns, ARunThatCannotBeReadIsNamedBesideTheOthers) {
  const TempFolder folder;
  WriteSampleRun(folder / "a", 1, "", 3, 1);
  WriteSampleRun(folder / "b", 2, "", 3, 1);
  WriteSampleRun(folder / "c", 3, "", 3, 1);
  ASSERT_THAT(CheckpointStore::Open(folder / "b/checkpoints")->Write(SampleCheckpoint(3)), IsOk());
  WriteTextFile(folder / "b/checkpoints/iter-00000003/state.pb", "garbage");
  const auto found = FindRuns({folder.path()});
  ASSERT_THAT(found, IsOk());
  ASSERT_EQ(found->runs.size(), 2U);
  EXPECT_EQ(found->runs[1].folder, folder / "c");
  ASSERT_EQ(found->unreadable.size(), 1U);
  EXPECT_THAT(std::string(found->unreadable[0].message()), HasSubstr(folder / "b/checkpoints/iter-00000003"));
}

TEST(FindRuns, AMissingFolderIsAnError) {
  EXPECT_THAT(FindRuns({"/nowhere/runs"}), StatusIs(absl::StatusCode::kNotFound, "/nowhere/runs: no such folder"));
}

}  // namespace
}  // namespace craftfleet
