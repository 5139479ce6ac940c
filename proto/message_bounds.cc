#include "craftfleet/v1/message_bounds.h"

#include <cstdint>
#include <string>

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/wire_format_lite.h>

namespace craftfleet::v1 {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::internal::WireFormatLite;
using google::protobuf::io::CodedInputStream;

// Counts the fields of a message up to the stream's limit. False: it is malformed, which the parser reports, or has
// more than kMaxFields.
bool CountFields(CodedInputStream* in, const Descriptor& type, size_t* fields) {
  while (const uint32_t tag = in->ReadTag()) {
    if (++*fields > kMaxFields) return false;
    const FieldDescriptor* const field = type.FindFieldByNumber(WireFormatLite::GetTagFieldNumber(tag));
    const bool is_message = field != nullptr && field->message_type() != nullptr &&
                            WireFormatLite::GetTagWireType(tag) == WireFormatLite::WIRETYPE_LENGTH_DELIMITED;
    if (!is_message) {
      if (!WireFormatLite::SkipField(in, tag)) return false;
      continue;
    }
    uint32_t size = 0;
    if (!in->ReadVarint32(&size)) return false;
    const CodedInputStream::Limit limit = in->PushLimit(static_cast<int>(size));
    if (!CountFields(in, *field->message_type(), fields)) return false;
    in->PopLimit(limit);
  }
  return true;
}

}  // namespace

grpc::Status CheckBounds(const grpc::ByteBuffer& buffer, size_t max_bytes, const Descriptor& type) {
  const size_t bytes = buffer.Length();
  if (bytes > max_bytes) {
    return {grpc::StatusCode::RESOURCE_EXHAUSTED,
            type.name() + " of " + std::to_string(bytes) + " bytes, want at most " + std::to_string(max_bytes)};
  }
  if (bytes <= kSmallMessage) return grpc::Status::OK;
  grpc::ByteBuffer copy(buffer);  // shares the bytes; reading consumes it
  grpc::ProtoBufferReader reader(&copy);
  CodedInputStream in(&reader);
  size_t fields = 0;
  if (CountFields(&in, type, &fields) || fields <= kMaxFields) return grpc::Status::OK;
  return {grpc::StatusCode::RESOURCE_EXHAUSTED,
          type.name() + " with more than " + std::to_string(kMaxFields) + " fields"};
}

}  // namespace craftfleet::v1
