#include "learner/page/live_page.h"

#include <openssl/sha.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include <absl/strings/ascii.h>
#include <absl/strings/escaping.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <nlohmann/json.hpp>

#include "common/base/crafter.h"
#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/io/png_encoder.h"
#include "common/telemetry/log.h"
#include "common/wire/channel.h"
#include "common/wire/status_service.h"
#include "learner/page/page.h"
#include "learner/run/checkpoint_store.h"

namespace craftfleet {
namespace {

constexpr char kJson[] = "application/json";
// The page has 250 KiB: a phone far away may need seconds for it.
constexpr absl::Duration kTimeout = absl::Seconds(10);
constexpr absl::Duration kStatusAge = absl::Seconds(1);
constexpr size_t kMaxShownHost = 100;  // bytes
// The RPCs whose rights apply (common/wire/access.cc).
constexpr absl::string_view kWatchCall = "/craftfleet.v1.StatusService/GetStatus";
constexpr absl::string_view kSteerCall = "/craftfleet.v1.AdminService/Pause";

// " 'sha256-...' 'sha256-...'", for a policy that allows exactly the scripts of `page`.
std::string HashesOfScripts(absl::string_view page) {
  constexpr absl::string_view kBegin = "<script>";
  std::string hashes;
  for (size_t at = page.find(kBegin); at != absl::string_view::npos; at = page.find(kBegin, at)) {
    at += kBegin.size();
    const absl::string_view script = page.substr(at, page.find("</script>", at) - at);
    unsigned char digest[SHA256_DIGEST_LENGTH];
    SHA256(reinterpret_cast<const unsigned char*>(script.data()), script.size(), digest);
    absl::StrAppend(&hashes, " 'sha256-",
                    absl::Base64Escape(absl::string_view(reinterpret_cast<char*>(digest), sizeof(digest))), "'");
  }
  return hashes;
}

// Whether `name`, of a Host header, is an address of this host or localhost. Any other name may be that of a
// site whose owner directed it here, so that its scripts could read the page.
bool NamesThisHost(absl::string_view name) {
  return !absl::StartsWith(name, "unix") && wire::IsLoopback(absl::StrCat(name, ":0"));
}

// The value of a Host header without its port.
absl::string_view WithoutPort(absl::string_view host) {
  const size_t colon = host.rfind(':');
  return colon == absl::string_view::npos || absl::EndsWith(host, "]") ? host : host.substr(0, colon);
}

// The last part of a path: "/status.json" of "/user/me/proxy/50080/status.json".
absl::string_view LastPart(absl::string_view path) {
  const size_t slash = path.rfind('/');
  return slash == absl::string_view::npos ? path : path.substr(slash);
}

int CodeOf(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return 200;
    case absl::StatusCode::kUnauthenticated:
      return 401;
    case absl::StatusCode::kPermissionDenied:
      return 403;
    case absl::StatusCode::kNotFound:
      return 404;
    case absl::StatusCode::kInvalidArgument:
      return 400;
    default:
      return 503;
  }
}

wire::HttpServer::Response Failure(const absl::Status& status) {
  wire::HttpServer::Response response = {CodeOf(status)};
  response.body = absl::StrCat(status.message(), "\n");
  if (response.code == 401) response.headers.emplace_back("WWW-Authenticate", "Bearer");
  return response;
}

wire::Caller CallerOf(const wire::HttpServer::Request& request) {
  wire::Caller caller;
  absl::string_view token = request.Header("Authorization").value_or("");
  if (absl::ConsumePrefix(&token, "Bearer ")) caller.token = std::string(token);
  caller.program = absl::StrCat("page ", request.Header("User-Agent").value_or(""));
  return caller;
}

nlohmann::json DescribeRun(const std::string& run_id, const v1::RunConfig& config) {
  return {{"id", run_id},          {"agent", config.agent()}, {"env", config.env().name()},
          {"seed", config.seed()}, {"steps", config.steps()}, {"lanes", config.lanes()}};
}

// Three decimals are more than a chart shows.
double Rounded(double value) { return std::round(value * 1000) / 1000; }

// [...]: `value` of each point.
template <typename Point, typename Value>
nlohmann::json Column(const std::vector<Point>& points, const Value& value) {
  nlohmann::json column = nlohmann::json::array();
  for (const Point& point : points) column.push_back(value(point));
  return column;
}

nlohmann::json JsonOfCurve(const std::vector<CurvePoint>& curve) {
  return {{"steps", Column(curve, [](const CurvePoint& point) { return point.steps; })},
          {"reward", Column(curve, [](const CurvePoint& point) { return Rounded(point.reward); })},
          {"score", Column(curve, [](const CurvePoint& point) { return Rounded(point.score); })}};
}

nlohmann::json JsonOfSpeed(const std::vector<TrainingStatus::SpeedPoint>& speed) {
  using Point = TrainingStatus::SpeedPoint;
  return {{"steps", Column(speed, [](const Point& point) { return point.env_steps; })},
          {"rate", Column(speed, [](const Point& point) { return static_cast<int64_t>(point.steps_per_second); })}};
}

// {"collect_coal": 1.5, ...}, in percent.
nlohmann::json JsonOfRates(const AchievementPercentages& rates) {
  nlohmann::json json;
  for (int i = 0; i < kNumAchievements; ++i) json[std::string(kAchievementNames[i])] = Rounded(rates[i]);
  return json;
}

// The newest first, with the environment steps that each has. Empty if they cannot be listed now.
nlohmann::json JsonOfCheckpoints(const std::string& logdir, int64_t steps_per_iteration) {
  nlohmann::json checkpoints = nlohmann::json::array();
  const absl::StatusOr<std::vector<std::string>> names =
      CheckpointStore::At(JoinPath(logdir, "checkpoints")).ListNewestFirst();
  if (!names.ok()) return checkpoints;
  for (const std::string& name : *names) {
    checkpoints.push_back({{"name", name}, {"steps", IterationOf(name) * steps_per_iteration}});
  }
  return checkpoints;
}

}  // namespace

absl::Status LivePage::Options::Validate() const {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("http_listen", address));
  if (absl::StartsWith(address, wire::kUnix)) {
    return absl::InvalidArgumentError(absl::StrFormat("--http_listen=%s, want HOST:PORT", address));
  }
  CRAFTFLEET_RETURN_IF_ERROR(files.Validate());
  if (!wire::IsLoopback(address) && (access == nullptr || files.certificate.empty())) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "--http_listen=%s reaches beyond this host: listen on 127.0.0.1, or add --tls_cert, --tls_key and "
        "--access_file with the tokens of those who may watch or steer",
        address));
  }
  if (access == nullptr && !files.empty()) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "--http_listen=%s: with TLS the page needs tokens too; add --access_file, or leave the page out with "
        "--http_listen=",
        address));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<LivePage>> LivePage::Create(const Options& options, Parts parts) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<LivePage> page(new LivePage(options, std::move(parts)));
  wire::HttpServer::Options server = {options.address, options.files, kTimeout, /*accept_posts=*/true,
                                      /*keep_alive=*/true};
  absl::StatusOr<std::unique_ptr<wire::HttpServer>> created =
      wire::HttpServer::Create(server, [self = page.get()](const Request& request) { return self->Respond(request); });
  if (!created.ok()) {
    return absl::Status(created.status().code(), absl::StrCat("--http_listen: ", created.status().message()));
  }
  page->server_ = *std::move(created);
  page->url_ = absl::StrCat(options.files.certificate.empty() ? "http://" : "https://", page->server_->address(), "/");
  return page;
}

LivePage::LivePage(const Options& options, Parts parts)
    : access_(options.access),
      hosts_(options.hosts),
      parts_(std::move(parts)),
      page_(PageTemplate()),
      policy_(absl::StrCat("default-src 'none'; script-src", HashesOfScripts(page_),
                           "; style-src 'unsafe-inline'; img-src blob: data:; connect-src 'self'; base-uri 'none'; "
                           "form-action 'none'; frame-ancestors 'none'")) {}

LivePage::Response LivePage::Respond(const Request& request) {
  Response response;
  const absl::string_view path = LastPart(request.path());
  if (request.is_post()) {
    response = Steer(request);
  } else if (path == "/") {
    response = Page();
  } else if (const absl::Status status = Check(request, kWatchCall); !status.ok()) {
    response = Failure(status);
  } else if (path == "/status.json") {
    response = Status(request);
  } else if (path == "/curves.json") {
    response = Curves(request);
  } else if (path == "/frame.png") {
    response = Frame();
  } else {
    response = Failure(absl::NotFoundError("the page is at /"));
  }
  response.headers.emplace_back("Cache-Control", "no-store");
  response.headers.emplace_back("X-Content-Type-Options", "nosniff");
  response.headers.emplace_back("Referrer-Policy", "no-referrer");
  return response;
}

absl::Status LivePage::Check(const Request& request, absl::string_view path) const {
  if (access_ != nullptr) return access_->Check(CallerOf(request), path);
  // Browsers write names in lower case, people as they like.
  const std::string host = absl::AsciiStrToLower(WithoutPort(request.Header("Host").value_or("")));
  const auto is_host = [&](const std::string& name) { return absl::EqualsIgnoreCase(name, host); };
  if (NamesThisHost(host) || std::any_of(hosts_.begin(), hosts_.end(), is_host)) return absl::OkStatus();
  const std::string shown = Shortened(Printable(host), kMaxShownHost);
  return absl::PermissionDeniedError(absl::StrFormat(
      "The page answers to localhost and addresses of this host, not to \"%s\", which may be another site's. Open it "
      "through an SSH tunnel at localhost, or, behind a proxy with that name, start the learner with --http_hosts=%s",
      shown, shown));
}

LivePage::Response LivePage::Page() const {
  return {200, "text/html; charset=utf-8", page_, {{"Content-Security-Policy", policy_}}};
}

LivePage::Response LivePage::Status(const Request& request) {
  const absl::Time now = parts_.clock->Now();
  if (now - status_time_ >= kStatusAge) {
    absl::StatusOr<std::string> json = wire::StatusJson(parts_.status(), /*whitespace=*/false);
    if (!json.ok()) return Failure(json.status());
    status_ = *std::move(json);
    status_time_ = now;
  }
  const bool may_steer = access_ == nullptr || access_->Allows(CallerOf(request), kSteerCall);
  return {200, kJson, status_, {{"X-Craftfleet-Steer", may_steer ? "yes" : "no"}}};
}

LivePage::Response LivePage::Curves(const Request& request) {
  const auto view = parts_.training->view();
  const std::string tag = absl::StrCat("\"", parts_.run_id, "-", view->number, "\"");
  if (request.Header("If-None-Match") == tag) return {304, kJson, "", {{"ETag", tag}}};
  if (curves_number_ != view->number) {
    const nlohmann::json json = {
        {"run", DescribeRun(parts_.run_id, parts_.config)},
        {"env_steps", view->env_steps},
        {"episodes", view->score.episodes()},
        {"curve", JsonOfCurve(view->curve)},
        {"speed", JsonOfSpeed(view->speed)},
        {"rates", JsonOfRates(view->score.SuccessPercentages())},
        {"checkpoints", JsonOfCheckpoints(parts_.logdir, parts_.config.ppo().rollout_steps())},
        {"frame", view->frame.empty() ? 0 : view->number},
    };
    curves_ = json.dump(-1, ' ', /*ensure_ascii=*/true, nlohmann::json::error_handler_t::replace);
    curves_number_ = view->number;
  }
  return {200, kJson, curves_, {{"ETag", tag}}};
}

LivePage::Response LivePage::Frame() {
  const auto view = parts_.training->view();
  if (view->frame.empty()) return Failure(absl::NotFoundError("no iteration has ended yet"));
  if (frame_number_ != view->number) {
    absl::StatusOr<std::string> png = EncodePng(view->frame, view->frame_size, view->frame_size);
    if (!png.ok()) return Failure(png.status());
    frame_ = *std::move(png);
    frame_number_ = view->number;
  }
  return {200, "image/png", frame_};
}

LivePage::Response LivePage::Steer(const Request& request) {
  if (const absl::Status status = Check(request, kSteerCall); !status.ok()) return Failure(status);
  if (!request.Header("X-Craftfleet").has_value()) {
    return Failure(absl::PermissionDeniedError("want the header X-Craftfleet"));
  }
  const std::string caller = absl::StrCat("page ", request.Client());
  const absl::string_view command = LastPart(request.path());
  const absl::string_view worker = request.Argument("worker").value_or("");
  Response done;
  if (command == "/pause") {
    parts_.steering->Pause(caller);
    done.body = "Paused: fragments that are being played are finished first.\n";
  } else if (command == "/resume") {
    done.body = parts_.steering->Resume(caller) ? "Resumed.\n" : "The run was not paused.\n";
  } else if (command == "/checkpoint") {
    const absl::StatusOr<int64_t> asked = parts_.steering->Checkpoint(caller, absl::ZeroDuration());
    if (!asked.ok() && !absl::IsDeadlineExceeded(asked.status())) return Failure(asked.status());
    done.body = "A checkpoint will be written after the update in progress.\n";
  } else if (const bool draining = command == "/drain"; draining || command == "/undrain") {
    const auto found = parts_.steering->SetDraining(caller, worker, draining);
    if (!found.ok()) return Failure(found.status());
    done.body = draining ? "The worker gets no new work; it is drained once it has none left.\n"
                         : "The worker gets work again.\n";
  } else if (command == "/stop") {
    parts_.steering->Stop(caller);
    done.body = "The learner stops, with a checkpoint. --resume continues the run.\n";
  } else {
    return Failure(absl::NotFoundError("want /pause, /resume, /checkpoint, /drain, /undrain or /stop"));
  }
  return done;
}

}  // namespace craftfleet
