#include "craftfleet/v1/message_bounds.h"

#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "craftfleet/v1/status.grpc.pb.h"

namespace craftfleet {
namespace {

grpc::ByteBuffer Buffer(const std::string& bytes) {
  const grpc::Slice slice(bytes);
  return {&slice, 1};
}

// As gRPC does it.
template <typename Message>
grpc::Status Parse(const std::string& bytes, Message* message) {
  grpc::ByteBuffer buffer = Buffer(bytes);
  return grpc::SerializationTraits<Message>::Deserialize(&buffer, message);
}
grpc::Status Parse(const std::string& bytes, v1::StatusRequest* message) {
  return Parse<google::protobuf::MessageLite>(bytes, message);
}

// `count` empty messages in field `number`: two bytes each.
std::string EmptyMessages(int number, size_t count) {
  std::string bytes;
  for (size_t i = 0; i < count; ++i) bytes += {static_cast<char>(number << 3 | 2), '\0'};
  return bytes;
}

TEST(MessageBounds, SmallRequestsMustBeSmall) {
  v1::StatusRequest request;
  EXPECT_TRUE(Parse("", &request).ok());
  EXPECT_TRUE(Parse(EmptyMessages(1, 1000), &request).ok()) << "fields of a later version";
  const grpc::Status status = Parse(EmptyMessages(1, 4 << 20), &request);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(status.error_message(), "StatusRequest of 8388608 bytes, want at most 65536");
}

TEST(MessageBounds, LargeMessagesHaveABoundedNumberOfFields) {
  v1::PlayReply reply;
  EXPECT_EQ(Parse(EmptyMessages(7, v1::kMaxFields), &reply).error_code(), grpc::StatusCode::OK);
  EXPECT_EQ(Parse(EmptyMessages(7, v1::kMaxFields + 1), &reply).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(Parse(EmptyMessages(9, v1::kMaxFields + 1), &reply).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED)
      << "of a later version";
}

TEST(MessageBounds, FieldsCountAtEveryLevel) {
  // PlayReply.server.times
  const std::string times = EmptyMessages(8, v1::kMaxFields);
  const auto within = [](int number, const std::string& bytes) {
    std::string message = {static_cast<char>(number << 3 | 2)};
    for (size_t size = bytes.size(); size > 0; size >>= 7) {
      message += static_cast<char>((size & 127) | (size > 127 ? 128 : 0));
    }
    return message + bytes;
  };
  v1::PlayReply message;
  EXPECT_EQ(Parse(within(11, times), &message).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
}

// No message has any; the parser keeps what is in them.
TEST(MessageBounds, FieldsOfGroupsCountToo) {
  const auto group = [](const std::string& bytes) { return "\x7b" + bytes + "\x7c"; };  // of number 15
  std::string groups;
  for (size_t i = 0; i < v1::kMaxFields; ++i) groups += group("");
  // Field 1 is a message in ours, and here is none that could be parsed.
  const std::string unlike_ours = "\x0a\x01\xff" + EmptyMessages(15, v1::kMaxFields);
  for (const std::string& bytes : {group(EmptyMessages(15, v1::kMaxFields)), group(groups), group(unlike_ours)}) {
    v1::LearnerMessage request;
    EXPECT_EQ(Parse(bytes, &request).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  }
  v1::LearnerMessage request;
  EXPECT_TRUE(Parse(group(EmptyMessages(15, v1::kMaxFields - 1)), &request).ok()) << "of a later version";
  EXPECT_EQ(Parse(std::string(1 << 20, '\x7b'), &request).error_code(), grpc::StatusCode::INTERNAL) << "too deep";
}

TEST(MessageBounds, FramesMayBeLarge) {
  v1::ActorMessage message;
  message.mutable_fragment()->set_frames(std::string(50 << 20, 'f'));
  for (int i = 0; i < 4096; ++i) message.mutable_fragment()->add_rewards(1);
  v1::ActorMessage received;
  EXPECT_TRUE(Parse(message.SerializeAsString(), &received).ok());
  EXPECT_EQ(received.fragment().frames().size(), 50u << 20);
}

// gRPC took a stream with an unreadable request for one whose client had left, and ended it with OK.
TEST(MessageBounds, UnreadableRequestsOfStreamsBecomeEmptyOnes) {
  const auto expect_empty = [](auto request) {
    for (const std::string& bytes : {std::string("\x12\xff"), EmptyMessages(2, v1::kMaxFields + 1)}) {
      EXPECT_TRUE(Parse(bytes, &request).ok());
      EXPECT_EQ(request.ByteSizeLong(), 0);
    }
  };
  expect_empty(v1::PlayRequest());
  expect_empty(v1::ActorMessage());
}

TEST(MessageBounds, MalformedMessagesAreRefusedByTheParser) {
  v1::PlayReply reply;
  EXPECT_EQ(Parse(std::string(100'000, '\xff'), &reply).error_code(), grpc::StatusCode::INTERNAL);
}

}  // namespace
}  // namespace craftfleet
