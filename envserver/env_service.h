// The gRPC face of an environment server.

#ifndef CRAFTFLEET_ENVSERVER_ENV_SERVICE_H_
#define CRAFTFLEET_ENVSERVER_ENV_SERVICE_H_

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/activity_meter.h"
#include "common/clock.h"
#include "common/limited_log.h"
#include "common/mutex.h"
#include "common/wire/stream_watch.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "envserver/env_batch.h"
#include "envserver/game_budget.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// Serves any number of sessions, one gRPC thread each, that belong to one run at a time. Thread-safe.
class EnvServiceImpl final : public v1::EnvironmentService::Service {
 public:
  // By default without limits, for the only client in the same process.
  struct Options {
    GameBudget::Options budget = {};
    absl::Duration hello_timeout = absl::InfiniteDuration();  // for a session's first request, at least 1 s
    absl::Duration idle_timeout = absl::InfiniteDuration();   // for each later one, at least 1 s
    absl::Duration reply_timeout = absl::InfiniteDuration();  // for the client to take a reply, at least 1 s
    absl::Status Validate() const;
  };

  // Textures in `texture_dir`, read once. InvalidArgument: options that Validate() refuses; or the status of
  // Textures::Load when they are missing or broken.
  static absl::StatusOr<std::unique_ptr<EnvServiceImpl>> Create(const std::string& texture_dir, const Options& options);
  static absl::StatusOr<std::unique_ptr<EnvServiceImpl>> Create(const std::string& texture_dir);

  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override;

  // GameCanary of the textures.
  const std::string& canary() const { return canary_; }

  // Counts, rates and sessions for the status page.
  void FillStatus(v1::StatusReply* reply) const ABSL_LOCKS_EXCLUDED(mu_);
  // What the learner is told.
  v1::ProcessSummary Summary() const ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until no session has a game, at most `timeout`.
  void WaitUntilEmpty(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  // Of all sessions since the start.
  Work TotalWork() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Session {
    std::string client;
    std::string address;
    int lanes = 0;
    const ActivityMeter* meter = nullptr;  // of its thread
  };
  class SessionGuard;

  EnvServiceImpl(std::shared_ptr<const Textures> textures, std::string texture_digest, std::string canary,
                 const Options& options);

  absl::Status Serve(grpc::ServerContext* context, wire::StreamWatch::Stream* watched,
                     grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream);
  // Handshake, and a session's games, none open yet. FailedPrecondition or InvalidArgument: it can't be served.
  // ResourceExhausted: there is no room for its pictures.
  absl::StatusOr<EnvBatch> Greet(const v1::SessionHello& hello, GameBudget::Share* share) const;
  absl::Status Handle(const v1::PlayRequest& request, EnvBatch* batch, GameBudget::Share* share, StepBatch* step,
                      v1::PlayReply* reply);

  const std::shared_ptr<const Textures> textures_;
  const std::string texture_digest_;
  const std::string canary_;
  const Options options_;
  GameBudget budget_;
  wire::StreamWatch watch_;

  Work TotalWorkLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  v1::ProcessSummary SummaryLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The summary as it was within the last second: it is told to every session.
  v1::ProcessSummary RecentSummary() ABSL_LOCKS_EXCLUDED(mu_);

  RealClock clock_;
  LimitedLog log_{&clock_};  // of sessions that strangers end
  std::atomic<int64_t> episodes_{0};
  std::atomic<int64_t> rejected_{0};  // sessions ended by a bad request

  mutable Mutex mu_;
  CondVar changed_;                          // games of a session
  std::string run_id_ ABSL_GUARDED_BY(mu_);  // of the sessions at hand; kept after the last one for the status page
  std::map<const void*, Session> sessions_ ABSL_GUARDED_BY(mu_);
  Work ended_ ABSL_GUARDED_BY(mu_);  // of sessions that are over
  v1::ProcessSummary recent_summary_ ABSL_GUARDED_BY(mu_);
  absl::Time summarized_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_ENV_SERVICE_H_
