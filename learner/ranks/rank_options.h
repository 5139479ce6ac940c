// Which part of a run a learner has.

#pragma once

#include <functional>
#include <string>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/time/time.h>

namespace craftfleet {

struct RankOptions {
  int rank = 0;                                              // of this process, 0..world_size-1
  int world_size = 1;                                        // ranks of the run
  std::string given = "--world_size=1";                      // what said so, for messages: a flag or a variable
  std::string master_addr = "127.0.0.1";                     // where rank 0 listens, for all
  int master_port = 29500;                                   // at this port
  absl::Duration timeout = absl::Minutes(5);                 // for all ranks to come
  std::function<bool()> should_stop = [] { return false; };  // asked by rank 0 while it waits for the others

  // HOST:PORT of rank 0.
  std::string address() const {
    const bool is_ipv6 = absl::StrContains(master_addr, ':') && !absl::StartsWith(master_addr, "[");
    return absl::StrCat(is_ipv6 ? "[" : "", master_addr, is_ipv6 ? "]:" : ":", master_port);
  }
};

}  // namespace craftfleet
