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

#include "craftfleet/v1/admin.pb.h"
#include "craftfleet/v1/environment.pb.h"
#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet::v1 {

// A parsed field takes up to 100 times its bytes: an empty message has 2 in the buffer and some 200 in memory. So the
// number of fields is limited, at all levels together; no message of the programs has half as many.
inline constexpr size_t kMaxFields = 1 << 17;
inline constexpr size_t kSmallMessage = 64 << 10;  // bytes; such messages are parsed without counting

// ResourceExhausted: `buffer` has more than `max_bytes` bytes, or more than kMaxFields fields.
grpc::Status CheckBounds(const grpc::ByteBuffer& buffer, size_t max_bytes, const google::protobuf::Descriptor& type);

// How gRPC reads and writes messages of one type.
template <typename T, size_t kMaxBytes>
class BoundedTraits {
 public:
  static grpc::Status Serialize(const google::protobuf::MessageLite& message, grpc::ByteBuffer* buffer,
                                bool* own_buffer) {
    return grpc::GenericSerialize<grpc::ProtoBufferWriter, T>(message, buffer, own_buffer);
  }
  static grpc::Status Deserialize(grpc::ByteBuffer* buffer, google::protobuf::MessageLite* message) {
    if (grpc::Status status = CheckBounds(*buffer, kMaxBytes, *T::descriptor()); !status.ok()) {
      buffer->Clear();
      return status;
    }
    return grpc::GenericDeserialize<grpc::ProtoBufferReader, T>(buffer, message);
  }
};

}  // namespace craftfleet::v1

// The bytes that a message of this type needs at most. Larger ones are limited by the channel (wire::kMaxMessageBytes).
#define CRAFTFLEET_BOUND_MESSAGE(Type, bytes)                 \
  template <>                                                 \
  class grpc::SerializationTraits<craftfleet::v1::Type, void> \
      : public craftfleet::v1::BoundedTraits<craftfleet::v1::Type, bytes> {}

CRAFTFLEET_BOUND_MESSAGE(StatusRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(WatchRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(CheckpointRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(PauseRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(ResumeRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(DrainRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(UndrainRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(StopRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(JoinRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(LeaveRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(SnapshotRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(WeightsRequest, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(Announcement, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(AnnounceReply, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(EvaluationReply, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(LeaveReply, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(JoinReply, craftfleet::v1::kSmallMessage);
CRAFTFLEET_BOUND_MESSAGE(EvaluationResult, 8 << 20);  // 10,000 episodes
CRAFTFLEET_BOUND_MESSAGE(StatusReply, 8 << 20);       // 1,000 workers
CRAFTFLEET_BOUND_MESSAGE(SnapshotReply, 8 << 20);     // a game and the largest state
CRAFTFLEET_BOUND_MESSAGE(PlayRequest, 8 << 20);       // environment.proto
CRAFTFLEET_BOUND_MESSAGE(PlayReply, size_t{1} << 30);
CRAFTFLEET_BOUND_MESSAGE(ActorMessage, size_t{1} << 30);
CRAFTFLEET_BOUND_MESSAGE(LearnerMessage, size_t{1} << 30);

#undef CRAFTFLEET_BOUND_MESSAGE

#endif  // CRAFTFLEET_PROTO_MESSAGE_BOUNDS_H_
