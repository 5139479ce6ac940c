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
    if (session_ != nullptr) {
      session_->idle_since = 0;
      session_->meter.Switch(Activity::kEnvironment);
    } else if (!request_.has_hello()) {
      // At once: it may wait for a thread behind many other sessions, and this one has no memory for it yet.
      request_ = v1::PlayRequest();
    }
    Threads()->Add([this] { Answer(); });
  }

  void OnWriteDone(bool ok) override {
    if (!ok) return Threads()->Add([this] { End(absl::OkStatus()); });
    session_->meter.Switch(Activity::kIdle);
    session_->idle_since = absl::ToUnixNanos(SteadyNow());
    watched_->Await("the next request (--idle_timeout)", service_->options_.idle_timeout);
    StartRead(&request_);
  }

  void OnDone() override { delete this; }

 private:
  // Those that answer the next request.
  GameThreads* Threads() const {
    return session_ == nullptr || session_->slow() ? &service_->slow_threads_ : &service_->game_threads_;
  }

  // The status of a session that ends because its client sends no more requests.
  absl::Status WithoutRequest() const {
    if (session_ != nullptr || context_->IsCancelled()) return absl::OkStatus();
    return absl::InvalidArgumentError("a session begins with hello");
  }

  // Begins to answer the request, or goes on. After the write or the end this object may be gone.
  void Answer() {
    if (context_->IsCancelled()) return End(absl::OkStatus());  // while the request waited for a thread
    turn_ends_ = SteadyNow() + kTurn;
    absl::Status status;
    try {
      status = session_ == nullptr ? Greet() : Play();
    } catch (const std::exception& error) {  // from a library, or out of memory
      status =
          absl::AbortedError(absl::StrCat("the environment failed (", error.what(), "): continue from the snapshots"));
    }
    if (!status.ok()) return End(status);
    if (session_->batch.unfinished()) return Threads()->Add([this] { Answer(); });
    watched_->Await("a reply to be taken (--reply_timeout)", service_->options_.reply_timeout);
    StartWrite(&reply_);
  }

  absl::Status Greet() {
    if (!request_.has_hello()) return absl::InvalidArgumentError("a session begins with hello");
    CRAFTFLEET_ASSIGN_OR_RETURN(session_, service_->Greet(request_.hello(), &*share_));
    session_->batch.StopWhen([this] { return context_->IsCancelled(); });
    session_->batch.PauseWhen([this] { return Threads()->others_wait() && SteadyNow() >= turn_ends_; });
    CRAFTFLEET_RETURN_IF_ERROR(Enter(request_.hello()));
    reply_.set_program_version(std::string(ProgramVersion()));
    reply_.set_canary(service_->canary_);
    reply_.set_frame_format(static_cast<v1::FrameFormat>(session_->batch.format()));
    FinishReply();
    return absl::OkStatus();
  }

  // Registers the session, which has no games yet, and binds the server to its run.   FailedPrecondition: it belongs to
  // another run (SetRun).   ResourceExhausted: it has sessions of another run.
  absl::Status Enter(const v1::SessionHello& hello) {
    const MutexLock lock(&service_->mu_);
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
    session_->name = hello.client();
    session_->address = context_->peer();
    session_->run_id = hello.run_id();
    session_->bytes = share_->bytes();
    session_->context = context_;
    service_->sessions_.insert(session_.get());
    return absl::OkStatus();
  }

  void Leave() {
    const MutexLock lock(&service_->mu_);
    if (service_->sessions_.erase(session_.get()) > 0) service_->ended_.Add(session_->meter.Total());
    service_->changed_.NotifyAll();
  }

  // As far as it gets in its turn.
  absl::Status Play() {
    EnvBatch& batch = session_->batch;
    CRAFTFLEET_RETURN_IF_ERROR(batch.unfinished() ? batch.Resume() : Begin(request_, session_.get(), &reply_));
    if (batch.unfinished()) return absl::OkStatus();
    reply_.clear_program_version();
    reply_.clear_canary();
    reply_.clear_frame_format();
    CRAFTFLEET_RETURN_IF_ERROR(service_->Complete(request_, session_.get(), &reply_));
    if (const size_t bytes = reply_.ByteSizeLong(); bytes > wire::kMaxMessageBytes) {
      return absl::ResourceExhaustedError(absl::StrFormat(
          "a reply of %d bytes, want at most %d: ask for fewer lanes at once", bytes, wire::kMaxMessageBytes));
    }
    if (request_.has_step()) {
      session_->meter.Count(request_.step().lanes_size());
    } else {
      const MutexLock lock(&service_->mu_);
      session_->lanes = batch.size();
      service_->changed_.NotifyAll();
    }
    FinishReply();
    return absl::OkStatus();
  }

  void FinishReply() {
    request_ = v1::PlayRequest();  // a session that waits must not keep megabytes of its last request
    reply_.set_busy_ns(absl::ToInt64Nanoseconds(session_->meter.Switch(Activity::kWire)));
    reply_.clear_server();
    if (service_->clock_.Now() < next_summary_) return;
    next_summary_ = service_->clock_.Now() + kSummarizeEvery;
    *reply_.mutable_server() = service_->RecentSummary();
  }

  // Frees the games and the stream's place before the client learns that it has ended.
  void End(absl::Status status) {
    if (session_ != nullptr) Leave();
    session_.reset();
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
  std::unique_ptr<Session> session_;  // from the hello on
  absl::Time turn_ends_;
  absl::Time next_summary_ = absl::InfinitePast();  // the server's, in a reply
};

grpc::ServerBidiReactor<v1::PlayRequest, v1::PlayReply>* EnvServiceImpl::Play(grpc::CallbackServerContext* context) {
  return new PlayStream(this, context);
}

}  // namespace craftfleet
