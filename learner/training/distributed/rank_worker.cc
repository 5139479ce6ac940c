#include "learner/training/distributed/rank_worker.h"

#include <string>
#include <utility>

#include <absl/strings/str_format.h>
#include <absl/time/time.h>

#include "common/agent/canary.h"
#include "common/base/status_macros.h"
#include "common/process/heap.h"
#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "learner/ppo/rollout.h"
#include "learner/runnable_config.h"
#include "learner/training/distributed/rank_messages.h"

namespace craftfleet {
namespace {

// How long a rank that was asked to stop waits for rank 0 to end first.
constexpr absl::Duration kGrace = absl::Seconds(3);

}  // namespace

absl::StatusOr<std::unique_ptr<RankWorker>> RankWorker::Connect(const Options& options) {
  const RankOptions& ranks = options.ranks;
  LogInfo("rank %d of %d; waiting for rank 0 at %s", ranks.rank, ranks.world_size, ranks.address());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<RankMeeting> meeting, RankMeeting::Open(ranks, ""));
  RankOffer offer;
  std::unique_ptr<PpoUpdater> updater;
  const auto prepare = [&]() -> absl::Status {
    CRAFTFLEET_ASSIGN_OR_RETURN(offer, ParseRankOffer(meeting->offer()));
    CRAFTFLEET_RETURN_IF_ERROR(options.check(offer.config));
    CRAFTFLEET_ASSIGN_OR_RETURN(updater,
                                PpoUpdater::Create(offer.config, options.threads, "cpu", PpoUpdater::Start::kZeros));
    return absl::OkStatus();
  };
  RankBuild build = {"", BuildId(), prepare()};
  if (build.objection.ok()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(build.canary, PolicyCanary(offer.config));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<RankLinks> links, meeting->Connect(build));
  std::unique_ptr<RankWorker> worker(new RankWorker(offer, std::move(updater), std::move(links)));
  CRAFTFLEET_RETURN_IF_ERROR(ShareState(worker->updater_.get(), &worker->group_));
  LogInfo("rank %d computes for rank 0", ranks.rank);
  return worker;
}

RankWorker::RankWorker(const RankOffer& offer, std::unique_ptr<PpoUpdater> updater, std::unique_ptr<RankLinks> links)
    : shape_(FragmentShapeOf(offer.config, updater->spec())),
      frames_(offer.config, offer.texture_digest),
      updater_(std::move(updater)),
      group_(std::move(links)) {
  updater_->ShareOut(&group_);
}

absl::Status RankWorker::Run() {
  absl::StatusOr<RankCommand> command;
  absl::Status status;
  while (status.ok()) {
    command = ReceiveCommand(shape_, frames_, &group_);
    status = command.status();
    if (!status.ok() || command->kind != RankCommand::Kind::kUpdate) break;
    status = Update(*command);
    command = RankCommand();  // frees the fragments
    ReleaseFreeMemory();
  }
  ended_.Set();
  if (!status.ok()) return status;
  LogInfo("%s", command->kind == RankCommand::Kind::kComplete ? "the run is complete" : "rank 0 has stopped");
  return absl::OkStatus();
}

absl::Status RankWorker::Update(const RankCommand& command) {
  Rollout rollout;
  RolloutOptions options = updater_->rollout_options();
  for (size_t i = 0; i < command.fragments.size(); ++i) {
    options.value_scale = command.scales[i];
    AppendFragment(command.fragments[i], options, &rollout);
  }
  const absl::Status status = updater_->Update(command.iteration, rollout, [] { return false; }).status();
  // Other errors are those of all ranks, and undone on all; rank 0 knows what to do next.
  CRAFTFLEET_RETURN_IF_ERROR(group_.ended());
  if (!status.ok()) LogWarning("the update of iteration %d is undone: %s", command.iteration + 1, status.message());
  return absl::OkStatus();
}

void RankWorker::Stop() {
  if (ended_.Sleep(kGrace)) return;
  LogInfo("rank %d was stopped, but rank 0 goes on: leaving it", group_.rank());
  group_.Leave(absl::CancelledError(absl::StrFormat("rank %d was stopped", group_.rank())));
}

}  // namespace craftfleet
