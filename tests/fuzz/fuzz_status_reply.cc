// The status of a process, as `craftfleet status` and `top` show it: lines of printable ASCII, at most as wide as the
// page.

#include <algorithm>

#include <absl/strings/ascii.h>

#include "common/base/check.h"
#include "deploy/cli/status_text.h"
#include "deploy/cli/top/top_view.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

bool IsPrintable(absl::string_view text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return absl::ascii_isprint(c); });
}

}  // namespace

void TryInput(absl::string_view input) {
  v1::StatusReply reply;
  if (!reply.ParseFromArray(input.data(), static_cast<int>(input.size()))) return;
  for (const char c : StatusText(reply)) CRAFTFLEET_CHECK(c == '\n' || absl::ascii_isprint(c));
  for (const int height : {0, 24}) {
    TopPage page;
    page.height = height;
    for (const TextLine& line : DrawTop(reply, TopState(), page)) {
      CRAFTFLEET_CHECK(IsPrintable(line.text) && static_cast<int>(line.text.size()) <= page.width);
    }
  }
}

std::vector<std::string> SoundInputs() {
  v1::StatusReply reply;
  reply.set_role("learner");
  reply.set_name("host-12-ab");
  reply.set_run_id("20231114-221320-abcdef");
  v1::Metric* metric = reply.add_metrics();
  metric->set_name("env_steps");
  metric->set_value(12288);
  v1::ActivityTime* time = reply.mutable_summary()->add_times();
  time->set_activity("update");
  time->set_share(0.9);
  reply.mutable_fleet()->set_bottleneck("learner");
  reply.mutable_fleet()->set_advice("add threads");
  v1::Peer* peer = reply.add_peers();
  peer->set_role("actor");
  peer->set_name("host-13-cd");
  peer->set_address("127.0.0.1:40000");
  *peer->mutable_summary() = reply.summary();
  return {reply.SerializeAsString()};
}

}  // namespace craftfleet
