// The learner process: combines run folder, trainer and gRPC server.

#pragma once

#include <functional>
#include <memory>
#include <ostream>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/base/clock.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/page/live_page.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/ranks/rank_options.h"
#include "learner/run/progress.h"
#include "learner/run/run_folder.h"
#include "learner/scheduling/worker_registry.h"
#include "learner/service/admin_service.h"
#include "learner/service/learner_service.h"
#include "learner/training/distributed/rank_leader.h"
#include "learner/training/evaluation_planner.h"
#include "learner/training/fragments/fragment_collector.h"
#include "learner/training/records/checkpoint_requests.h"
#include "learner/training/trainer.h"
#include "learner/training/weight_store.h"

namespace craftfleet {

// Run is called once, from one thread; the rest is thread-safe. The server runs until destruction: an actor that used
// InProcess() after the server's end would crash within gRPC 1.51.
class Learner {
 public:
  struct Options {
    v1::RunConfig config;  // as given by the user; Create completes it
    std::string logdir;
    bool resume = false;       // continue the run in `logdir`
    std::string resume_from;   // name of the checkpoint to resume from; empty: the newest
    std::string init_from;     // for a new run: checkpoint or run folder with its initial weights; empty: none
    std::string texture_dir;   // folder of textures; empty: the built-in ones
    bool allow_mixed = false;  // accept workers with another canary (learner/scheduling/build_check.h)
    wire::Server::Options server;
    std::string http_address;               // of the live page (learner/page/live_page.h); empty: none
    std::vector<std::string> http_hosts;    // further names of it
    int threads = 1;                        // of the update, 1..256
    RankOptions ranks;                      // of rank 0; the others are RankWorkers
    std::string device = "cpu";             // of the update, as FindDevice returns it; `config` agrees (SetRunDevice)
    std::ostream* progress = nullptr;       // for progress lines; null: none
    std::function<int()> progress_columns;  // the width of `progress`; null: it is not a terminal
  };

  // Reads the run folder, loads the checkpoint and starts to listen. Changes nothing in the folder but its lock; only
  // Run does, so a failed start leaves the folder unchanged.
  //   InvalidArgument: an invalid value of the configuration; names it. More ranks than gradient_shards, or on a GPU.
  //   AlreadyExists: `logdir` has a run and `resume` is off. FailedPrecondition: the run in `logdir` has another
  //   configuration (only `steps` and `checkpoint` may change), and the message names the field; or `init_from` is of
  //   another agent. Others as RunFolder and wire::Server.
  static absl::StatusOr<std::unique_ptr<Learner>> Create(const Options& options);

  // Waits for the other ranks, begins to write the run folder, then trains until the end of the run or Stop.
  //   Aborted: another learner has taken over the folder (only on disks whose locks have no effect).   Cancelled: Stop
  //   was called before all ranks had come.   Others as RankLeader and Trainer.
  absl::Status Run();
  // Ends Run, after at most a minibatch and a checkpoint. Idempotent.
  void Stop() { trainer_.Stop(); }

  wire::Endpoint InProcess() { return server_->InProcess(); }
  // As WeightStore::Find and EvaluationTable::Weights.
  WeightStore::Weights FindWeights(int64_t version) const { return weights_.Find(version); }
  std::shared_ptr<const PolicyWeights> FindEvaluationWeights(int64_t id) {
    return registry_.evaluations()->Weights(id);
  }
  const std::string& address() const { return server_->address(); }
  bool serving() const { return server_->serving(); }
  const std::string& run_id() const { return folder_->run_id(); }
  const Trainer& trainer() const { return trainer_; }
  wire::StatusServiceImpl& status() { return status_service_; }
  const v1::RunConfig& config() const { return config_; }
  // URL of the live page; empty: none.
  std::string page_url() const { return page_ == nullptr ? "" : page_->url(); }

 private:
  struct Loaded;  // run folder, updater and loaded state

  Learner(const Options& options, Loaded loaded);
  absl::Status Train();  // the part of Run in which others may ask for a checkpoint
  void FillStatus(v1::StatusReply* reply) const;
  LearnerServiceImpl::Options ServiceOptions(Loaded* loaded) const;
  absl::Status ServePage(const Options& options, std::shared_ptr<wire::AccessControl> access);
  static absl::StatusOr<Loaded> Load(const Options& options, const v1::RunConfig& config);

  const v1::RunConfig config_;
  const std::unique_ptr<Clock> clock_;
  const std::unique_ptr<RunFolder> folder_;
  const std::unique_ptr<PpoUpdater> updater_;
  RankLeader ranks_;
  WorkerRegistry registry_;
  WeightStore weights_;
  FragmentQueue fragments_;
  CheckpointRequests checkpoint_requests_;
  EvaluationPlanner evaluations_;
  std::ostream null_stream_{nullptr};
  ProgressPrinter progress_;
  Trainer trainer_;
  LearnerServiceImpl service_;
  Steering steering_;
  AdminServiceImpl admin_service_;
  wire::StatusServiceImpl status_service_;
  std::unique_ptr<wire::Server> server_;  // last, with the next: their threads use all of the above
  std::unique_ptr<LivePage> page_;        // null: none
};

}  // namespace craftfleet
