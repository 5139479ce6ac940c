// The learner's streams: weights, and limits on time and number.

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/threads.h"
#include "tests/learner/learner_service_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

TEST_F(LearnerServiceTest, WeightsAreSentInChunks) {
  std::string bytes((256 << 10) + 5, '\0');
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * 31 + (i >> 16));
  weights_.Publish(kVersion, std::make_shared<std::string>(bytes));
  grpc::ClientContext context;
  v1::WeightsRequest request;
  request.set_at_least(kVersion - 1);
  const auto stream = stub_->GetWeights(&context, request);
  v1::WeightsChunk chunk;
  std::string received;
  std::vector<size_t> sizes;
  while (stream->Read(&chunk)) {
    EXPECT_EQ(chunk.policy_version(), kVersion);
    EXPECT_EQ(chunk.total_bytes(), static_cast<int64_t>(bytes.size()));
    sizes.push_back(chunk.data().size());
    received += chunk.data();
  }
  EXPECT_TRUE(stream->Finish().ok());
  EXPECT_EQ(received, bytes);
  EXPECT_THAT(sizes, testing::ElementsAre(128 << 10, 128 << 10, 5));
}

TEST_F(LearnerServiceTest, AMissingVersionOfTheWeightsIsAnError) {
  weights_.Publish(kVersion, std::make_shared<std::string>("w"));
  grpc::ClientContext context;
  v1::WeightsRequest request;
  request.set_at_least(kVersion + 1);
  request.set_wait_ms(10);
  v1::WeightsChunk chunk;
  const auto stream = stub_->GetWeights(&context, request);
  EXPECT_FALSE(stream->Read(&chunk));
  EXPECT_THAT(wire::FromGrpc(stream->Finish(), "learner"),
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       AllOf(HasSubstr("policy version 12 is not available yet"), HasSubstr("the latest is 11"))));
}

// Actors always have a stream and nearly always a request that waits. Thousands of them must not need as many threads.
TEST_F(LearnerServiceTest, WaitingActorsHaveNoThreads) {
  constexpr int kActors = 200;
  struct Actor {
    grpc::ClientContext poll, push;
    v1::PermitRequest request;
    v1::PermitReply reply;
    std::unique_ptr<grpc::ClientReaderWriter<v1::FragmentMessage, v1::FragmentVerdict>> stream;
  };
  ASSERT_THAT(Join("plays"), IsOk());
  ASSERT_THAT(GetPermits("plays"), IsOk());
  std::vector<Actor> actors(kActors);
  const int before = CountThreads();
  std::atomic<int> answered = 0;
  for (int i = 0; i < kActors; ++i) {
    Actor& actor = actors[i];
    ASSERT_THAT(Join(absl::StrCat("actor", i)), IsOk());
    actor.stream = stub_->PushFragments(&actor.push);
    actor.request.set_actor(absl::StrCat("actor", i));
    actor.request.set_epoch(kEpoch);
    actor.request.set_capacity(1);
    actor.request.set_wait_ms(2000);
    stub_->async()->GetPermits(&actor.poll, &actor.request, &actor.reply, [&](const grpc::Status& status) {
      EXPECT_TRUE(status.ok()) << status.error_message();
      ++answered;
    });
  }
  int most = before;
  while (answered < kActors) {
    most = std::max(most, CountThreads());
    absl::SleepFor(absl::Milliseconds(1));
  }
  EXPECT_LT(most, before + 40) << before << " threads before";
  for (Actor& actor : actors) {
    actor.stream->WritesDone();
    EXPECT_TRUE(actor.stream->Finish().ok());
  }
}

// The same service with short limits for its streams.
class LearnerStreamsTest : public LearnerServiceTest {
 protected:
  static constexpr absl::Duration kLimit = absl::Seconds(1);

  LearnerStreamsTest() {
    server_ = *wire::Server::Create({}, {&impatient_});
    stub_ = v1::LearnerService::NewStub(server_->InProcess().channel);
    wire::SetDeadline(&context_, absl::Seconds(60));
  }
  // The server's threads use `impatient_`, which is destroyed before the base class.
  ~LearnerStreamsTest() override { server_.reset(); }

  static LearnerServiceImpl::Options ShortLimits() {
    LearnerServiceImpl::Options options = ServiceOptions();
    options.fragment_timeout = kLimit;
    options.reply_timeout = kLimit;
    options.max_polls_per_client = 0;
    return options;
  }

  LearnerServiceImpl impatient_{ShortLimits(), &registry_, &weights_, &fragments_};
  grpc::ClientContext context_;
};

TEST_F(LearnerStreamsTest, AStreamWithoutFragmentsEnds) {
  const absl::Time start = absl::Now();
  const auto stream = stub_->PushFragments(&context_);
  v1::FragmentVerdict verdict;
  EXPECT_FALSE(stream->Read(&verdict));
  EXPECT_FALSE(stream->Finish().ok());
  EXPECT_LT(absl::Now() - start, absl::Seconds(30)) << "well before the client's own deadline";
}

TEST_F(LearnerStreamsTest, ASlowStreamOfFragmentsDoesNotEnd) {
  const auto stream = stub_->PushFragments(&context_);
  v1::FragmentMessage message = wire::ToProto(SampleFragment(0, 0, kVersion, kEpoch));
  message.set_actor("a");
  v1::FragmentVerdict verdict;
  for (int i = 0; i < 6; ++i) {
    absl::SleepFor(kLimit / 3);
    ASSERT_TRUE(stream->Write(message) && stream->Read(&verdict)) << i;
  }
  stream->WritesDone();
  EXPECT_TRUE(stream->Finish().ok());
}

TEST_F(LearnerStreamsTest, RequestsThatWaitAreLimited) {
  ASSERT_THAT(Join("a"), IsOk());
  EXPECT_EQ(GetPermits("a").status().code(), absl::StatusCode::kResourceExhausted);
}

TEST_F(LearnerStreamsTest, WeightsThatNobodyReadsAreDropped) {
  weights_.Publish(kVersion, std::make_shared<std::string>(64 << 20, 'w'));
  const auto stream = stub_->GetWeights(&context_, v1::WeightsRequest());
  absl::SleepFor(3 * kLimit);
  v1::WeightsChunk chunk;
  size_t received = 0;
  while (stream->Read(&chunk)) received += chunk.data().size();
  EXPECT_FALSE(stream->Finish().ok());
  EXPECT_LT(received, size_t{64} << 20);
}

}  // namespace
}  // namespace craftfleet
