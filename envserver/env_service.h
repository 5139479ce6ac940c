// The gRPC service of an environment server. Sessions have no thread each, since most of them wait for their client
// most of the time: gRPC calls them back on a few threads of its own, and others, two for each core, play all games.

#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/base/types.h"
#include "common/process/cgroup.h"
#include "common/telemetry/activity_meter.h"
#include "common/telemetry/limited_log.h"
#include "common/wire/stream_watch.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "envserver/env_batch.h"
#include "envserver/game_budget.h"
#include "envserver/game_threads.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// Serves any number of sessions of one run at a time: of the run that it belongs to, or without one (SetRun) of that of
// the first session. Thread-safe.
class EnvServiceImpl final : public v1::EnvironmentService::CallbackService {
 public:
  // Largest request, bytes: clients open at most 32 games at once (EnvClient::kOpenAtOnce), each from a snapshot of at
  // most 112 KiB, with as much room to spare. Replies are larger.
  static constexpr int kMaxRequestBytes = 8 << 20;

  // Without limits by default, which suits a single client in the same process.
  struct Options {
    GameBudget::Options budget = {};
    absl::Duration hello_timeout = absl::InfiniteDuration();  // for a session's first request
    absl::Duration idle_timeout = absl::InfiniteDuration();   // for each later one
    absl::Duration reply_timeout = absl::InfiniteDuration();  // for the client to take a reply
    // A session that has sent no request for this long ends if others need the room of its games.
    absl::Duration gives_way = absl::Seconds(10);
    int game_threads = DefaultThreads();  // that play the games of all sessions, at least 1, and as many for slow ones
  };

  // Reads the textures in `texture_dir` once; empty: those compiled into the program. InvalidArgument: a budget that
  // GameBudget::Options::Validate refuses; or the status of Textures::Load() if textures are missing or damaged.
  static absl::StatusOr<std::unique_ptr<EnvServiceImpl>> Create(const std::string& texture_dir, const Options& options);
  static absl::StatusOr<std::unique_ptr<EnvServiceImpl>> Create(const std::string& texture_dir);

  grpc::ServerBidiReactor<v1::PlayRequest, v1::PlayReply>* Play(grpc::CallbackServerContext* context) override;

  // From now on refuses sessions of other runs than `run_id`, that of the learner that the server is registered with:
  // without this, any client could keep a run's actors out with an idle session. Open sessions go on.
  void SetRun(absl::string_view run_id) ABSL_LOCKS_EXCLUDED(mu_);

  // TextureDigest of the textures.
  const std::string& texture_digest() const { return texture_digest_; }
  // GameCanary of the textures.
  const std::string& canary() const { return canary_; }

  // Counts, rates and sessions for the status page.
  void FillStatus(v1::StatusReply* reply) const ABSL_LOCKS_EXCLUDED(mu_);
  // The summary for the learner.
  v1::ProcessSummary Summary() const ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until no session has a game, at most `timeout`.
  void WaitUntilEmpty(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // From the hello on.
  struct Session {
    Session(GameBudget::Share* of_session, EnvBatch opened, Clock* clock)
        : share(of_session), batch(std::move(opened)), meter(clock, Activity::kEnvironment) {}
    // Reserves memory for the games of the batch and `more_games` like them, with room for so many objects more than
    // usual, or releases it. Errors as GameBudget::Share::Set.
    absl::Status Reserve(int64_t more_games, int64_t more_objects);
    // Whether a step of one game may take longer than a thread's turn: its pictures are large.
    bool slow() const;

    GameBudget::Share* const share;
    // Its games, and what the request that it is answering refers to.
    EnvBatch batch;
    std::vector<EnvBatch::OpenLane> to_open;
    std::vector<Action> actions;
    StepBatch step;
    // What other threads read while it is in `sessions_`.
    ActivityMeter meter;
    std::atomic<int64_t> idle_since{0};  // ns of the steady clock; 0: it is served
    int lanes = 0;                       // changes with `mu_` locked; what follows does not change
    std::string name;                    // as its client calls itself
    std::string address;
    std::string run_id;  // empty: any
    int64_t bytes = 0;   // reserved without its games
    grpc::CallbackServerContext* context = nullptr;
  };
  class PlayStream;

  EnvServiceImpl(std::shared_ptr<const Textures> textures, std::string texture_digest, std::string canary,
                 const Options& options);

  // play_requests.cc: performs the handshake and returns the session, without open games. `share` outlives it.
  // FailedPrecondition or InvalidArgument: it cannot be served.   ResourceExhausted: its pictures exceed the memory
  // limits.
  absl::StatusOr<std::unique_ptr<Session>> Greet(const v1::SessionHello& hello, GameBudget::Share* share);
  // Begins to answer `request`, which must not change meanwhile. If that leaves games unfinished, EnvBatch::Resume goes
  // on. Then Complete fills in `reply`.   InvalidArgument, ResourceExhausted, Cancelled: the session ends.
  static absl::Status Begin(const v1::PlayRequest& request, Session* session, v1::PlayReply* reply);
  absl::Status Complete(const v1::PlayRequest& request, Session* session, v1::PlayReply* reply);

  const std::shared_ptr<const Textures> textures_;
  const std::string texture_digest_;
  const std::string canary_;
  const Options options_;
  GameBudget budget_;
  wire::StreamWatch watch_;

  Work TotalWorkLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  v1::ProcessSummary SummaryLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // What tells the client of a session apart from others, as in the learner: its certificate, else its host.
  std::string ClientOf(const grpc::ServerContextBase& context) const;
  // Whether a session is open that plays for a run.
  bool IsBoundLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Ends the session that has been idle for longest, of `client` or (null) of all, if that is long enough.
  void EndIdlest(const std::string* client) ABSL_LOCKS_EXCLUDED(mu_);
  static constexpr absl::Duration kSummarizeEvery = absl::Seconds(1);
  // A summary at most that old, for the replies of all sessions.
  v1::ProcessSummary RecentSummary() ABSL_LOCKS_EXCLUDED(mu_);

  RealClock clock_;
  LimitedLog log_{&clock_};  // of what clients cause
  std::atomic<int64_t> episodes_{0};
  std::atomic<int64_t> rejected_{0};  // sessions refused, or ended by a bad request, a limit, a timeout or an error

  mutable Mutex mu_;
  CondVar changed_;                              // games of a session
  std::string own_run_id_ ABSL_GUARDED_BY(mu_);  // as SetRun; empty: none
  std::string run_id_ ABSL_GUARDED_BY(mu_);      // of the open sessions; kept after the last one for the status page
  std::set<const Session*> sessions_ ABSL_GUARDED_BY(mu_);
  Work ended_ ABSL_GUARDED_BY(mu_);  // of sessions that have ended
  v1::ProcessSummary recent_summary_ ABSL_GUARDED_BY(mu_);
  absl::Time summarized_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();

  // The last members: they use all of the above. A hello, or a step of a slow game, keeps a thread for up to a second.
  // With threads of their own, the system divides the cores between them and the other games.
  GameThreads game_threads_;
  GameThreads slow_threads_;
};

}  // namespace craftfleet
