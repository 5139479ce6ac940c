#include "tests/bench/wire/measure.h"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <thread>
#include <vector>

#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "common/base/check.h"

namespace craftfleet {
namespace {

double CpuSeconds() {
  struct rusage usage = {};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

template <typename T>
void Put(int pipe, const T& value) {
  CRAFTFLEET_CHECK(write(pipe, &value, sizeof(value)) == sizeof(value));
}

template <typename T>
bool Get(int pipe, T* value) {
  return read(pipe, value, sizeof(*value)) == sizeof(*value);
}

}  // namespace

void Meter::Measure(const std::string& what, int clients, const std::function<Turn(int client)>& turn) {
  for (int client = 0; client < clients; ++client) turn(client);  // warm-up: connects and touches memory
  char go = 'b';
  Put(to_parent_, go);
  CRAFTFLEET_CHECK(Get(from_parent_, &go));

  std::atomic<int64_t> calls{0};
  std::atomic<int64_t> bytes{0};
  const double cpu_s = CpuSeconds();
  const absl::Time start = absl::Now();
  const absl::Time end = start + absl::Seconds(seconds_);
  std::vector<std::thread> threads;
  threads.reserve(clients);
  for (int client = 0; client < clients; ++client) {
    threads.emplace_back([&, client] {
      while (absl::Now() < end) {
        const Turn done = turn(client);
        calls += done.calls;
        bytes += done.bytes;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();

  Measurement result;
  what.copy(result.what, sizeof(result.what) - 1);
  result.calls = calls;
  result.bytes = bytes;
  result.seconds = absl::ToDoubleSeconds(absl::Now() - start);
  result.client_cpu_s = CpuSeconds() - cpu_s;
  Put(to_parent_, result);
  CRAFTFLEET_CHECK(Get(from_parent_, &go));
}

void PrintMeasurements(int from_child, int to_child) {
  std::printf("%-60s %10s %9s %11s %14s %14s\n", "", "calls/s", "MB/s", "bytes/call", "server us/call",
              "client us/call");
  char go = 0;
  while (Get(from_child, &go)) {
    const double cpu_s = CpuSeconds();
    Put(to_child, go);
    Measurement result;
    if (!Get(from_child, &result)) return;
    const auto calls = static_cast<double>(std::max<int64_t>(1, result.calls));
    std::printf("%-60s %10.0f %9.1f %11.0f %14.1f %14.1f\n", result.what, calls / result.seconds,
                1e-6 * static_cast<double>(result.bytes) / result.seconds, static_cast<double>(result.bytes) / calls,
                1e6 * (CpuSeconds() - cpu_s) / calls, 1e6 * result.client_cpu_s / calls);
    std::fflush(stdout);
    Put(to_child, go);
  }
}

}  // namespace craftfleet
