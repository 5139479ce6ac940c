#include "common/config/text_format.h"

#include <string>
#include <vector>

#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

namespace craftfleet {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::DescriptorPool;
using google::protobuf::EnumDescriptor;
using google::protobuf::FieldDescriptor;

// " (known fields of RunConfig: agent, env, ...)" for an error about an unknown field, else "".
std::string FieldAdvice(absl::string_view message) {
  const std::vector<std::string> parts = absl::StrSplit(message, '"');
  if (parts.size() < 2 || !absl::StrContains(message, "no field named")) return "";
  const Descriptor* descriptor = DescriptorPool::generated_pool()->FindMessageTypeByName(parts[1]);
  if (descriptor == nullptr) return "";
  std::vector<std::string> names;
  names.reserve(descriptor->field_count());
  for (int i = 0; i < descriptor->field_count(); ++i) names.push_back(descriptor->field(i)->name());
  return absl::StrCat(" (known fields of ", descriptor->name(), ": ", absl::StrJoin(names, ", "), ")");
}

// The enumeration of the field `name` in a message of `type`, or in one that is part of it; null: there is none. No
// type may be part of itself.
const EnumDescriptor* FindEnum(const Descriptor& type, absl::string_view name) {
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (field.enum_type() != nullptr && field.name() == name) return field.enum_type();
    if (field.message_type() == nullptr) continue;
    if (const EnumDescriptor* found = FindEnum(*field.message_type(), name)) return found;
  }
  return nullptr;
}

// " (known values: FP32, TF32, BF16)" for an error about an unknown value in a message of `type`, else "".
std::string KnownValues(absl::string_view message, const Descriptor& type) {
  const std::vector<std::string> parts = absl::StrSplit(message, '"');
  if (parts.size() < 4 || !absl::StartsWith(message, "Unknown enumeration value")) return "";
  const EnumDescriptor* values = FindEnum(type, parts[3]);
  if (values == nullptr) return "";
  std::vector<std::string> names;
  for (int i = 0; i < values->value_count(); ++i) {
    const absl::string_view name = values->value(i)->name();
    if (!absl::EndsWith(name, "_UNSPECIFIED")) names.emplace_back(name);
  }
  return absl::StrCat(" (known values: ", absl::StrJoin(names, ", "), ")");
}

// The byte of `line` at a column of Protobuf's, where a tab reaches up to the next multiple of 8.
size_t ByteAt(absl::string_view line, int column) {
  size_t byte = 0;
  for (int at = 0; byte < line.size() && at < column; ++byte) at = line[byte] == '\t' ? (at / 8 + 1) * 8 : at + 1;
  return byte;
}

// "learning_rate: " if the text before `byte` of `line` ends in "learning_rate:" or, for a number's sign,
// "learning_rate: -"; else "".
std::string FieldBefore(absl::string_view line, size_t byte) {
  absl::string_view before = absl::StripTrailingAsciiWhitespace(line.substr(0, byte));
  if (absl::ConsumeSuffix(&before, "-")) before = absl::StripTrailingAsciiWhitespace(before);
  if (!absl::ConsumeSuffix(&before, ":")) return "";
  return absl::StrCat(before.substr(before.find_last_of(" \t{;,") + 1), ": ");
}

// Keeps the first error, with its position in readable form.
class FirstError : public google::protobuf::io::ErrorCollector {
 public:
  // `type` is the message's.
  FirstError(absl::string_view text, absl::string_view filename, const Descriptor& type)
      : lines_(absl::StrSplit(text, '\n')), filename_(filename), type_(type) {}

  void AddError(int line, google::protobuf::io::ColumnNumber column, const std::string& message) override {
    if (!status_.ok()) return;
    const bool known_place = line >= 0 && line < static_cast<int>(lines_.size());
    const size_t byte = known_place ? ByteAt(lines_[line], column) : 0;
    const std::string field = known_place ? FieldBefore(lines_[line], byte) : "";
    const std::string place = line >= 0 ? absl::StrCat(":", line + 1, ":", byte + 1) : "";
    status_ = absl::InvalidArgumentError(
        absl::StrCat(filename_, place, ": ", field, message, FieldAdvice(message), KnownValues(message, type_)));
  }

  const absl::Status& status() const { return status_; }

 private:
  const std::vector<absl::string_view> lines_;
  const absl::string_view filename_;
  const Descriptor& type_;
  absl::Status status_;
};

}  // namespace

absl::Status ParseTextFormat(absl::string_view text, absl::string_view filename, google::protobuf::Message* message) {
  const std::string bytes(text);
  FirstError error(text, filename, *message->GetDescriptor());
  google::protobuf::TextFormat::Parser parser;
  parser.RecordErrorsTo(&error);
  if (parser.ParseFromString(bytes, message)) return absl::OkStatus();
  return error.status().ok() ? absl::InvalidArgumentError(absl::StrCat(filename, ": not protobuf text format"))
                             : error.status();
}

}  // namespace craftfleet
