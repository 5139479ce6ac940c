// EnvServiceImpl: sessions.
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/process/heap.h"
#include "common/process/version.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "envserver/env_service.h"

namespace craftfleet {
namespace {

// How long a session may keep a thread while others wait for one: about as long as a step of 500 games takes.
constexpr absl::Duration kTurn = absl::Milliseconds(2);

}  // namespace

// Registers a session from Enter() until destruction.
class EnvServiceImpl::SessionGuard {
 public:
  explicit SessionGuard(EnvServiceImpl* service)
      : service_(service), meter_(&service->clock_, Activity::kEnvironment) {}
  ~SessionGuard() {
    MutexLock lock(&service_->mu_);
    if (service_->sessions_.erase(this) > 0) service_->ended_.Add(meter_.Total());
    service_->changed_.NotifyAll();
  }
  // Binds the server to the session's run; `share` has no games yet.   FailedPrecondition: it belongs to another run
  // (SetRun).   ResourceExhausted: it has sessions of another run.
  absl::Status Enter(const v1::SessionHello& hello, const GameBudget::Share& share,
                     grpc::CallbackServerContext* context) {
    MutexLock lock(&service_->mu_);
    std::string& run_id = service_->run_id_;
    const std::string last_run_id = run_id;
    if (!service_->own_run_id_.empty()) {
      run_id = service_->own_run_id_;
    } else if (!service_->IsBoundLocked()) {
      run_id = hello.run_id();
    }
    if (run_id != last_run_id && !run_id.empty()) service_->log_.Info("run", absl::StrCat("serves run ", run_id));
    const absl::Status same_run = wire::CheckHandshake("environment server", {wire::kProtocolVersion, run_id, ""},
                                                       "actor", {wire::kProtocolVersion, hello.run_id(), ""});
    // Without a learner it is free again when the other run's sessions end: actors wait, as any client may claim it.
    if (!same_run.ok() && service_->own_run_id_.empty()) return absl::ResourceExhaustedError(same_run.message());
    CRAFTFLEET_RETURN_IF_ERROR(same_run);
    Session& session = service_->sessions_[this];
    session.name = hello.client();
    session.client = share.client();
    session.address = context->peer();
    session.run_id = hello.run_id();
    session.bytes = share.bytes();
    session.meter = &meter_;
    session.context = context;
    session.idle_since = &idle_since_;
    return absl::OkStatus();
  }
  void SetLanes(int lanes) {
    MutexLock lock(&service_->mu_);
    service_->sessions_[this].lanes = lanes;
    service_->changed_.NotifyAll();
  }
  // Adds the server's summary to a reply, at intervals.
  void AddSummary(v1::PlayReply* reply) {
    reply->clear_server();
    if (service_->clock_.Now() < next_summary_) return;
    next_summary_ = service_->clock_.Now() + kSummarizeEvery;
    *reply->mutable_server() = service_->RecentSummary();
  }
  ActivityMeter* meter() { return &meter_; }
  // The session waits for its client.
  void BeginIdle() {
    meter_.Switch(Activity::kIdle);
    idle_since_ = absl::ToUnixNanos(SteadyNow());
  }
  // Its client has sent a request.
  void BeginWork() {
    idle_since_ = 0;
    meter_.Switch(Activity::kEnvironment);
  }

 private:
  EnvServiceImpl* const service_;
  ActivityMeter meter_;
  absl::Time next_summary_ = absl::InfinitePast();
  std::atomic<int64_t> idle_since_{0};
};

// One call of Play. gRPC calls one method at a time, and OnDone last; between OnReadDone and the write, or the end, the
// session belongs to a thread for games.
class EnvServiceImpl::PlayStream final : public grpc::ServerBidiReactor<v1::PlayRequest, v1::PlayReply> {
 public:
  PlayStream(EnvServiceImpl* service, grpc::CallbackServerContext* context)
      : service_(service),
        context_(context),
        peer_(context->peer()),
        watched_(std::in_place, &service->watch_, context),
        share_(std::in_place, &service->budget_, service->ClientOf(*context)) {
    absl::Status admitted = watched_->admitted();
    if (admitted.ok()) admitted = share_->Set(0, SessionBytes(0, 0, 0, false, 0));
    if (admitted.ok()) {
      watched_->Await("a hello (--hello_timeout)", service_->options_.hello_timeout);
      StartRead(&request_);
    } else {
      End(admitted);
    }
  }

  void OnReadDone(bool ok) override {
    watched_->Work();
    if (!ok) return Threads()->Add([this] { End(WithoutRequest()); });
    // At once: it may wait for a thread behind many other sessions, and this one has no memory for it yet.
    if (games_ == nullptr && !request_.has_hello()) request_ = v1::PlayRequest();
    if (session_.has_value()) session_->BeginWork();
    Threads()->Add([this] { Answer(); });
  }

  void OnWriteDone(bool ok) override {
    if (!ok) return Threads()->Add([this] { End(absl::OkStatus()); });
    session_->BeginIdle();
    watched_->Await("the next request (--idle_timeout)", service_->options_.idle_timeout);
    StartRead(&request_);
  }

  void OnDone() override { delete this; }

 private:
  // Those that answer the next request.
  GameThreads* Threads() const {
    return games_ == nullptr || games_->slow() ? &service_->slow_threads_ : &service_->game_threads_;
  }

  // The status of a session that ends because its client sends no more requests.
  absl::Status WithoutRequest() const {
    if (games_ != nullptr || context_->IsCancelled()) return absl::OkStatus();
    return absl::InvalidArgumentError("a session begins with hello");
  }

  // Begins to answer the request, or goes on. After the write or the end this object may be gone.
  void Answer() {
    if (context_->IsCancelled()) return End(absl::OkStatus());  // while the request waited for a thread
    turn_ends_ = SteadyNow() + kTurn;
    absl::Status status;
    try {
      status = games_ == nullptr ? Greet() : Play();
    } catch (const std::exception& error) {  // from a library, or out of memory
      status =
          absl::AbortedError(absl::StrCat("the environment failed (", error.what(), "): continue from the snapshots"));
    }
    if (!status.ok()) return End(status);
    if (games_->batch.unfinished()) return Threads()->Add([this] { Answer(); });
    watched_->Await("a reply to be taken (--reply_timeout)", service_->options_.reply_timeout);
    StartWrite(&reply_);
  }

  absl::Status Greet() {
    if (!request_.has_hello()) return absl::InvalidArgumentError("a session begins with hello");
    CRAFTFLEET_ASSIGN_OR_RETURN(games_, service_->Greet(request_.hello(), &*share_));
    games_->batch.StopWhen([this] { return context_->IsCancelled(); });
    games_->batch.PauseWhen([this] { return Threads()->others_wait() && SteadyNow() >= turn_ends_; });
    session_.emplace(service_);
    CRAFTFLEET_RETURN_IF_ERROR(session_->Enter(request_.hello(), *share_, context_));
    reply_.set_program_version(std::string(ProgramVersion()));
    reply_.set_canary(service_->canary_);
    reply_.set_frame_format(static_cast<v1::FrameFormat>(games_->batch.format()));
    FinishReply();
    return absl::OkStatus();
  }

  // As far as it gets in its turn.
  absl::Status Play() {
    EnvBatch& batch = games_->batch;
    CRAFTFLEET_RETURN_IF_ERROR(batch.unfinished() ? batch.Resume() : Begin(request_, games_.get(), &reply_));
    if (batch.unfinished()) return absl::OkStatus();
    reply_.clear_program_version();
    reply_.clear_canary();
    reply_.clear_frame_format();
    CRAFTFLEET_RETURN_IF_ERROR(service_->Complete(request_, games_.get(), &reply_));
    if (const size_t bytes = reply_.ByteSizeLong(); bytes > wire::kMaxMessageBytes) {
      return absl::ResourceExhaustedError(absl::StrFormat(
          "a reply of %d bytes, want at most %d: ask for fewer lanes at once", bytes, wire::kMaxMessageBytes));
    }
    if (request_.has_step()) {
      session_->meter()->Count(request_.step().lanes_size());
    } else {
      session_->SetLanes(batch.size());
    }
    FinishReply();
    return absl::OkStatus();
  }

  void FinishReply() {
    request_ = v1::PlayRequest();  // a session that waits must not keep megabytes of its last request
    reply_.set_busy_ns(absl::ToInt64Nanoseconds(session_->meter()->Switch(Activity::kWire)));
    session_->AddSummary(&reply_);
  }

  // Frees the games and the stream's place before the client learns that it has ended.
  void End(absl::Status status) {
    session_.reset();
    games_.reset();
    share_.reset();
    ReleaseFreeMemory();
    if (const absl::Status late = watched_->late(); !late.ok()) status = late;
    const bool stopped = absl::IsCancelled(status);  // by the client or by this server
    if (!status.ok() && !stopped) {
      ++service_->rejected_;
      service_->log_.Warn(wire::ClientOfPeer(peer_),
                          absl::StrFormat("session of %s ended: %s", peer_, status.message()));
    }
    watched_.reset();
    Finish(wire::ToGrpc(status));
  }

  EnvServiceImpl* const service_;
  grpc::CallbackServerContext* const context_;
  const std::string peer_;                            // gRPC may forget it before the end
  std::optional<wire::StreamWatch::Stream> watched_;  // until the call ends
  std::optional<GameBudget::Share> share_;            // likewise
  v1::PlayRequest request_;
  v1::PlayReply reply_;
  std::unique_ptr<Games> games_;         // from the hello on
  std::optional<SessionGuard> session_;  // from the hello on
  absl::Time turn_ends_;
};

grpc::ServerBidiReactor<v1::PlayRequest, v1::PlayReply>* EnvServiceImpl::Play(grpc::CallbackServerContext* context) {
  return new PlayStream(this, context);
}

}  // namespace craftfleet
