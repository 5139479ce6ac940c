// The learner process: run folder, trainer and gRPC server put together.

#ifndef CRAFTFLEET_LEARNER_LEARNER_H_
#define CRAFTFLEET_LEARNER_LEARNER_H_

#include <memory>
#include <optional>
#include <ostream>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/clock.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/admin_service.h"
#include "learner/checkpoint_requests.h"
#include "learner/evaluation_book.h"
#include "learner/evaluation_schedule.h"
#include "learner/fleet_book.h"
#include "learner/fragment_journal.h"
#include "learner/lane_ledger.h"
#include "learner/learner_service.h"
#include "learner/ppo/ppo_updater.h"
#include "learner/run/progress.h"
#include "learner/run/run_folder.h"
#include "learner/server_registry.h"
#include "learner/trainer.h"
#include "learner/weight_store.h"

namespace craftfleet {

// Run is called once, from one thread; the rest is thread-safe. It serves as long as it lives: an actor that still
// talks over InProcess() once the server is gone would crash within gRPC 1.51.
class Learner {
 public:
  struct Options {
    v1::RunConfig config;  // as asked for; completed here
    std::string logdir;
    bool resume = false;       // go on with the run in `logdir`
    std::string resume_from;   // checkpoint to go back to; empty: the newest
    std::string init_from;     // a new run: checkpoint or run folder whose weights it begins with; empty: none
    std::string texture_dir;   // whose digest workers must match
    bool allow_mixed = false;  // let in workers whose canary differs (learner/build_check.h)
    wire::Server::Options server;
    int threads = 1;                   // for the update, 1..256
    std::string device = "cpu";        // for the update, as FindDevice gives it
    std::ostream* progress = nullptr;  // not null: progress lines go there
    bool progress_in_place = false;    // it is a terminal
  };

  // Looks at the run folder, loads the checkpoint and starts to listen. Nothing in the folder but its lock is changed
  // before Run: a start that fails leaves it as it was.
  //   InvalidArgument: a value of the configuration; names it.   AlreadyExists: `logdir` has a run and `resume` is off.
  //   FailedPrecondition: the run in `logdir` has another configuration (only `steps` and `checkpoint` may change);
  //   names the field.   `init_from` is of another agent.
  //   Others as RunFolder and wire::Server.
  static absl::StatusOr<std::unique_ptr<Learner>> Create(const Options& options);

  // Begins to write the run folder, then trains to the end or until Stop.
  //   Aborted: another learner has taken over the folder, whose lock did not keep it out.
  absl::Status Run();
  // Ends Run: within a minibatch and the time to write a checkpoint. Idempotent.
  void Stop() { trainer_.Stop(); }

  wire::Endpoint InProcess() { return server_->InProcess(); }
  const std::string& address() const { return server_->address(); }
  const std::string& run_id() const { return folder_->run_id(); }
  const Trainer& trainer() const { return trainer_; }
  wire::StatusServiceImpl& status() { return status_service_; }
  const v1::RunConfig& config() const { return config_; }

 private:
  struct Loaded;  // run folder, updater and the state they stand at

  Learner(const Options& options, Loaded loaded);
  void FillStatus(v1::StatusReply* reply) const;
  static absl::StatusOr<Loaded> Load(const Options& options, const v1::RunConfig& config);
  static void OpenJournal(Loaded* loaded);

  const v1::RunConfig config_;
  const std::unique_ptr<Clock> clock_;
  const std::unique_ptr<RunFolder> folder_;
  const std::unique_ptr<PpoUpdater> updater_;
  std::optional<FragmentJournal> journal_;
  LaneLedger ledger_;
  WeightStore weights_;
  FragmentQueue fragments_;
  EvaluationBook evaluation_book_;
  ServerRegistry env_servers_;
  CheckpointRequests checkpoint_requests_;
  FleetBook fleet_;
  EvaluationSchedule evaluations_;
  std::ostream null_stream_{nullptr};
  ProgressPrinter progress_;
  Trainer trainer_;
  LearnerServiceImpl service_;
  AdminServiceImpl admin_service_;
  wire::StatusServiceImpl status_service_;
  std::unique_ptr<wire::Server> server_;  // last: its threads use all of the above
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_LEARNER_H_
