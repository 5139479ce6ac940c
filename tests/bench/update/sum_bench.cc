// Measures what two ranks pay for the sum of a gradient: two processes, each on a core of its own.
//
//   build/bin/sum_bench [--floats=607000] [--sums=300] [--shared=false]

#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/flags/parse.h>
#include <absl/status/status.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/telemetry/process_usage.h"
#include "learner/ranks/rank_group.h"
#include "learner/ranks/rank_links.h"

ABSL_FLAG(int, floats, 607000, "of a gradient; PPO-CNN has 607,000 parameters");
ABSL_FLAG(int, sums, 300, "to measure");
ABSL_FLAG(bool, shared, true, "through shared memory; false: as between hosts");
ABSL_FLAG(int, port, 29517, "a free one, of loopback");

namespace craftfleet {
namespace {

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}

void Pin(int core) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(core, &set);
  (void)sched_setaffinity(0, sizeof(set), &set);
}

// Returns the exit status.
int Run(int rank) {
  Pin(rank);
  RankOptions options;
  options.rank = rank;
  options.world_size = 2;
  options.master_port = absl::GetFlag(FLAGS_port);
  const auto meeting = RankMeeting::Open(options, "");
  if (!meeting.ok()) return Fail(meeting.status());
  auto links = (*meeting)->Connect({"canary", "build"});
  if (!links.ok()) return Fail(links.status());
  RankGroup group(*std::move(links));
  const std::vector<float> own(absl::GetFlag(FLAGS_floats), 0.5F);
  if (absl::GetFlag(FLAGS_shared)) {
    if (const absl::Status status = group.ShareMemory(1, own.size()); !status.ok()) return Fail(status);
  }
  std::vector<float> total(own.size());
  const std::vector<SumTerm> terms = {{own}};
  const int sums = absl::GetFlag(FLAGS_sums);
  double cpu = 0;
  absl::Time begin;
  for (int i = -10; i < sums; ++i) {
    if (i == 0) {
      begin = SteadyNow();
      cpu = ReadProcessUsage().cpu_seconds;
    }
    const absl::Status status = group.Sum(terms, absl::MakeSpan(total));
    if (!status.ok()) return Fail(status);
  }
  std::printf("rank %d: %.2f ms a sum of %.1f MB, %.2f ms of CPU time\n", rank,
              absl::ToDoubleMilliseconds(SteadyNow() - begin) / sums, own.size() * sizeof(float) / 1e6,
              (ReadProcessUsage().cpu_seconds - cpu) * 1e3 / sums);
  (void)group.Agree(absl::OkStatus());
  return 0;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  absl::ParseCommandLine(argc, argv);
  const pid_t child = fork();  // before there are threads
  const int status = craftfleet::Run(child == 0 ? 1 : 0);
  if (child == 0) return status;
  int other = 0;
  waitpid(child, &other, 0);
  return status != 0 || other != 0 ? 1 : 0;
}
