// Both ends of the ranges of values that workers report, and the next value beyond each.
#include "common/wire/request_check.h"

#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/protocol.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace request_check_test {

using testing::HasSubstr;

constexpr int kLanes = 3;

// A change of a valid request, and the expected error; empty: it is still valid.
template <typename Message>
struct Change {
  std::function<void(Message*)> change;
  std::string error;
};

v1::PermitRequest SoundRequest() {
  v1::PermitRequest request;
  request.set_actor("a");
  request.set_capacity(4);
  for (int lane = 0; lane < 2; ++lane) {
    request.add_active()->set_lane(lane);
  }
  request.add_failures()->set_lane(2);
  request.mutable_summary()->set_policy_version(-1);
  request.mutable_summary()->add_times()->set_share(0.5);
  return request;
}

template <typename Message>
void ExpectEach(const Message& sound, const std::vector<Change<Message>>& changes,
                const std::function<absl::Status(const Message&)>& check) {
  EXPECT_THAT(check(sound), IsOk());
  for (const Change<Message>& change : changes) {
    Message message = sound;
    change.change(&message);
    if (change.error.empty()) {
      EXPECT_THAT(check(message), IsOk()) << message.ShortDebugString();
    } else {
      EXPECT_THAT(check(message), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(change.error)));
    }
  }
}

TEST(RequestCheck, ChecksPermitRequests) {
  using Request = v1::PermitRequest;
  constexpr int64_t kMany = std::numeric_limits<int64_t>::max();
  ExpectEach<Request>(
      SoundRequest(),
      {
          {[](Request* r) { r->clear_actor(); }, "actor is empty"},
          {[](Request* r) { r->set_actor("\x1b[2J"); }, "want printable ASCII"},
          {[](Request* r) { r->set_capacity(0); }, ""},
          {[](Request* r) { r->set_capacity(-1); }, "capacity: -1, want 0..1048576"},
          {[](Request* r) { r->set_capacity(1 << 20); }, ""},
          {[](Request* r) { r->set_capacity((1 << 20) + 1); }, "capacity: 1048577"},
          {[](Request* r) { r->set_wait_ms(-1); }, "wait_ms: -1"},
          {[](Request* r) { r->set_wait_ms(86'400'000); }, ""},
          {[](Request* r) { r->set_wait_ms(86'400'001); }, "wait_ms: 86400001"},
          {[](Request* r) { r->set_evaluation(-1); }, "evaluation: -1"},
          {[](Request* r) { r->set_evaluation(kMany); }, "evaluation: 9223372036854775807"},
          {[](Request* r) { r->set_env_servers_generation(-1); }, "env_servers_generation: -1"},
          {[](Request* r) { r->mutable_active(1)->set_lane(kLanes - 1); }, ""},
          {[](Request* r) { r->mutable_active(1)->set_lane(kLanes); }, "active: lane 3, want 0..2"},
          {[](Request* r) { r->mutable_active(0)->set_lane(-1); }, "active: lane -1, want 0..2"},
          {[](Request* r) { r->mutable_active(0)->set_fragment(-1); }, "active.fragment: -1"},
          {[](Request* r) { r->mutable_active(0)->set_policy_version(-1); }, "active.policy_version: -1"},
          {[](Request* r) {
             for (int i = 0; i < 5; ++i) r->add_active();
           },
           "active permits: 7, want 0..6"},
          {[](Request* r) { r->mutable_failures(0)->set_lane(kLanes); }, "failures: lane 3, want 0..2"},
          {[](Request* r) { r->mutable_failures(0)->set_fragment(-1); }, "failures.fragment: -1"},
          {[](Request* r) { r->mutable_failures(0)->set_reason(std::string(300, 'r')); }, ""},
          {[](Request* r) { r->mutable_failures(0)->set_reason(std::string(301, 'r')); },
           "failures.reason has 301 bytes, want at most 300"},
          {[](Request* r) {
             for (int i = 0; i < kLanes; ++i) r->add_failures();
           },
           "failures: 4, want 0..3"},
          {[](Request* r) { r->mutable_summary()->set_lanes(-1); }, "summary.lanes: -1"},
      },
      [](const Request& request) { return wire::CheckPermitRequest(request, kLanes); });
}

TEST(RequestCheck, ChecksSummaries) {
  using Summary = v1::ProcessSummary;
  const double nan = std::nan("");
  ExpectEach<Summary>(
      SoundRequest().summary(),
      {
          {[](Summary* s) { s->set_steps_per_second(1e9); }, ""},
          {[](Summary* s) { s->set_steps_per_second(1.1e9); }, "summary.steps_per_second: 1.1e+09, want 0..1e+09"},
          {[](Summary* s) { s->set_steps_per_second(-1e-9); }, "summary.steps_per_second"},
          {[nan](Summary* s) { s->set_steps_per_second(nan); }, "summary.steps_per_second: nan"},
          {[](Summary* s) { s->set_policy_version(-2); }, "summary.policy_version: -2, want -1.."},
          {[](Summary* s) { s->set_memory_bytes(-1); }, "summary.memory_bytes: -1"},
          {[](Summary* s) { s->set_errors(-1); }, "summary.errors: -1"},
          {[](Summary* s) { s->set_last_error(std::string(300, 'e')); }, ""},
          {[](Summary* s) { s->set_last_error(std::string(301, 'e')); }, "summary.last_error has 301 bytes"},
          {[](Summary* s) { s->set_gpu(std::string(97, 'g')); }, "summary.gpu has 97 bytes"},
          {[](Summary* s) { s->set_gpu_memory_bytes(-1); }, "summary.gpu_memory_bytes: -1"},
          {[](Summary* s) { s->set_gpu_memory_size_bytes(-1); }, "summary.gpu_memory_size_bytes: -1"},
          {[nan](Summary* s) { s->set_gpu_utilization(nan); }, "summary.gpu_utilization: nan"},
          {[](Summary* s) { s->set_gpu_utilization(1.1); }, "summary.gpu_utilization: 1.1, want 0..1"},
          {[](Summary* s) { s->set_threads(-1); }, "summary.threads: -1"},
          {[](Summary* s) { s->set_threads(65537); }, "summary.threads: 65537"},
          {[](Summary* s) { s->mutable_times(0)->set_share(1); }, ""},
          {[](Summary* s) { s->mutable_times(0)->set_share(1.002); }, "summary.times.share: 1.002, want 0..1.001"},
          {[nan](Summary* s) { s->mutable_times(0)->set_share(nan); }, "summary.times.share: nan"},
          {[](Summary* s) { s->mutable_times(0)->set_seconds(-1); }, "summary.times.seconds: -1"},
          {[](Summary* s) { s->mutable_times(0)->set_activity(std::string(33, 'a')); }, "33 bytes, want at most 32"},
          {[](Summary* s) {
             for (int i = 0; i < 16; ++i) s->add_times();
           },
           "summary.times: 17, want 0..16"},
      },
      wire::CheckSummary);
}

TEST(RequestCheck, ChecksAnnouncementsAndJoins) {
  v1::Announcement announcement;
  announcement.set_name("server");
  announcement.set_address("10.0.0.1:50061");
  using Words = v1::Announcement;
  const std::string long_text(wire::kMaxTextBytes + 1, 'x');
  ExpectEach<Words>(announcement,
                    {
                        {[](Words* a) { a->clear_name(); }, "name is empty"},
                        {[&](Words* a) { a->set_name(long_text); }, "name has 513 bytes"},
                        {[](Words* a) { a->set_name(std::string(wire::kMaxTextBytes, 'n')); }, ""},
                        {[](Words* a) { a->set_name("n\x7f"); }, "want printable ASCII"},
                        {[](Words* a) { a->set_address("nowhere"); }, "advertise"},
                        {[](Words* a) { a->clear_address(); }, "advertise"},
                        {[](Words* a) { a->set_address("10.0.0.1:65535"); }, ""},
                        {[](Words* a) { a->set_address("10.0.0.1:65536"); }, "advertise"},
                        {[&](Words* a) { a->set_address(long_text + ":1"); }, "address has 515 bytes"},
                        {[](Words* a) { a->set_build(std::string(wire::kMaxTextBytes, 'b')); }, ""},
                        {[](Words* a) { a->set_canary("c\nd"); }, "want printable ASCII"},
                        {[](Words* a) { a->mutable_summary()->set_lanes(1 << 20); }, ""},
                        {[](Words* a) { a->mutable_summary()->set_lanes((1 << 20) + 1); }, "summary.lanes: 1048577"},
                        {[&](Words* a) { a->set_build(long_text); }, "build has 513 bytes"},
                        {[&](Words* a) { a->set_canary(long_text); }, "canary has 513 bytes"},
                        {[](Words* a) { a->mutable_summary()->set_lanes(-1); }, "summary.lanes: -1"},
                    },
                    wire::CheckAnnouncement);
  v1::JoinRequest join;
  join.set_actor("a");
  using Join = v1::JoinRequest;
  ExpectEach<Join>(join,
                   {
                       {[](Join* j) { j->clear_actor(); }, "actor is empty"},
                       {[&](Join* j) { j->set_address(long_text); }, "address has 513 bytes"},
                       {[&](Join* j) { j->set_cpu(long_text); }, "cpu has 513 bytes"},
                       {[&](Join* j) { j->set_build(long_text); }, "build has 513 bytes"},
                       {[&](Join* j) { j->set_canary("a\nb"); }, "want printable ASCII"},
                   },
                   wire::CheckJoin);
}

}  // namespace request_check_test
}  // namespace craftfleet
