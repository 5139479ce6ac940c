// One session with one environment server, over its own connection.

#pragma once

#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "actor/frame_reader.h"
#include "actor/play_reply.h"
#include "common/base/mutex.h"
#include "common/base/types.h"
#include "common/base/watchdog.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/environment.grpc.pb.h"

namespace craftfleet {

// Default time limit for a server's reply; a step of a game takes microseconds.
inline constexpr absl::Duration kDefaultEnvTimeout = absl::Seconds(10);

// A session ends with its first error; Connect begins a new one, without games. Errors name the server's address.
//   Unavailable: the server can't be reached or ended the session: connect again later.
//   DeadlineExceeded: it did not answer in time.   DataLoss: its answer is invalid (play_reply.h).
//   FailedPrecondition: the handshake does not match.   Cancelled: Cancel was called.   Others: as the server returns
//   them.
// Owned by one thread; Cancel may be called from any.
class EnvClient {
 public:
  // The most games that one request opens; fewer if their observations would not fit one message. Making a world takes
  // some hundredths of a second, so the timeout of such a request is longer by a hundredth for each game.
  static constexpr size_t kOpenAtOnce = 32;

  struct Lane {
    int lane = 0;
    int64_t seed = 0;
    int64_t episode = 1;   // of a new game
    std::string snapshot;  // empty: a new game
  };

  // A lane that the server did not open.
  struct Refused {
    int lane = 0;
    std::string reason;  // for people, shortened by CutReason
  };

  // `hello` begins each session. `timeout`: of each request; see also kOpenAtOnce.
  EnvClient(const wire::Endpoint& server, v1::SessionHello hello, int frame_bytes,
            absl::Duration timeout = kDefaultEnvTimeout);
  ~EnvClient();

  // Begins a session; waits at most `patience` for a connection, then the constructor's timeout for the reply.
  absl::Status Connect(absl::Duration patience) ABSL_LOCKS_EXCLUDED(mu_);
  bool connected() const { return stream_ != nullptr; }
  // Whether the server can be connected to without waiting. If not, starts to connect in the background.
  bool Reachable() const;
  // Whether the last attempt to connect has failed.
  bool Failing() const;

  // Opens games. `frames` gets the observations of the opened games, uint8[n,H,W,3]; `refused` the lanes whose
  // snapshot the server refused. `refused` may be null if none of `lanes` has a snapshot.
  absl::Status Open(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused = nullptr);
  absl::Status Close(absl::Span<const int> lanes);

  // A step in two parts, so that several servers can work at the same time: SendStep, then ReceiveStep. After an error
  // of either, the session is over. Lanes whose reply would not fit one message are stepped in several requests, all
  // but the first of them by ReceiveStep; each has the timeout.
  absl::Status SendStep(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot);
  absl::Status ReceiveStep(StepBatch* batch);

  // With `hello.recording`: the state of each game after the last Open or ReceiveStep, in order; for an episode that
  // ended, its last moment.
  const std::vector<Moment>& moments() const { return moments_; }

  // If the session has scene records: that of each observation of the last Open or ReceiveStep, in order; else empty.
  // The caller may move them out. Those of Open and of a step with snapshots, and the ones after it, can be read
  // without those before (scene_record.h).
  std::vector<std::string>& records() { return records_; }

  // How long the server worked on the last Connect, Open, Close or step.
  absl::Duration busy() const { return busy_; }
  // The last summary received; empty: none for some seconds.
  v1::ProcessSummary summary() const;

  // Ends the current session and every later one at once. May be called from any thread.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the session.
  void Disconnect() ABSL_LOCKS_EXCLUDED(mu_);
  // The same, and waits until the server has ended it too.
  void Leave();

  const std::string& address() const { return server_.address; }
  const wire::Endpoint& server() const { return server_; }

 private:
  // The number of games whose largest reply to a step fits one message, at least 1.
  size_t GamesPerReply(bool snapshot) const;
  // The rows of the current step that are not sent yet.
  int RowsWaiting() const { return step_.lanes_size() - sent_rows_; }
  // Sends as many of them as one message has room for.
  absl::Status SendRows();
  // Receives the results of the rows last sent; appends to `moments_` and `records_`.
  absl::Status ReceiveRows(StepBatch* batch);
  // Opens at most kOpenAtOnce games, and appends to `frames` and `refused`.
  absl::Status OpenSome(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused);
  // Sends `request_`. `limit`: deadline for this and Receive together.
  absl::Status Send(absl::Duration limit);
  absl::Status Receive();
  // Checks the canary in the reply to hello.   FailedPrecondition: the server plays another game; ends the session.
  absl::Status CheckCanary();
  // Ends the session if `checked`, the check of the reply, is not ok.
  absl::Status EndIfInvalid(const absl::Status& checked) ABSL_LOCKS_EXCLUDED(mu_);
  // Adds the reply's moments to `moments_`; there are none unless the session records.
  absl::Status TakeMoments(size_t lanes);
  // Notes that the session is over and frees its last reply: those of a bad server may take tens of megabytes.
  void EndSession();
  // Ends the session after a failed read or write, and returns its error.
  absl::Status Broken() ABSL_LOCKS_EXCLUDED(mu_);

  const wire::Endpoint server_;
  const v1::SessionHello hello_;
  const int frame_bytes_;
  const absl::Duration timeout_;
  const PlayReplyCheck check_;
  EpisodeLengths lengths_;
  FrameReader frames_;
  const std::unique_ptr<v1::EnvironmentService::Stub> stub_;

  v1::PlayRequest request_;  // reused: fresh messages cost page faults
  v1::PlayReply reply_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PlayRequest, v1::PlayReply>> stream_;
  v1::ProcessSummary summary_;
  absl::Time summarized_ = absl::InfinitePast();  // SteadyNow when it was received
  std::vector<Moment> moments_;
  std::vector<std::string> records_;
  absl::Duration busy_;
  v1::StepLanes step_;  // the current one
  int sent_rows_ = 0;   // its first rows, sent in one or more requests

  Mutex mu_;
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;

  absl::Duration limit_;   // of the current request
  absl::Time sent_;        // SteadyNow when it was sent
  bool overdue_ = false;   // the session was cancelled because the limit had passed
  Watchdog::Timer timer_;  // the last member: it cancels context_
};

}  // namespace craftfleet
