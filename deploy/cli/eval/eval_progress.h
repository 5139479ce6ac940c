// The progress line of an evaluation.

#ifndef CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_PROGRESS_H_
#define CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_PROGRESS_H_

#include <ostream>
#include <string>

#include <absl/time/time.h>

#include "common/base/clock.h"

namespace craftfleet {

// On a terminal it redraws one line; otherwise it prints a line every 10 s: "sampled: 12 of 100 episodes, 40s left".
// Thread-compatible.
class EvalProgress {
 public:
  struct Options {
    std::string part;  // name of the part, such as "sampled"
    int episodes = 1;  // number of its episodes
    bool terminal = false;
  };
  // `out` and `clock` outlive it.
  EvalProgress(const Options& options, std::ostream* out, Clock* clock);

  // To be called often; prints only when due.
  void Update(int finished);

  // Clears the line on a terminal.
  void Finish();

 private:
  const Options options_;
  std::ostream* const out_;
  Clock* const clock_;
  const absl::Time start_;
  absl::Time next_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_PROGRESS_H_
