#include "actor/policy_source.h"

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/server.h"
#include "tests/fakes/fake_learner_service.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

std::vector<v1::WeightsChunk> Chunks(int64_t version, const std::string& bytes) {
  std::vector<v1::WeightsChunk> chunks(2);
  for (size_t i = 0; i < chunks.size(); ++i) {
    chunks[i].set_policy_version(version);
    chunks[i].set_total_bytes(static_cast<int64_t>(bytes.size()));
    chunks[i].set_data(i == 0 ? bytes.substr(0, 1000) : bytes.substr(1000));
  }
  return chunks;
}

class PolicySourceTest : public testing::Test {
 protected:
  FakeLearnerService service_;
  const std::unique_ptr<wire::Server> server_ = *wire::Server::Create({}, {&service_});
  const LearnerClient client_{server_->InProcess()};
  PolicySource source_{&client_, *FindAgent("ppo_cnn"), 8};
};

TEST_F(PolicySourceTest, FetchesAVersionOnce) {
  service_.SetWeights(Chunks(3, SampleWeights(1)));
  const auto first = source_.Get(1, 3);
  ASSERT_THAT(first, IsOk());
  service_.SetWeights({});
  EXPECT_EQ(source_.Get(1, 3).value(), *first);
}

TEST_F(PolicySourceTest, ConcurrentCallsFetchOnce) {
  service_.SetWeights(Chunks(3, SampleWeights(1)));
  std::vector<std::thread> threads;
  threads.reserve(4);
  for (int i = 0; i < 4; ++i) threads.emplace_back([this] { EXPECT_THAT(source_.Get(1, 3), IsOk()); });
  for (std::thread& thread : threads) thread.join();
}

TEST_F(PolicySourceTest, ALaterVersionIsAnErrorButIsKept) {
  service_.SetWeights(Chunks(4, SampleWeights(1)));
  EXPECT_TRUE(absl::IsAborted(source_.Get(1, 3).status()));
  service_.SetWeights({});
  EXPECT_THAT(source_.Get(1, 4), IsOk());
}

TEST_F(PolicySourceTest, ANewEpochFetchesAgain) {
  service_.SetWeights(Chunks(3, SampleWeights(1)));
  const auto before = source_.Get(1, 3);
  ASSERT_THAT(before, IsOk());
  const auto after = source_.Get(2, 3);
  ASSERT_THAT(after, IsOk());
  EXPECT_NE(*after, *before);
}

TEST_F(PolicySourceTest, TruncatedWeightsAreAnError) {
  std::vector<v1::WeightsChunk> chunks = Chunks(3, SampleWeights(1));
  chunks.pop_back();
  service_.SetWeights(chunks);
  EXPECT_TRUE(absl::IsDataLoss(source_.Get(1, 3).status()));
  service_.SetWeights(Chunks(3, SampleWeights(1)));
  EXPECT_THAT(source_.Get(1, 3), IsOk());
}

// A learner could make an actor receive 2 GiB.
TEST_F(PolicySourceTest, MoreBytesThanTheAgentNeedsAreRefusedAtTheFirstChunk) {
  v1::WeightsChunk chunk;
  chunk.set_policy_version(3);
  chunk.set_total_bytes(MaxWeightsBytes(*FindAgent("ppo_cnn")) + 1);
  chunk.set_data("the beginning");
  service_.SetWeights({chunk});
  EXPECT_THAT(source_.Get(1, 3),
              StatusIs(absl::StatusCode::kDataLoss, testing::HasSubstr("weights of the run's agent: total_bytes: 24")));
}

TEST_F(PolicySourceTest, TakesLocalWeightsInsteadOfCallingTheLearner) {
  VersionedWeights local = {-1, nullptr};
  int64_t asked = 0;
  const auto find = [&](int64_t version) {
    asked = version;
    return local;
  };
  PolicySource source(&client_, *FindAgent("ppo_cnn"), 8, "cpu", LocalWeights{find, nullptr});
  service_.SetWeights(Chunks(3, SampleWeights(1)));
  EXPECT_THAT(source.Get(1, 3), StatusIs(absl::StatusCode::kAborted, testing::HasSubstr("no weights yet")));
  EXPECT_EQ(asked, 3);
  local = {2, std::make_shared<const HostWeights>(SampleWeights(2))};
  EXPECT_THAT(source.Get(1, 3),
              StatusIs(absl::StatusCode::kAborted, testing::HasSubstr("version 2, the permit is for 3")));
  service_.SetWeights({});
  local.first = 3;
  EXPECT_THAT(source.Get(1, 3), IsOk());
}

TEST_F(PolicySourceTest, InvalidWeightsAreAnError) {
  service_.SetWeights(Chunks(3, std::string(5000, 'x')));
  EXPECT_THAT(source_.Get(1, 3), StatusIs(absl::StatusCode::kInvalidArgument, testing::Not(testing::IsEmpty())));
}

}  // namespace
}  // namespace craftfleet
