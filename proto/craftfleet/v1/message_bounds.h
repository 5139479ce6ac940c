// What a received message may cost: checked before it is parsed. Included by the generated services.

#ifndef CRAFTFLEET_PROTO_MESSAGE_BOUNDS_H_
#define CRAFTFLEET_PROTO_MESSAGE_BOUNDS_H_

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

}  // namespace craftfleet::v1

namespace grpc {

// gRPC reads requests and replies of calls with one of each as MessageLite, messages of streams by their type.
template <>
class SerializationTraits<google::protobuf::MessageLite, void>
    : public craftfleet::v1::BoundedTraits<google::protobuf::MessageLite> {};
template <>
class SerializationTraits<craftfleet::v1::WatchRequest, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::WatchRequest> {};
template <>
class SerializationTraits<craftfleet::v1::StatusReply, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::StatusReply> {};
template <>
class SerializationTraits<craftfleet::v1::PlayRequest, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::PlayRequest> {};
template <>
class SerializationTraits<craftfleet::v1::PlayReply, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::PlayReply> {};
template <>
class SerializationTraits<craftfleet::v1::ActorMessage, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::ActorMessage> {};
template <>
class SerializationTraits<craftfleet::v1::LearnerMessage, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::LearnerMessage> {};
template <>
class SerializationTraits<craftfleet::v1::WeightsRequest, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::WeightsRequest> {};
// The learner's short calls have callbacks, which read requests by their type.
template <>
class SerializationTraits<craftfleet::v1::JoinRequest, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::JoinRequest> {};
template <>
class SerializationTraits<craftfleet::v1::SnapshotRequest, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::SnapshotRequest> {};
template <>
class SerializationTraits<craftfleet::v1::EvaluationResult, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::EvaluationResult> {};
template <>
class SerializationTraits<craftfleet::v1::Announcement, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::Announcement> {};
template <>
class SerializationTraits<craftfleet::v1::LeaveRequest, void>
    : public craftfleet::v1::BoundedTraits<craftfleet::v1::LeaveRequest> {};

}  // namespace grpc

#endif  // CRAFTFLEET_PROTO_MESSAGE_BOUNDS_H_
