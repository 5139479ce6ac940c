// EnvServiceImpl: clients whose requests are invalid.
#include <functional>
#include <numeric>
#include <ostream>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/protocol.h"
#include "envserver/env_service.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Sends `requests` in order; the last one is answered by an error. env_batch_test has those of lanes, field_edges_test
// those of single fields.
struct InvalidClient {
  std::string what;
  std::function<std::vector<v1::PlayRequest>()> requests;
  absl::StatusCode code;
  std::vector<std::string> message;
  friend void PrintTo(const InvalidClient& misdeed, std::ostream* out) { *out << misdeed.what; }
};

class InvalidClients : public EnvServiceTest, public testing::WithParamInterface<InvalidClient> {};

TEST_P(InvalidClients, EndTheirSessionAndNoOther) {
  Witness witness(server());
  witness.PlayOn(3);
  Session session(server());
  std::vector<v1::PlayRequest> requests = GetParam().requests();
  const v1::PlayRequest last = requests.back();
  requests.pop_back();
  for (const v1::PlayRequest& request : requests) ASSERT_THAT(session.Send(request), IsOk());
  const auto reply = session.Send(last);
  for (const std::string& part : GetParam().message) EXPECT_THAT(reply, StatusIs(GetParam().code, HasSubstr(part)));
  witness.PlayOn(3);
  EXPECT_EQ(Status().peers_size(), 1);
}

v1::PlayRequest HelloBut(const std::function<void(v1::SessionHello*)>& change) {
  v1::PlayRequest request = Hello("run-a");
  change(request.mutable_hello());
  return request;
}

const std::vector<InvalidClient>& AllInvalidClients() {
  using Requests = std::vector<v1::PlayRequest>;
  constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
  constexpr auto kPrecondition = absl::StatusCode::kFailedPrecondition;
  static const auto* const misdeeds = new std::vector<InvalidClient>{
      {"NoHello", [] { return Requests{Open(0, 1)}; }, kInvalid, {"a session begins with hello"}},
      {"LargeOpenBeforeHello",
       [] { return Requests{Open(0, 1, std::string(100'000, 'x'))}; },
       kInvalid,
       {"a session begins with hello"}},
      {"HelloTwice",
       [] {
         return Requests{Hello("run-a"), Hello("run-a")};
       },
       kInvalid,
       {"hello came twice"}},
      {"EmptyRequest",
       [] {
         return Requests{Hello("run-a"), {}};
       },
       kInvalid,
       {"want open, step or close"}},
      {"OlderProtocol",
       [] { return Requests{HelloBut([](auto* h) { h->set_protocol_version(0); })}; },
       kPrecondition,
       {absl::StrCat("speaks protocol version ", wire::kProtocolVersion, ", the actor 0"), "upgrade the actor"}},
      {"NewerProtocol",
       [] { return Requests{HelloBut([](auto* h) { h->set_protocol_version(wire::kProtocolVersion + 1); })}; },
       kPrecondition,
       {"upgrade the environment server"}},
      {"OtherTextures",
       [] { return Requests{HelloBut([](auto* h) { h->set_texture_digest("0123456789abcdef"); })}; },
       kPrecondition,
       {"0123456789abcdef", "--textures"}},
      {"OtherRun",
       [] { return Requests{Hello("run-b")}; },
       absl::StatusCode::kResourceExhausted,  // the server is free again when that run ends
       {"serves run run-a", "belongs to run run-b"}},
      {"UnknownGame",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_name("pong"); })}; },
       kInvalid,
       {"environment \"pong\"", "want \"crafter\""}},
      {"UnknownOption",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_name("crafter:colour=red"); })}; },
       kInvalid,
       {"unknown option \"colour", "want one of"}},
      {"TinyFrames",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_frame_size(3); })}; },
       kInvalid,
       {"picture width 3, want "}},
      {"NegativeLength",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_length(-5); })}; },
       kInvalid,
       {"length -5, want "}},
      {"AnotherSessionsLane",
       [] {
         return Requests{Hello("run-a"), Step({7}, "\x01")};
       },
       kInvalid,
       {"lane 7 is not open in this session"}},
      {"Action17",
       [] {
         return Requests{Hello("run-a"), Open(0, 1), Step({0}, "\x11")};
       },
       kInvalid,
       {"action 17 at 0, want 0..16"}},
      {"ActionMissing",
       [] {
         return Requests{Hello("run-a"), Open(0, 1), Step({0}, "")};
       },
       kInvalid,
       {"actions: 0 bytes, want 1"}},
      {"TooManyLanes",
       [] {
         v1::PlayRequest close;
         close.mutable_close()->mutable_lanes()->Resize(EnvBatch::kMaxLanes + 1, 0);
         return Requests{Hello("run-a"), close};
       },
       kInvalid,
       {"4097 lanes in one request, want at most 4096"}},
      {"AReplyBeyondTheLargestMessage",
       [] {
         constexpr int kLanes = 300;
         std::vector<int> lanes(kLanes);
         std::iota(lanes.begin(), lanes.end(), 0);
         return Requests{HelloBut([](auto* h) {
                           h->mutable_env()->set_frame_size(256);
                           h->mutable_env()->set_length(1);
                         }),
                         OpenMany(kLanes), Step(lanes, std::string(kLanes, '\0'))};
       },
       absl::StatusCode::kResourceExhausted,
       {"want at most 100663296: ask for fewer lanes at once"}},
  };
  return *misdeeds;
}

INSTANTIATE_TEST_SUITE_P(EnvService, InvalidClients, testing::ValuesIn(AllInvalidClients()),
                         [](const auto& info) { return info.param.what; });

}  // namespace
}  // namespace craftfleet
