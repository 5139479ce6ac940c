// craftfleet top: shows a fleet live in a terminal.

#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <string>
#include <tuple>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/process/flag_check.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "deploy/cli/command.h"
#include "deploy/cli/screen/terminal.h"
#include "deploy/cli/status_client.h"
#include "deploy/cli/top/status_watcher.h"
#include "deploy/cli/top/top_view.h"

ABSL_FLAG(std::string, sort, "role", "column to sort workers by: role, name, state, steps, lanes, lag, mem, err, seen");
ABSL_FLAG(bool, once, false, "print one page as plain text and exit");
ABSL_FLAG(int32_t, width, 100, "columns of plain-text pages, 40..400");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet top";
constexpr char kUsage[] =
    R"(craftfleet top shows a whole fleet: what each process does, which ones are lost, and what limits the speed of the run. It
connects only to the learner. In a terminal the page is live; keys sort, pause and scroll (h lists them). Without a terminal
it prints plain-text pages.

  craftfleet top --address=127.0.0.1:50051
  craftfleet top --address=127.0.0.1:50051 --once > page.txt)";

void PrintPage(const v1::StatusReply& status, const TopState& state, const TopPage& page) {
  for (const TextLine& line : DrawTop(status, state, page)) absl::PrintF("%s\n", line.text);
  std::fflush(stdout);
}

std::string Problem(const StatusWatcher::Seen& seen) {
  return seen.error.ok() ? "" : absl::StrCat("no status from the learner: ", seen.error.message());
}

// Prints plain-text pages until `stopping` or until standard output is closed.
absl::Status PrintPages(const StatusWatcher& watcher, const TopState& state, const TopPage& page,
                        const std::atomic<bool>& stopping) {
  int64_t printed = 0;
  while (!stopping && std::ferror(stdout) == 0) {
    const StatusWatcher::Seen seen = watcher.Last();
    if (seen.number == printed && !seen.error.ok()) return seen.error;
    if (seen.number > printed) {
      printed = seen.number;
      PrintPage(seen.status, state, page);
      absl::PrintF("\n");
    }
    absl::SleepFor(absl::Milliseconds(50));
  }
  return absl::OkStatus();
}

void ShowLive(const StatusWatcher& watcher, TopState state, TopPage page, const std::atomic<bool>& stopping) {
  const Terminal terminal;
  StatusWatcher::Seen shown = watcher.Last();
  while (!stopping && !state.quit) {
    if (!state.paused) shown = watcher.Last();
    std::tie(page.width, page.height) = Terminal::Size();
    page.problem = Problem(shown);
    terminal.Write(RenderAnsi(DrawTop(shown.status, state, page)));
    HandleKeys(terminal.ReadKeys(absl::Milliseconds(200)), WorkersOnPage(page.height), &state);
  }
}

absl::Status Run() {
  TopState state;
  const auto sort = TopColumnByName(absl::GetFlag(FLAGS_sort));
  if (!sort.has_value()) {
    return InvalidFlag("sort", absl::GetFlag(FLAGS_sort), "role, name, state, steps, lanes, lag, mem, err or seen");
  }
  state.sort = *sort;
  const absl::Duration interval = absl::GetFlag(FLAGS_interval).value;
  CRAFTFLEET_RETURN_IF_ERROR(CheckInterval(interval));
  TopPage page;
  page.address = absl::GetFlag(FLAGS_address);
  page.width = absl::GetFlag(FLAGS_width);
  page.height = 0;
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("width", page.width, 40, 400));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::Endpoint learner, ConnectToProcess("learner", page.address));
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::StatusReply first, AskStatus(learner));
  if (first.role() != "learner") {
    return absl::InvalidArgumentError(
        absl::StrFormat("--address=%s has the role %s, want the learner; craftfleet status shows any process",
                        page.address, Printable(first.role().substr(0, 80))));
  }
  if (absl::GetFlag(FLAGS_once)) {
    PrintPage(first, state, page);
    return absl::OkStatus();
  }
  std::atomic<bool> stopping{false};
  StopSignal signal([&stopping] { stopping = true; });
  const StatusWatcher watcher(learner, interval);
  if (isatty(STDIN_FILENO) == 1 && isatty(STDOUT_FILENO) == 1) {
    ShowLive(watcher, state, page, stopping);
    return absl::OkStatus();
  }
  return PrintPages(watcher, state, page, stopping);
}

int RunTop(int argc, char** argv) {
  ParseFlags({kProgram, kUsage, {"address", "once", "interval", "sort", "width"}, {"channel_flags.cc"}}, argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("top", &RunTop);

}  // namespace
}  // namespace craftfleet
