// other_rank PORT: rank 1 of 2, in a process of its own, which waits for rank 0's bytes.

#include <memory>
#include <string>
#include <utility>

#include <absl/strings/numbers.h>

#include "common/base/status_macros.h"
#include "tests/learner/ranks/local_ranks.h"

namespace craftfleet {
namespace {

absl::Status WaitForBytes(int port) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto meeting, RankMeeting::Open(LocalRank(1, 2, port), ""));
  CRAFTFLEET_ASSIGN_OR_RETURN(auto links, meeting->Connect({"canary", "build"}));
  RankGroup group(std::move(links));
  std::string bytes;
  return group.Broadcast(&bytes);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  int port = 0;
  return argc == 2 && absl::SimpleAtoi(argv[1], &port) && craftfleet::WaitForBytes(port).ok() ? 0 : 1;
}
