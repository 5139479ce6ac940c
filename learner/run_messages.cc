#include "learner/run_messages.h"

#include <cstdio>
#include <memory>

#include "common/agent/torch_setup.h"
#include "common/base/numbers.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/process/program.h"
#include "common/telemetry/log.h"
#include "common/wire/metrics.h"

namespace craftfleet {
namespace {

void LogRunStart(const Learner& learner, const std::string& logdir) {
  if (const std::string warning = SlowMathWarning(); !warning.empty()) LogWarning("%s", warning);
  LogInfo("run %s in %s%s%s", learner.run_id(), logdir, learner.address().empty() ? "" : "; listening on ",
          learner.address());
  if (const std::string page = learner.page_url(); !page.empty()) LogInfo("live page on %s", page);
  const v1::RunConfig& config = learner.config();
  const int64_t done = learner.trainer().counters().start_steps;
  if (done >= config.steps()) {
    LogInfo("the run has %s steps already, and %s were requested: nothing is left to train", WithCommas(done),
            WithCommas(config.steps()));
  } else if (const int64_t steps = StepsToTrain(config); steps != config.steps()) {
    LogInfo("training for %s steps instead of %s: whole iterations of %s steps", WithCommas(steps),
            WithCommas(config.steps()), WithCommas(config.ppo().rollout_steps()));
  }
}

void LogRunEnd(const Learner& learner) {
  switch (learner.trainer().phase()) {
    case Trainer::Phase::kTraining:
      LogInfo("stopped; continue with --resume");
      break;
    case Trainer::Phase::kEvaluating:
      LogInfo("stopped during the final evaluation; continue with --resume");
      break;
    case Trainer::Phase::kComplete:
      LogInfo("the run is complete");
      break;
  }
  if (const absl::Status printed = FinishStandardOutput(); !printed.ok()) {
    LogWarning("%s", printed.message());
    std::clearerr(stdout);
  }
}

}  // namespace

absl::Status RunWithMessages(Learner* learner, const std::string& logdir, const std::string& metrics_address,
                             const std::function<absl::Status()>& run) {
  CRAFTFLEET_RETURN_IF_ERROR(FinishStandardOutput());
  LogRunStart(*learner, logdir);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::unique_ptr<wire::HttpServer> metrics,
      wire::ServeMetrics(metrics_address, &learner->status(), [learner] { return learner->serving(); }));
  CRAFTFLEET_RETURN_IF_ERROR(run());
  LogRunEnd(*learner);
  return absl::OkStatus();
}

}  // namespace craftfleet
