// Queries the status of a process once a second and measures how long the answer takes. Prints figures as JSON. Started
// by scale.py.
//   status_probe --target=HOST:PORT --seconds=600

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "common/base/status_macros.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/status.grpc.pb.h"

ABSL_FLAG(std::string, target, "127.0.0.1:50051", "address of the process");
ABSL_FLAG(int32_t, seconds, 600, "how long");

namespace craftfleet {
namespace {

absl::StatusOr<double> AnswerMs(const wire::Endpoint& target, v1::StatusService::Stub* stub) {
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(10));
  v1::StatusReply reply;
  const absl::Time start = absl::Now();
  const grpc::Status status = stub->GetStatus(&context, {}, &reply);
  if (!status.ok()) return wire::FromCall(status, "status", target);
  return absl::ToDoubleMilliseconds(absl::Now() - start);
}

absl::Status Run() {
  const wire::Endpoint target = wire::Connect(absl::GetFlag(FLAGS_target));
  const auto stub = v1::StatusService::NewStub(target.channel);
  std::vector<double> answers_ms;
  const absl::Time end = absl::Now() + absl::Seconds(absl::GetFlag(FLAGS_seconds));
  // The first query includes the connection and does not count.
  for (bool connected = false; absl::Now() < end || answers_ms.empty(); absl::SleepFor(absl::Seconds(1))) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const double answer_ms, AnswerMs(target, stub.get()));
    if (connected) answers_ms.push_back(answer_ms);
    connected = true;
  }
  std::sort(answers_ms.begin(), answers_ms.end());
  std::printf("%s\n",
              absl::StrFormat(R"({"median": %.1f, "p99": %.1f, "slowest": %.1f})", answers_ms[answers_ms.size() / 2],
                              answers_ms[answers_ms.size() * 99 / 100], answers_ms.back())
                  .c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(
      {"status_probe", "Measures how fast a process answers status requests; see tests/chaos/README.md."}, argc, argv);
  return craftfleet::ExitCode("status_probe", craftfleet::Run());
}
