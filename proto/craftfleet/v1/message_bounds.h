// What a received message may cost: checked before it is parsed. Included by the generated services.

#pragma once

#include <cstddef>

#include <google/protobuf/message.h>
#include <grpcpp/impl/codegen/proto_utils.h>
#include <grpcpp/support/byte_buffer.h>
#include <grpcpp/support/proto_buffer_reader.h>
#include <grpcpp/support/proto_buffer_writer.h>
#include <grpcpp/support/status.h>

#include "craftfleet/v1/environment.pb.h"
#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet::v1 {

// A parsed field takes up to 100 times its bytes: an empty message has 2 in the buffer and some 200 in memory. So the
// number of fields is limited, at all levels together; no message of the programs has half as many.
inline constexpr size_t kMaxFields = 1 << 17;
inline constexpr size_t kSmallMessage = 64 << 10;  // bytes; such messages are parsed without counting

// ResourceExhausted: `buffer` has more bytes than a message of the type of `message` needs, or more than kMaxFields
// fields.
grpc::Status CheckBounds(const grpc::ByteBuffer& buffer, const google::protobuf::MessageLite& message);

// How gRPC reads and writes messages.
template <typename T>
class BoundedTraits {
 public:
  static grpc::Status Serialize(const google::protobuf::MessageLite& message, grpc::ByteBuffer* buffer,
                                bool* own_buffer) {
    return grpc::GenericSerialize<grpc::ProtoBufferWriter, T>(message, buffer, own_buffer);
  }
  static grpc::Status Deserialize(grpc::ByteBuffer* buffer, google::protobuf::MessageLite* message) {
    if (grpc::Status status = CheckBounds(*buffer, *message); !status.ok()) {
      buffer->Clear();
      return status;
    }
    return grpc::GenericDeserialize<grpc::ProtoBufferReader, T>(buffer, message);
  }
};

// For requests of streams: gRPC ends a stream whose request cannot be read as if its client had left. In its place the
// service gets an empty request, which it refuses.
template <typename T>
class EmptyIfUnreadable : public BoundedTraits<T> {
 public:
  static grpc::Status Deserialize(grpc::ByteBuffer* buffer, google::protobuf::MessageLite* message) {
    if (!BoundedTraits<T>::Deserialize(buffer, message).ok()) message->Clear();
    return grpc::Status::OK;
  }
};

}  // namespace craftfleet::v1

namespace grpc {

// gRPC reads requests and replies of calls with one of each as MessageLite, messages of streams by their type.
#define CRAFTFLEET_BOUND(Message) \
  template <>                     \
  class SerializationTraits<Message, void> : public craftfleet::v1::BoundedTraits<Message> {}
CRAFTFLEET_BOUND(google::protobuf::MessageLite);
CRAFTFLEET_BOUND(craftfleet::v1::PlayReply);
CRAFTFLEET_BOUND(craftfleet::v1::LearnerMessage);
CRAFTFLEET_BOUND(craftfleet::v1::WeightsRequest);
// The learner's short calls have callbacks, which read requests by their type.
CRAFTFLEET_BOUND(craftfleet::v1::JoinRequest);
CRAFTFLEET_BOUND(craftfleet::v1::SnapshotRequest);
CRAFTFLEET_BOUND(craftfleet::v1::EvaluationResult);
CRAFTFLEET_BOUND(craftfleet::v1::Announcement);
CRAFTFLEET_BOUND(craftfleet::v1::LeaveRequest);
#undef CRAFTFLEET_BOUND
template <>
class SerializationTraits<craftfleet::v1::PlayRequest, void>
    : public craftfleet::v1::EmptyIfUnreadable<craftfleet::v1::PlayRequest> {};
template <>
class SerializationTraits<craftfleet::v1::ActorMessage, void>
    : public craftfleet::v1::EmptyIfUnreadable<craftfleet::v1::ActorMessage> {};

}  // namespace grpc
