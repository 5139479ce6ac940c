// The learner's streams: those of actors, weights, and limits on time and number.

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
#include "tests/fakes/wait_until.h"
#include "tests/learner/service/learner_service_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

TEST_F(LearnerServiceTest, WeightsAreSentInChunks) {
  std::string bytes((256 << 10) + 5, '\0');
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * 31 + (i >> 16));
  weights_.Publish(kPublishedVersion, std::make_shared<HostWeights>(bytes));
  grpc::ClientContext context;
  v1::WeightsRequest request;
  request.set_at_least(kPublishedVersion - 1);
  const auto stream = stub_->GetWeights(&context, request);
  v1::WeightsChunk chunk;
  std::string received;
  std::vector<size_t> sizes;
  while (stream->Read(&chunk)) {
    EXPECT_EQ(chunk.policy_version(), kPublishedVersion);
    EXPECT_EQ(chunk.total_bytes(), static_cast<int64_t>(bytes.size()));
    sizes.push_back(chunk.data().size());
    received += chunk.data();
  }
  EXPECT_TRUE(stream->Finish().ok());
  EXPECT_EQ(received, bytes);
  EXPECT_THAT(sizes, testing::ElementsAre(128 << 10, 128 << 10, 5));
}

TEST_F(LearnerServiceTest, AMissingVersionOfTheWeightsIsAnError) {
  weights_.Publish(kPublishedVersion, std::make_shared<HostWeights>("w"));
  grpc::ClientContext context;
  v1::WeightsRequest request;
  request.set_at_least(kPublishedVersion + 1);
  v1::WeightsChunk chunk;
  const auto stream = stub_->GetWeights(&context, request);
  EXPECT_FALSE(stream->Read(&chunk));
  EXPECT_THAT(wire::FromGrpc(stream->Finish(), "learner"),
              StatusIs(absl::StatusCode::kDeadlineExceeded,
                       AllOf(HasSubstr("policy version 12 is not available yet"), HasSubstr("the latest is 11"))));
}

v1::ActorMessage RequestOf(const std::string& actor, int wait_ms = 0) {
  v1::ActorMessage message;
  message.mutable_permits()->set_actor(actor);
  message.mutable_permits()->set_epoch(kEpoch);
  message.mutable_permits()->set_capacity(100);
  message.mutable_permits()->set_wait_ms(wait_ms);
  return message;
}

// A valid fragment of an earlier epoch, which changes nothing.
v1::ActorMessage OldFragment(const std::string& actor) {
  v1::ActorMessage message;
  *message.mutable_fragment() = Message(actor, 0, 0, kPublishedVersion, kEpoch - 1);
  return message;
}

// An actor's stream.
class ActorsStream {
 public:
  explicit ActorsStream(v1::LearnerService::Stub* stub) {
    wire::SetDeadline(&context_, absl::Seconds(60));
    stream_ = stub->Play(&context_);
  }
  ~ActorsStream() {
    if (!ended_) End(/*cancel=*/true).IgnoreError();
  }
  bool Write(const v1::ActorMessage& message) { return stream_->Write(message); }
  // The next answer; none: the stream has ended.
  v1::LearnerMessage Read() {
    v1::LearnerMessage answer;
    stream_->Read(&answer);
    return answer;
  }
  absl::Status End(bool cancel = false) {
    ended_ = true;
    if (cancel) context_.TryCancel();
    if (!cancel) stream_->WritesDone();
    return wire::FromGrpc(stream_->Finish(), "learner");
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::ActorMessage, v1::LearnerMessage>> stream_;
  bool ended_ = false;
};

// An actor without a thread that asks once and waits for the reply.
class IdleActor final : public grpc::ClientBidiReactor<v1::ActorMessage, v1::LearnerMessage> {
 public:
  IdleActor(v1::LearnerService::Stub* stub, const std::string& name, std::atomic<int>* ended)
      : request_(RequestOf(name, 2000)), ended_(ended) {
    stub->async()->Play(&context_, this);
    StartWrite(&request_);
    StartRead(&reply_);
    StartCall();
  }
  void OnReadDone(bool ok) override {
    EXPECT_TRUE(ok && reply_.has_permits());
    StartWritesDone();
  }
  void OnDone(const grpc::Status& status) override {
    EXPECT_TRUE(status.ok()) << status.error_message();
    ++*ended_;
  }

 private:
  grpc::ClientContext context_;
  const v1::ActorMessage request_;
  v1::LearnerMessage reply_;
  std::atomic<int>* const ended_;
};

// Actors nearly always have a request that waits. Thousands of them must not need as many threads.
TEST_F(LearnerServiceTest, WaitingActorsHaveNoThreads) {
  constexpr int kActors = 200;
  Enter("plays");
  const int before = CountThreads();
  std::atomic<int> ended = 0;
  std::vector<std::unique_ptr<IdleActor>> actors;
  for (int i = 0; i < kActors; ++i) {
    const std::string name = absl::StrCat("actor", i);
    ASSERT_THAT(Join(name), IsOk());
    actors.push_back(std::make_unique<IdleActor>(stub_.get(), name, &ended));
  }
  int most = before;
  ASSERT_TRUE(WaitUntil([&] {
    most = std::max(most, CountThreads());
    return ended == kActors;
  }));
  EXPECT_LT(most, before + 40) << before << " threads before";
}

TEST_F(LearnerServiceTest, AVerdictDoesNotWaitForPermits) {
  Enter("plays");
  ASSERT_THAT(Join("a"), IsOk());
  ActorsStream stream(stub_.get());
  ASSERT_TRUE(stream.Write(RequestOf("a", 2000)));
  ASSERT_TRUE(stream.Write(OldFragment("a")));
  const absl::Time start = absl::Now();
  EXPECT_EQ(stream.Read().verdict().verdict(), v1::FragmentVerdict::EXPIRED);
  EXPECT_LT(absl::Now() - start, absl::Seconds(1));
  EXPECT_TRUE(stream.Read().has_permits());
  EXPECT_THAT(stream.End(), IsOk());
}

TEST_F(LearnerServiceTest, ASecondRequestBeforeTheReplyEndsTheStream) {
  Enter("plays");
  ASSERT_THAT(Join("a"), IsOk());
  ActorsStream stream(stub_.get());
  ASSERT_TRUE(stream.Write(RequestOf("a", 2000)));
  ASSERT_TRUE(stream.Write(RequestOf("a", 2000)));
  EXPECT_EQ(stream.Read().message_case(), v1::LearnerMessage::MESSAGE_NOT_SET);
  EXPECT_THAT(stream.End(), StatusIs(absl::StatusCode::kInvalidArgument,
                                     HasSubstr("a request for permits before the reply to the last one")));
}

TEST_F(LearnerServiceTest, EachReplyAllowsTheNextRequest) {
  ASSERT_THAT(Join("a"), IsOk());
  ActorsStream stream(stub_.get());
  for (int i = 0; i < 100; ++i) {
    ASSERT_TRUE(stream.Write(RequestOf("a"))) << i;
    ASSERT_TRUE(stream.Read().has_permits()) << i;
  }
  EXPECT_THAT(stream.End(), IsOk());
}

TEST_F(LearnerServiceTest, AWaitingRequestIsAnsweredAlthoughTheClientSendsNoMore) {
  Enter("plays");
  ASSERT_THAT(Join("a"), IsOk());
  EXPECT_THAT(AskOnce(stub_.get(), RequestOf("a", 100).permits()), IsOk());
}

TEST_F(LearnerServiceTest, AnActorThatLeavesEndsItsWaitingRequest) {
  Enter("plays");
  ASSERT_THAT(Join("a"), IsOk());
  ActorsStream stream(stub_.get());
  ASSERT_TRUE(stream.Write(RequestOf("a", 2000)));
  absl::SleepFor(absl::Milliseconds(100));
  registry_.Leave("a");
  EXPECT_EQ(stream.Read().message_case(), v1::LearnerMessage::MESSAGE_NOT_SET);
  EXPECT_THAT(stream.End(), StatusIs(absl::StatusCode::kAborted, HasSubstr("actor a is unknown: join again")));
}

TEST_F(LearnerServiceTest, AMessageWithoutContentIsRefused) {
  EXPECT_THAT(PlayOnce(stub_.get(), {}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a message without permits or fragment")));
}

// The learner may notice late that a connection has broken, when its actor is back already.
TEST_F(LearnerServiceTest, TheEndOfAnEarlierStreamDoesNotShortenTheLease) {
  ASSERT_THAT(Join("b"), IsOk());
  ASSERT_THAT(Join("a"), IsOk());
  auto earlier = std::make_unique<ActorsStream>(stub_.get());
  ASSERT_TRUE(earlier->Write(RequestOf("a")));
  ASSERT_GT(earlier->Read().permits().granted_size(), 0);
  ActorsStream later(stub_.get());
  v1::ActorMessage request = RequestOf("a");
  const auto granted = registry_.GetPermits("a", {}, 100, absl::ZeroDuration());
  ASSERT_THAT(granted, IsOk());
  for (const Permit& permit : granted->granted) {
    v1::Permit* const held = request.mutable_permits()->add_active();
    held->set_lane(permit.lane);
    held->set_policy_version(permit.policy_version);
  }
  ASSERT_TRUE(later.Write(request));
  ASSERT_TRUE(later.Read().has_permits());
  earlier.reset();  // cancels it
  absl::SleepFor(absl::Milliseconds(200));
  clock_.Advance(absl::Milliseconds(4900));  // less than the lease, more than `comeback`
  ASSERT_THAT(GetPermits("b"), IsOk());
  EXPECT_EQ(registry_.counters().lapsed, 0);
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
    options.message_timeout = kLimit;
    options.reply_timeout = kLimit;
    options.max_streams_per_client = 2;
    return options;
  }

  LearnerServiceImpl impatient_{ShortLimits(), &registry_, &weights_, &fragments_};
  grpc::ClientContext context_;
};

TEST_F(LearnerStreamsTest, AStreamWithoutMessagesEnds) {
  const absl::Time start = absl::Now();
  ActorsStream stream(stub_.get());
  EXPECT_EQ(stream.Read().message_case(), v1::LearnerMessage::MESSAGE_NOT_SET);
  EXPECT_FALSE(stream.End().ok());
  EXPECT_LT(absl::Now() - start, absl::Seconds(30)) << "well before the client's own deadline";
}

TEST_F(LearnerStreamsTest, ASlowStreamOfFragmentsDoesNotEnd) {
  ActorsStream stream(stub_.get());
  v1::ActorMessage message;
  *message.mutable_fragment() = Message("a", 0, 0);
  for (int i = 0; i < 6; ++i) {
    absl::SleepFor(kLimit / 3);
    ASSERT_TRUE(stream.Write(message)) << i;
    ASSERT_TRUE(stream.Read().has_verdict()) << i;
  }
  EXPECT_THAT(stream.End(), IsOk());
}

TEST_F(LearnerStreamsTest, ARequestMayWaitLongerThanAClientMayBeSilent) {
  Enter("plays");
  ASSERT_THAT(Join("a"), IsOk());
  ActorsStream stream(stub_.get());
  ASSERT_TRUE(stream.Write(RequestOf("a", 2000)));
  EXPECT_TRUE(stream.Read().has_permits());
  EXPECT_THAT(stream.End(), IsOk());
}

// Its answers are bounded, since no more than they allow is read from it.
TEST_F(LearnerStreamsTest, AStreamWhoseAnswersNobodyTakesEnds) {
  ActorsStream stream(stub_.get());
  const v1::ActorMessage message = OldFragment("a");
  int sent = 0;
  while (sent < 1000 && stream.Write(message)) ++sent;
  EXPECT_GE(sent, 64);
  EXPECT_LE(sent, 70) << "a few are on their way";
  EXPECT_FALSE(stream.End().ok());
}

TEST_F(LearnerStreamsTest, StreamsAreLimited) {
  ASSERT_THAT(Join("a"), IsOk());
  ActorsStream first(stub_.get());
  ActorsStream second(stub_.get());
  for (ActorsStream* stream : {&first, &second}) {
    ASSERT_TRUE(stream->Write(RequestOf("a")));
    ASSERT_TRUE(stream->Read().has_permits());
  }
  EXPECT_EQ(GetPermits("a").status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(first.End(), IsOk());
  EXPECT_THAT(GetPermits("a"), IsOk());
}

TEST_F(LearnerStreamsTest, WeightsThatNobodyReadsAreDropped) {
  weights_.Publish(kPublishedVersion, std::make_shared<HostWeights>(std::string(64 << 20, 'w')));
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
