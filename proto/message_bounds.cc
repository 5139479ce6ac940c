#include "craftfleet/v1/message_bounds.h"

#include <cstdint>
#include <limits>
#include <map>
#include <string>

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/wire_format_lite.h>
#include <grpcpp/support/byte_buffer.h>
#include <grpcpp/support/proto_buffer_reader.h>
#include <grpcpp/support/status.h>

namespace craftfleet::v1 {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::internal::WireFormatLite;
using google::protobuf::io::CodedInputStream;

// Counts the fields of a message up to the stream's limit, or with a null `type` those of a group up to its end. False:
// it is malformed, which the parser reports, or has more than kMaxFields.
bool CountFields(CodedInputStream* in, const Descriptor* type, size_t* fields) {
  while (const uint32_t tag = in->ReadTag()) {
    const WireFormatLite::WireType wire_type = WireFormatLite::GetTagWireType(tag);
    if (wire_type == WireFormatLite::WIRETYPE_END_GROUP) return true;
    if (++*fields > kMaxFields) return false;
    if (wire_type == WireFormatLite::WIRETYPE_START_GROUP) {
      // No message has groups, but the parser keeps each field of an unknown one.
      if (!in->IncrementRecursionDepth() || !CountFields(in, nullptr, fields)) return false;
      in->DecrementRecursionDepth();
      continue;
    }
    const FieldDescriptor* const field =
        type == nullptr ? nullptr : type->FindFieldByNumber(WireFormatLite::GetTagFieldNumber(tag));
    const bool is_message =
        field != nullptr && field->message_type() != nullptr && wire_type == WireFormatLite::WIRETYPE_LENGTH_DELIMITED;
    if (!is_message) {
      if (!WireFormatLite::SkipField(in, tag)) return false;
      continue;
    }
    uint32_t size = 0;
    if (!in->ReadVarint32(&size)) return false;
    const CodedInputStream::Limit limit = in->PushLimit(static_cast<int>(size));
    if (!CountFields(in, field->message_type(), fields)) return false;
    in->PopLimit(limit);
  }
  return true;
}

// The bytes that a message of this type needs at most. Others are limited by the channel (wire::kMaxMessageBytes).
size_t MaxBytes(const Descriptor& type) {
  static const auto* const large = new std::map<const Descriptor*, size_t>{
      {EvaluationResult::descriptor(), 8 << 20},  // 10,000 episodes
      {StatusReply::descriptor(), 8 << 20},       // 1,000 workers
      {SnapshotReply::descriptor(), 8 << 20},     // a game and the largest state
      {PlayRequest::descriptor(), 8 << 20},       // environment.proto
  };
  if (const auto found = large->find(&type); found != large->end()) return found->second;
  const bool is_unlimited = &type == PlayReply::descriptor() || &type == ActorMessage::descriptor() ||
                            &type == LearnerMessage::descriptor() || &type == WeightsChunk::descriptor() ||
                            type.file()->package() != "craftfleet.v1";
  return is_unlimited ? std::numeric_limits<size_t>::max() : kSmallMessage;
}

}  // namespace

grpc::Status CheckBounds(const grpc::ByteBuffer& buffer, const google::protobuf::MessageLite& message) {
  const size_t bytes = buffer.Length();
  if (bytes <= kSmallMessage) return grpc::Status::OK;  // of any type
  const auto* const full = dynamic_cast<const google::protobuf::Message*>(&message);
  if (full == nullptr) return grpc::Status::OK;  // none of ours
  const Descriptor& type = *full->GetDescriptor();
  if (bytes > MaxBytes(type)) {
    return {grpc::StatusCode::RESOURCE_EXHAUSTED,
            type.name() + " of " + std::to_string(bytes) + " bytes, want at most " + std::to_string(MaxBytes(type))};
  }
  grpc::ByteBuffer copy(buffer);  // shares the bytes; reading consumes it
  grpc::ProtoBufferReader reader(&copy);
  CodedInputStream in(&reader);
  size_t fields = 0;
  if (CountFields(&in, &type, &fields) || fields <= kMaxFields) return grpc::Status::OK;
  return {grpc::StatusCode::RESOURCE_EXHAUSTED,
          type.name() + " with more than " + std::to_string(kMaxFields) + " fields"};
}

}  // namespace craftfleet::v1
