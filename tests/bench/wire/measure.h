// Costs of calls between two processes: CPU time of either end, bytes, calls a second.

#ifndef CRAFTFLEET_TESTS_BENCH_WIRE_MEASURE_H_
#define CRAFTFLEET_TESTS_BENCH_WIRE_MEASURE_H_

#include <cstdint>
#include <functional>
#include <string>

namespace craftfleet {

// What a client did in one turn.
struct Turn {
  int64_t calls = 0;
  int64_t bytes = 0;  // of the messages, both ways
};

// The clients' end, in the child process. Threads make turns side by side until the time is over.
class Meter {
 public:
  // Talks to Print of the parent through these two pipes. Durations in seconds.
  Meter(int to_parent, int from_parent, double seconds)
      : to_parent_(to_parent), from_parent_(from_parent), seconds_(seconds) {}

  // Each of `clients` threads calls `turn` with its number again and again; has the parent print a row about `what`.
  void Measure(const std::string& what, int clients, const std::function<Turn(int client)>& turn);

 private:
  const int to_parent_;
  const int from_parent_;
  const double seconds_;
};

// The servers' end, in the parent: prints a row for each measurement until the child has closed its pipe.
void PrintMeasurements(int from_child, int to_child);

// The fields of a measurement, each of both ends on its own where they differ.
struct Measurement {
  char what[64] = {};
  int64_t calls = 0;
  int64_t bytes = 0;
  double seconds = 0;
  double client_cpu_s = 0;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_BENCH_WIRE_MEASURE_H_
