// Many sessions with one environment server, a process of its own: its memory, threads and CPU time, and the steps that
// all of them play together.

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "actor/env_client.h"
#include "common/base/check.h"
#include "common/io/files.h"
#include "common/process/program.h"
#include "common/wire/channel.h"
#include "common/wire/protocol.h"
#include "tests/fakes/temp_folder.h"
#include "tests/integration/process.h"

ABSL_FLAG(std::string, server, "craftfleet-envserver", "the server: a program in build/bin, or a path with a slash");
ABSL_FLAG(int32_t, sessions, 2000, "number of sessions, each with a connection of its own");
ABSL_FLAG(int32_t, lanes, 1, "games of each session");
ABSL_FLAG(int32_t, threads, 4, "threads of the clients, which share the sessions");
ABSL_FLAG(double, seconds, 5, "how long to play");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "session_bench";
constexpr char kUsage[] =
    "session_bench prints what the sessions of an environment server cost; see tests/bench/README.md.";
constexpr int kFrameBytes = 64 * 64 * 3;
constexpr absl::Duration kPatience = absl::Minutes(1);

// The value of a line of /proc/PID/status.
int64_t StatusOf(pid_t pid, absl::string_view key) {
  const std::string text = *ReadFile(absl::StrCat("/proc/", pid, "/status"));
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    const std::vector<absl::string_view> words = absl::StrSplit(line, absl::ByAnyChar("\t "), absl::SkipEmpty());
    int64_t value = 0;
    if (words.size() >= 2 && words[0] == key && absl::SimpleAtoi(words[1], &value)) return value;
  }
  return -1;
}

// CPU time of a process, seconds.
double CpuSeconds(pid_t pid) {
  const std::string text = *ReadFile(absl::StrCat("/proc/", pid, "/stat"));
  const std::vector<std::string> fields = absl::StrSplit(text.substr(text.rfind(')') + 2), ' ');
  int64_t user = 0;
  int64_t system = 0;
  CRAFTFLEET_CHECK(absl::SimpleAtoi(fields[11], &user) && absl::SimpleAtoi(fields[12], &system));
  return static_cast<double>(user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

void PrintServer(pid_t pid, absl::string_view when) {
  std::printf("%-28s %8.1f MB %6ld threads\n", std::string(when).c_str(),
              static_cast<double>(StatusOf(pid, "VmRSS:")) / 1024, static_cast<long>(StatusOf(pid, "Threads:")));
  std::fflush(stdout);
}

v1::SessionHello Hello() {
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.set_run_id("bench");
  hello.mutable_env()->set_name("crafter");
  hello.mutable_env()->set_frame_size(64);
  hello.mutable_env()->set_length(10000);
  hello.set_client("bench");
  return hello;
}

// Sessions of one thread of the clients. Each sends a step, then each receives its reply.
class Sessions {
 public:
  Sessions(const std::string& server, int count, int lanes) {
    for (int i = 0; i < lanes; ++i) lanes_.push_back(i);
    for (int i = 0; i < count; ++i) {
      clients_.push_back(std::make_unique<EnvClient>(wire::Connect(server), Hello(), kFrameBytes, kPatience));
      const absl::Status status = clients_.back()->Connect(kPatience);
      if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
      CRAFTFLEET_CHECK(status.ok());
    }
  }
  void Open() {
    for (const auto& client : clients_) {
      std::vector<EnvClient::Lane> open;
      for (const int lane : lanes_) open.push_back({lane, lane + seed_++, 1, ""});
      std::string frames;
      CRAFTFLEET_CHECK(client->Open(open, &frames).ok());
    }
  }
  int64_t Step() {
    for (const auto& client : clients_) {
      std::vector<Action> actions;
      for (const int lane : lanes_) actions.push_back(static_cast<Action>((7 * steps_ + 3 * lane) % kNumActions));
      CRAFTFLEET_CHECK(client->SendStep(lanes_, actions, /*snapshot=*/false).ok());
    }
    ++steps_;
    for (const auto& client : clients_) CRAFTFLEET_CHECK(client->ReceiveStep(&batch_).ok());
    return static_cast<int64_t>(clients_.size() * lanes_.size());
  }

 private:
  std::vector<int> lanes_;
  std::vector<std::unique_ptr<EnvClient>> clients_;
  StepBatch batch_;
  int64_t steps_ = 0;
  int64_t seed_ = 0;
};

void Bench() {
  const int lanes = absl::GetFlag(FLAGS_lanes);
  const int count = absl::GetFlag(FLAGS_sessions);
  const int groups = std::min(absl::GetFlag(FLAGS_threads), count);
  const TempFolder logs;
  const auto server =
      *Process::Start(absl::GetFlag(FLAGS_server),
                      {"--listen=127.0.0.1:0", "--max_games=1000000", "--max_games_mb=1000000"}, logs / "server");
  wire::PollFewConnections();  // as craftfleet-actor; the server has a copy of the environment before this
  const std::string address = *server->WaitForAddress();
  PrintServer(server->pid(), "no session");
  std::vector<std::unique_ptr<Sessions>> all;
  for (int group = 0; group < groups; ++group) {
    all.push_back(std::make_unique<Sessions>(address, (count + group) / groups, lanes));
  }
  PrintServer(server->pid(), absl::StrCat(count, " idle sessions"));
  for (const auto& sessions : all) {
    sessions->Open();
    sessions->Step();
  }
  PrintServer(server->pid(), absl::StrCat(count, " sessions of ", lanes, " games"));

  std::atomic<int64_t> steps{0};
  const double cpu_s = CpuSeconds(server->pid());
  const absl::Time start = absl::Now();
  const absl::Time end = start + absl::Seconds(absl::GetFlag(FLAGS_seconds));
  std::vector<std::thread> threads;
  for (const auto& sessions : all) {
    threads.emplace_back([&steps, &sessions, end] {
      while (absl::Now() < end) steps += sessions->Step();
    });
  }
  for (std::thread& thread : threads) thread.join();
  const auto played = static_cast<double>(steps);
  std::printf("%.0f steps/s, %.1f us of the server's CPU time a step\n",
              played / absl::ToDoubleSeconds(absl::Now() - start), 1e6 * (CpuSeconds(server->pid()) - cpu_s) / played);
  PrintServer(server->pid(), "after playing");
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags({craftfleet::kProgram, craftfleet::kUsage}, argc, argv);
  craftfleet::Bench();
  return 0;
}
