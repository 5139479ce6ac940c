#include "learner/page/live_page.h"

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/wire/certificates.h"
#include "tests/fakes/http_client.h"
#include "tests/learner/scheduling/test_registry.h"
#include "tests/learner/training/records/open_run.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::StartsWith;

constexpr char kSteerer[] = "steerer's secret";
constexpr char kWatcher[] = "watcher's secret";
constexpr int kFrameSize = 2;

class LivePageTest : public OpenRun {
 protected:
  LivePageTest() {
    registry_.OpenIteration(/*last_fragment=*/1, /*policy_version=*/1);
    registry_.Join("anna", "127.0.0.1:1");
    page_ = *LivePage::Create({"127.0.0.1:0"}, Parts());
  }

  LivePage::Parts Parts() {
    return {"run-1", logdir_, run_->config(), [this] { return MakeStatus(); }, &training_, &steering_, &clock_};
  }
  v1::StatusReply MakeStatus() {
    v1::StatusReply status;
    status.set_role("learner");
    status.set_uptime_s(++statuses_);
    return status;
  }
  // Serves the page with an access file for a watcher and a steerer.
  void ServeWithTokens() {
    const std::string path = temp_ / "access.txt";
    ASSERT_THAT(
        ReplaceFile(path, absl::StrCat("client { name: \"w\" right: WATCH token_sha256: \"", wire::Sha256Hex(kWatcher),
                                       "\" }\n", "client { name: \"s\" right: WATCH right: STEER token_sha256: \"",
                                       wire::Sha256Hex(kSteerer), "\" }\n")),
        IsOk());
    page_ = *LivePage::Create({"127.0.0.1:0", {}, *wire::AccessControl::Create(path)}, Parts());
  }
  // An iteration ends with an episode of `reward` that unlocked the first achievement.
  void EndIteration(int64_t env_steps, double reward) {
    Episode episode;
    episode.length = 100;
    episode.reward = reward;
    episode.achievements[0] = 1;
    run_->AddEpisodes({episode});
    Fragment fragment;
    fragment.frames = std::string(size_t{2} * 3 * kFrameSize * kFrameSize, 'x');
    counters_.env_steps = env_steps;
    training_.OnIterationBegin();
    clock_.Advance(absl::Seconds(2));
    training_.OnIterationEnd(*run_, fragment, kFrameSize);
  }

  std::string Ask(const std::string& line, const std::string& headers = "Host: localhost\r\n") {
    return HttpClient(page_->url()).Ask(absl::StrCat(line, " HTTP/1.1\r\nConnection: close\r\n", headers, "\r\n"));
  }
  std::string AskAs(const std::string& token, const std::string& line, const std::string& headers = "") {
    return Ask(line, absl::StrCat("Host: a\r\nAuthorization: Bearer ", token, "\r\n", headers));
  }
  std::string Post(const std::string& path) { return Ask("POST " + path, "Host: localhost\r\nX-Craftfleet: test\r\n"); }
  static nlohmann::json Body(const std::string& reply) {
    return nlohmann::json::parse(reply.substr(reply.find("\r\n\r\n") + 4));
  }

  int statuses_ = 0;  // asked for
  TestRegistry registry_{{LaneScheduler::Options{}}, &clock_};
  CheckpointRequests checkpoints_;
  std::atomic<int> stops_{0};
  Steering steering_{{&checkpoints_, &registry_, [this] { ++stops_; }}};
  TrainerCounters counters_;
  TrainingStatus training_{run_->config(), &counters_, &clock_};
  std::unique_ptr<LivePage> page_;
};

TEST_F(LivePageTest, ServesOnePageThatAllowsOnlyItsOwnScripts) {
  EXPECT_THAT(page_->url(), StartsWith("http://127.0.0.1:"));
  const std::string reply = Ask("GET /");
  EXPECT_THAT(reply, AllOf(StartsWith("HTTP/1.1 200 "), HasSubstr("\r\nContent-Type: text/html"),
                           HasSubstr("script-src 'sha256-"), HasSubstr("frame-ancestors 'none'"),
                           HasSubstr("<!doctype html>"), HasSubstr("Chart.js v3"), Not(HasSubstr("{{"))));
  EXPECT_THAT(reply, Not(HasSubstr("src=\"http"))) << "nothing comes from elsewhere";
}

TEST_F(LivePageTest, TheStatusIsMadeAtMostOnceASecond) {
  EXPECT_EQ(Body(Ask("GET /status.json"))["role"], "learner");
  EXPECT_THAT(Ask("GET /status.json"), HasSubstr("X-Craftfleet-Steer: yes\r\n"));
  EXPECT_EQ(statuses_, 1);
  clock_.Advance(absl::Seconds(1));
  EXPECT_EQ(Body(Ask("GET /status.json"))["uptime_s"], 2);
}

TEST_F(LivePageTest, ServesCurvesOfTheLastIteration) {
  training_.OnStart(*run_);
  EXPECT_EQ(Body(Ask("GET /curves.json"))["episodes"], 0);
  EXPECT_THAT(Ask("GET /frame.png"), StartsWith("HTTP/1.1 404 "));
  EndIteration(4096, 2.5);
  const std::string reply = Ask("GET /curves.json");
  const nlohmann::json curves = Body(reply);
  EXPECT_EQ(curves["run"]["id"], "run-1");
  EXPECT_EQ(curves["run"]["agent"], "ppo_cnn");
  EXPECT_EQ(curves["env_steps"], 4096);
  EXPECT_EQ(curves["curve"]["steps"], nlohmann::json({100}));
  EXPECT_EQ(curves["curve"]["reward"], nlohmann::json({2.5}));
  EXPECT_EQ(curves["speed"]["rate"], nlohmann::json({2048})) << "rollout_steps in 2 s";
  EXPECT_EQ(curves["rates"]["collect_coal"], 100);
  EXPECT_EQ(curves["rates"]["wake_up"], 0);
  EXPECT_EQ(curves["frame"], 2);
  EXPECT_THAT(Ask("GET /frame.png"), AllOf(StartsWith("HTTP/1.1 200 "), HasSubstr("image/png"), HasSubstr("PNG\r\n")));
}

TEST_F(LivePageTest, UnchangedCurvesAreNotSentAgain) {
  EndIteration(4096, 1);
  const std::string reply = Ask("GET /curves.json");
  const size_t tag = reply.find("ETag: ") + 6;
  const std::string known =
      absl::StrCat("Host: localhost\r\nIf-None-Match: ", reply.substr(tag, reply.find('\r', tag) - tag), "\r\n");
  EXPECT_THAT(Ask("GET /curves.json", known), StartsWith("HTTP/1.1 304 "));
  EndIteration(8192, 2);
  EXPECT_THAT(Ask("GET /curves.json", known), StartsWith("HTTP/1.1 200 "));
}

TEST_F(LivePageTest, PostsSteerTheRun) {
  EXPECT_THAT(Post("/pause"), StartsWith("HTTP/1.1 200 "));
  EXPECT_TRUE(registry_.paused());
  EXPECT_THAT(Post("/resume"), HasSubstr("Resumed"));
  EXPECT_FALSE(registry_.paused());
  EXPECT_THAT(Post("/resume"), HasSubstr("was not paused"));
  EXPECT_THAT(Post("/checkpoint"), StartsWith("HTTP/1.1 200 "));
  EXPECT_TRUE(checkpoints_.pending());
  checkpoints_.Close();
  EXPECT_THAT(Post("/checkpoint"), AllOf(StartsWith("HTTP/1.1 503 "), HasSubstr("training has ended")));
  EXPECT_THAT(Post("/drain?worker=anna"), StartsWith("HTTP/1.1 200 "));
  EXPECT_TRUE(registry_.IsDrained("anna"));
  EXPECT_THAT(Post("/undrain?worker=anna"), StartsWith("HTTP/1.1 200 "));
  EXPECT_FALSE(registry_.IsDrained("anna"));
  EXPECT_THAT(Post("/drain?worker=bert"), AllOf(StartsWith("HTTP/1.1 404 "), HasSubstr("anna")));
  EXPECT_THAT(Post("/drain"), AllOf(StartsWith("HTTP/1.1 400 "), HasSubstr("worker is empty")));
  EXPECT_THAT(Post("/halt"), StartsWith("HTTP/1.1 404 "));
  EXPECT_EQ(stops_, 0);
  EXPECT_THAT(Post("/stop"), AllOf(StartsWith("HTTP/1.1 200 "), HasSubstr("--resume")));
  EXPECT_EQ(stops_, 1);
}

// A page of another site can make a browser send neither the header nor, under a name of its own, a request at all.
TEST_F(LivePageTest, OtherSitesCanNeitherSteerNorRead) {
  EXPECT_THAT(Ask("POST /pause"), AllOf(StartsWith("HTTP/1.1 403 "), HasSubstr("X-Craftfleet")));
  EXPECT_THAT(Ask("OPTIONS /pause"), StartsWith("HTTP/1.1 405 "));
  EXPECT_THAT(Ask("GET /pause"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Ask("POST /stop"), StartsWith("HTTP/1.1 403 "));
  EXPECT_THAT(Ask("GET /stop"), StartsWith("HTTP/1.1 404 "));
  EXPECT_EQ(stops_, 0);
  EXPECT_FALSE(registry_.paused());
  for (const char* host : {"evil.example", "evil.example:80", "127.0.0.1.evil.example", "unix:x", "", "[::2]:1"}) {
    for (const char* path : {"/status.json", "/curves.json", "/frame.png"}) {
      EXPECT_THAT(Ask(absl::StrCat("GET ", path), absl::StrCat("Host: ", host, "\r\n")), StartsWith("HTTP/1.1 403 "))
          << host << path;
    }
    EXPECT_THAT(Ask("POST /pause", absl::StrCat("Host: ", host, "\r\nX-Craftfleet: x\r\n")),
                StartsWith("HTTP/1.1 403 "));
  }
  for (const char* host : {"localhost:8080", "LocalHost", "127.0.0.1", "127.0.0.1:80", "[::1]", "[::1]:80"}) {
    EXPECT_THAT(Ask("GET /status.json", absl::StrCat("Host: ", host, "\r\n")), StartsWith("HTTP/1.1 200 ")) << host;
  }
}

TEST_F(LivePageTest, ANameThatIsNotExpectedIsToldWhatToDo) {
  const std::string host = "Host: hub.example.com:8000\r\n";
  EXPECT_THAT(Ask("GET /status.json", host), AllOf(StartsWith("HTTP/1.1 403 "), HasSubstr("\"hub.example.com\""),
                                                   HasSubstr("--http_hosts=hub.example.com")));
  LivePage::Options options = {"127.0.0.1:0"};
  options.hosts = {"other.example", "hub.example.com"};
  page_ = *LivePage::Create(options, Parts());
  EXPECT_THAT(Ask("GET /status.json", host), StartsWith("HTTP/1.1 200 "));
  EXPECT_THAT(Ask("GET /status.json", "Host: hub.example.com.evil\r\n"), StartsWith("HTTP/1.1 403 "));
  options.hosts = {"Hub.Example.com"};
  page_ = *LivePage::Create(options, Parts());
  EXPECT_THAT(Ask("GET /status.json", host), StartsWith("HTTP/1.1 200 ")) << "browsers write it in lower case";
}

TEST_F(LivePageTest, AProxyMayPutAPathBeforeEverything) {
  const std::string prefix = "/user/me/proxy/50080";
  const std::string page = Ask("GET " + prefix + "/");
  EXPECT_THAT(page, StartsWith("HTTP/1.1 200 "));
  EXPECT_THAT(Ask("GET " + prefix + "/status.json"), StartsWith("HTTP/1.1 200 "));
  EXPECT_THAT(Ask("GET " + prefix + "/curves.json"), StartsWith("HTTP/1.1 200 "));
  EXPECT_THAT(Ask("GET " + prefix + "/frame.png"), HasSubstr("no iteration has ended yet"));
  for (const char* path : {"/status.json", "/curves.json", "/frame.png", "/pause", "/stop"}) {
    EXPECT_THAT(page, Not(HasSubstr(absl::StrCat("\"", path)))) << "the browser would leave the prefix";
  }
  EXPECT_THAT(Post(prefix + "/pause"), StartsWith("HTTP/1.1 200 "));
  EXPECT_TRUE(registry_.paused());
}

TEST_F(LivePageTest, WithAnAccessFileNothingIsShownWithoutAToken) {
  ServeWithTokens();
  EXPECT_THAT(Ask("GET /"), StartsWith("HTTP/1.1 200 ")) << "asks for the token";
  for (const char* line : {"GET /status.json", "GET /curves.json", "GET /frame.png", "GET /else"}) {
    EXPECT_THAT(Ask(line), AllOf(StartsWith("HTTP/1.1 401 "), HasSubstr("WWW-Authenticate: Bearer"))) << line;
    EXPECT_THAT(AskAs("wrong", line), StartsWith("HTTP/1.1 401 ")) << line;
  }
  EXPECT_EQ(statuses_, 0);
  EXPECT_THAT(Post("/pause"), StartsWith("HTTP/1.1 401 "));
  EXPECT_THAT(AskAs(kWatcher, "GET /status.json"),
              AllOf(StartsWith("HTTP/1.1 200 "), HasSubstr("X-Craftfleet-Steer: no\r\n")));
  EXPECT_THAT(AskAs(kWatcher, "POST /pause", "X-Craftfleet: x\r\n"), StartsWith("HTTP/1.1 403 "));
  EXPECT_THAT(AskAs(kWatcher, "POST /stop", "X-Craftfleet: x\r\n"), StartsWith("HTTP/1.1 403 "));
  EXPECT_FALSE(registry_.paused());
  EXPECT_EQ(stops_, 0);
  EXPECT_THAT(AskAs(kSteerer, "GET /status.json"), HasSubstr("X-Craftfleet-Steer: yes\r\n"));
  EXPECT_THAT(AskAs(kSteerer, "POST /pause", "X-Craftfleet: x\r\n"), StartsWith("HTTP/1.1 200 "));
  EXPECT_TRUE(registry_.paused());
}

TEST_F(LivePageTest, AConnectionServesManyRequests) {
  const std::string request = "GET /status.json HTTP/1.1\r\nHost: localhost\r\n";
  const std::string replies =
      HttpClient(page_->url())
          .Ask(absl::StrCat(request, "\r\n", request, "\r\n", request, "Connection: close\r\n\r\n"));
  EXPECT_THAT(std::vector<std::string>(absl::StrSplit(replies, "HTTP/1.1 200 OK")), testing::SizeIs(4));
}

TEST_F(LivePageTest, HugeRequestsAndBodiesAreNotRead) {
  EXPECT_THAT(Ask("POST /pause", "Host: localhost\r\nX-Craftfleet: x\r\nContent-Length: 1000000000000\r\n"),
              StartsWith("HTTP/1.1 200 "));
  const std::string head = "GET /status.json HTTP/1.1\r\nHost: localhost\r\n";
  EXPECT_THAT(HttpClient(page_->url()).Ask(head + std::string(wire::HttpServer::kMaxRequestBytes - head.size(), 'x')),
              StartsWith("HTTP/1.1 431 "));
  EXPECT_THAT(Post("/drain?worker=" + std::string(5000, 'x')), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(Post("/drain?worker=%00%ff%0a<script>"), StartsWith("HTTP/1.1 4"));
  EXPECT_THAT(Ask("GET /status.json"), StartsWith("HTTP/1.1 200 "));
}

TEST_F(LivePageTest, BeyondThisHostItNeedsTlsAndTokens) {
  const auto refused = [&](const LivePage::Options& options, const std::string& text) {
    EXPECT_THAT(LivePage::Create(options, Parts()), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(text)));
  };
  refused({"0.0.0.0:0"}, "--access_file");
  refused({"[::]:0"}, "--tls_cert");
  refused({"nonsense"}, "--http_listen");
  refused({"unix:/tmp/x"}, "want HOST:PORT");
  ServeWithTokens();
  const std::string path = temp_ / "access.txt";
  refused({"0.0.0.0:0", {}, *wire::AccessControl::Create(path)}, "--tls_cert");
  const std::string address = page_->url().substr(7, page_->url().size() - 8);
  EXPECT_THAT(LivePage::Create({address}, Parts()),
              StatusIs(absl::StatusCode::kUnavailable, AllOf(HasSubstr("--http_listen"), HasSubstr(address))));
}

}  // namespace
}  // namespace craftfleet
