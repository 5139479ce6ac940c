// The live page: a run in a browser.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/base/clock.h"
#include "common/wire/access.h"
#include "common/wire/http_server.h"
#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/service/steering.h"
#include "learner/training/records/training_status.h"

namespace craftfleet {

// Serves the page (learner/page) and what it shows:
//   GET /             the page itself, without data
//   GET /status.json  the status of the fleet, as craftfleet status --json, at most a second old
//   GET /curves.json  the run, its curves, success rates and checkpoints, as of the last finished iteration
//   GET /frame.png    what an agent saw at the end of that iteration
//   POST /pause, /resume, /checkpoint, /drain?worker=NAME, /undrain?worker=NAME, /stop   as craftfleet admin, without
//   waiting
// A proxy may put a path before these.
//
// Rights. Without an access file the page is on loopback only and open to this host's processes, as the learner's port
// is; the Host header must then name this host or one of `hosts`, which keeps the names of other sites off. With one,
// every request but the first needs a bearer token with the right of the RPC behind it: WATCH, or STEER to post. Posts
// carry the header X-Craftfleet, which no other site can make a browser send.
class LivePage {
 public:
  struct Options {
    std::string address;                               // HOST:PORT; port 0: any free one
    wire::TlsFiles files = {};                         // with a certificate: TLS
    std::shared_ptr<wire::AccessControl> access = {};  // null: no access file
    std::vector<std::string> hosts = {};               // without one, further names that browsers may ask for
    absl::Status Validate() const;
  };
  struct Parts {
    std::string run_id;
    std::string logdir;
    v1::RunConfig config;
    std::function<v1::StatusReply()> status;  // called from other threads, as the rest
    const TrainingStatus* training;
    Steering* steering;
    Clock* clock;
  };

  // `options.address` is not empty. The parts outlive the page.
  //   InvalidArgument: a bad address or file, or one beyond loopback without TLS and access file; names the flags.
  //   Unavailable: cannot listen on the address.
  static absl::StatusOr<std::unique_ptr<LivePage>> Create(const Options& options, Parts parts);

  // "http://127.0.0.1:8080/", with the port in use.
  const std::string& url() const { return url_; }

 private:
  using Request = wire::HttpServer::Request;
  using Response = wire::HttpServer::Response;

  LivePage(const Options& options, Parts parts);
  Response Respond(const Request& request);
  Response Page() const;
  Response Status(const Request& request);
  Response Curves(const Request& request);
  Response Frame();
  Response Steer(const Request& request);
  // OK if the request may do what calls of the RPC `path` may.
  absl::Status Check(const Request& request, absl::string_view path) const;

  const std::shared_ptr<wire::AccessControl> access_;
  const std::vector<std::string> hosts_;
  const Parts parts_;
  std::string page_;
  std::string policy_;  // its content security policy

  // Of the server's thread: what was sent last, for the clients that follow.
  std::string status_;
  absl::Time status_time_ = absl::InfinitePast();
  std::string curves_;
  int64_t curves_number_ = -1;
  std::string frame_;
  int64_t frame_number_ = -1;

  std::string url_;
  std::unique_ptr<wire::HttpServer> server_;  // last: its threads use all of the above
};

}  // namespace craftfleet
