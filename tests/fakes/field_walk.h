// Tries every field of a message at the extremes of its type.

#pragma once

#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {

// A sound message, with an element in each repeated field, and its check.
struct CheckedMessage {
  std::unique_ptr<google::protobuf::Message> sound;
  std::function<absl::Status(const google::protobuf::Message&)> check;
};

template <typename M>
CheckedMessage Case(const M& sound, const std::function<absl::Status(M*)>& check) {
  return {std::make_unique<M>(sound), [check](const google::protobuf::Message& message) {
            M copy = static_cast<const M&>(message);
            return check(&copy);
          }};
}

// What a walk expects of a message's fields. Keys are paths like "PermitRequest.env_servers.name"; with "[]" the number
// of elements.
struct FieldExpectations {
  std::map<std::string, std::string> harmless;     // field, or message with all of its fields -> why no value does harm
  std::map<std::string, std::string> other_words;  // field -> the error's words, if they are not the field's name
  std::map<std::string, std::string> elsewhere;    // name of a message that is not walked -> the test that checks it
};

class FieldWalk {
 public:
  // `expected` outlives the walk.
  explicit FieldWalk(const FieldExpectations* expected) : expected_(*expected) {}

  // Changes one field at a time. Expects an error with the field's name, or that the field is listed as harmless and
  // accepts some extreme value.
  void Run(const CheckedMessage& checked) {
    checked_ = &checked;
    EXPECT_THAT(checked.check(*checked.sound), IsOk()) << checked.sound->GetTypeName();
    Visit(*checked.sound, checked.sound->GetDescriptor()->name());
  }
  // To be called after the last walk: expects that each list names existing fields, and each message of `file` was
  // walked or is checked elsewhere.
  void ExpectComplete(const google::protobuf::FileDescriptor& file) const {
    for (int i = 0; i < file.message_type_count(); ++i) ExpectWalked(*file.message_type(i));
  }
  void ExpectListsAreUsed() const {
    for (const auto* list : {&expected_.harmless, &expected_.other_words}) {
      for (const auto& [field, why] : *list) EXPECT_EQ(listed_.count(field), 1) << field << " is no field: " << why;
    }
  }

 private:
  using Message = google::protobuf::Message;
  using Field = google::protobuf::FieldDescriptor;
  using Reflection = google::protobuf::Reflection;
  using Change = std::function<void(Message*, const Field*)>;

  // More elements than any sound message has.
  static constexpr int kManyElements = 1 << 17;
  static constexpr int kManyMessages = 1 << 13;
  static constexpr size_t kLongText = 1 << 20;

  void ExpectWalked(const google::protobuf::Descriptor& message) const {
    EXPECT_EQ(messages_.count(message.name()) + expected_.elsewhere.count(message.name()), 1)
        << message.name() << ": in no sample, or in both";
    for (int i = 0; i < message.nested_type_count(); ++i) ExpectWalked(*message.nested_type(i));
  }

  void Visit(const Message& message, const std::string& prefix) {
    messages_.insert(message.GetDescriptor()->name());
    for (int i = 0; i < message.GetDescriptor()->field_count(); ++i) {
      const Field* field = message.GetDescriptor()->field(i);
      const std::string name = absl::StrCat(prefix, ".", field->name());
      path_.push_back(field);
      if (field->is_repeated()) VisitRepeated(message, name);
      if (field->cpp_type() != Field::CPPTYPE_MESSAGE) {
        Expect(name, Extremes(field));
      } else if (expected_.harmless.count(name) > 0) {
        listed_.insert(name);
      } else if (expected_.elsewhere.count(field->message_type()->name()) == 0) {
        VisitMessage(message, name);
      }
      path_.pop_back();
    }
  }

  void VisitRepeated(const Message& message, const std::string& name) {
    ASSERT_GT(message.GetReflection()->FieldSize(message, path_.back()), 0) << name << ": the sample has none";
    Expect(name + "[]", {Repeat});
  }

  void VisitMessage(const Message& message, const std::string& name) {
    const Reflection& reflection = *message.GetReflection();
    if (path_.back()->is_repeated()) {
      Visit(reflection.GetRepeatedMessage(message, path_.back(), 0), name);
      return;
    }
    ASSERT_TRUE(reflection.HasField(message, path_.back())) << name << ": the sample has none";
    Visit(reflection.GetMessage(message, path_.back()), name);
  }

  void Expect(const std::string& name, const std::vector<Change>& changes) {
    const bool harmless = expected_.harmless.count(name) > 0;
    const auto other = expected_.other_words.find(name);
    if (harmless || other != expected_.other_words.end()) listed_.insert(name);
    const std::string words = other == expected_.other_words.end() ? path_.back()->name() : other->second;
    bool accepted = false;
    for (const Change& change : changes) {
      const absl::Status status = checked_->check(*Changed(change));
      accepted = accepted || status.ok();
      if (harmless) continue;
      EXPECT_THAT(status, testing::Not(IsOk())) << name << " accepts an extreme value";
      EXPECT_THAT(std::string(status.message()), testing::HasSubstr(words)) << name;
    }
    if (harmless) {
      EXPECT_TRUE(accepted) << name << " is listed as harmless, but refused";
    }
  }

  // A copy of the sound message in which the field at the end of path_ is changed; of repeated messages on the way, the
  // first.
  std::unique_ptr<Message> Changed(const Change& change) const {
    std::unique_ptr<Message> copy(checked_->sound->New());
    copy->CopyFrom(*checked_->sound);
    Message* at = copy.get();
    for (size_t i = 0; i + 1 < path_.size(); ++i) {
      const Reflection* reflection = at->GetReflection();
      at = path_[i]->is_repeated() ? reflection->MutableRepeatedMessage(at, path_[i], 0)
                                   : reflection->MutableMessage(at, path_[i]);
    }
    change(at, path_.back());
    return copy;
  }

  template <typename Value>
  static Change Set(Value value, void (Reflection::*one)(Message*, const Field*, Value) const,
                    void (Reflection::*first)(Message*, const Field*, int, Value) const) {
    return [=](Message* message, const Field* field) {
      const Reflection& reflection = *message->GetReflection();
      if (field->is_repeated()) {
        (reflection.*first)(message, field, 0, value);
      } else {
        (reflection.*one)(message, field, value);
      }
    };
  }

  template <typename Value>
  static std::vector<Change> Ends(void (Reflection::*one)(Message*, const Field*, Value) const,
                                  void (Reflection::*first)(Message*, const Field*, int, Value) const) {
    using Limits = std::numeric_limits<Value>;
    if (!Limits::has_infinity) return {Set<Value>(Limits::min(), one, first), Set<Value>(Limits::max(), one, first)};
    return {Set<Value>(Limits::infinity(), one, first), Set<Value>(-Limits::infinity(), one, first),
            Set<Value>(Limits::quiet_NaN(), one, first)};
  }

  static void SetLongText(Message* message, const Field* field) {
    const Reflection& reflection = *message->GetReflection();
    std::string escapes(kLongText, '\x1b');
    if (field->is_repeated()) {
      reflection.SetRepeatedString(message, field, 0, std::move(escapes));
    } else {
      reflection.SetString(message, field, std::move(escapes));
    }
  }

  // Both ends of what the field's type holds. None for bool and enum: all of their values are checked by their readers.
  static std::vector<Change> Extremes(const Field* field) {
    switch (field->cpp_type()) {
      case Field::CPPTYPE_INT32:
        return Ends<int32_t>(&Reflection::SetInt32, &Reflection::SetRepeatedInt32);
      case Field::CPPTYPE_INT64:
        return Ends<int64_t>(&Reflection::SetInt64, &Reflection::SetRepeatedInt64);
      case Field::CPPTYPE_FLOAT:
        return Ends<float>(&Reflection::SetFloat, &Reflection::SetRepeatedFloat);
      case Field::CPPTYPE_DOUBLE:
        return Ends<double>(&Reflection::SetDouble, &Reflection::SetRepeatedDouble);
      case Field::CPPTYPE_STRING:
        return {SetLongText};
      default:
        return {};
    }
  }

  // Adds copies of the first element.
  static void Repeat(Message* message, const Field* field) {
    const Reflection& reflection = *message->GetReflection();
    const bool is_message = field->cpp_type() == Field::CPPTYPE_MESSAGE;
    for (int i = reflection.FieldSize(*message, field); i < (is_message ? kManyMessages : kManyElements); ++i) {
      switch (field->cpp_type()) {
        case Field::CPPTYPE_MESSAGE:
          reflection.AddMessage(message, field)->CopyFrom(reflection.GetRepeatedMessage(*message, field, 0));
          break;
        case Field::CPPTYPE_INT32:
          reflection.AddInt32(message, field, reflection.GetRepeatedInt32(*message, field, 0));
          break;
        case Field::CPPTYPE_INT64:
          reflection.AddInt64(message, field, reflection.GetRepeatedInt64(*message, field, 0));
          break;
        case Field::CPPTYPE_FLOAT:
          reflection.AddFloat(message, field, reflection.GetRepeatedFloat(*message, field, 0));
          break;
        case Field::CPPTYPE_ENUM:
          reflection.AddEnumValue(message, field, reflection.GetRepeatedEnumValue(*message, field, 0));
          break;
        case Field::CPPTYPE_STRING:
          reflection.AddString(message, field, reflection.GetRepeatedString(*message, field, 0));
          break;
        default:
          FAIL() << field->full_name() << ": this test can't repeat a field of its type";
      }
    }
  }

  const FieldExpectations& expected_;
  const CheckedMessage* checked_ = nullptr;
  std::vector<const Field*> path_;
  std::set<std::string> listed_;    // fields of the lists that were found
  std::set<std::string> messages_;  // walked
};

}  // namespace craftfleet
