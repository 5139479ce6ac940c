// Costs of calls between two processes: CPU time of both ends, bytes, calls per second.

#ifndef CRAFTFLEET_TESTS_BENCH_WIRE_MEASURE_H_
#define CRAFTFLEET_TESTS_BENCH_WIRE_MEASURE_H_

#include <cstdint>
#include <functional>
#include <string>

namespace craftfleet {

// The work of a client in one turn.
struct Turn {
  int64_t calls = 0;
  int64_t bytes = 0;  // of the messages, both ways
};

// The clients' end, in the child process. Threads make turns concurrently until the time is over.
class Meter {
 public:
  // Communicates with PrintMeasurements in the parent through the two pipes. `seconds`: duration of a measurement.
  Meter(int to_parent, int from_parent, double seconds)
      : to_parent_(to_parent), from_parent_(from_parent), seconds_(seconds) {}

  // Each of `clients` threads calls `turn` with its number repeatedly; the parent prints a row named `what`.
  void Measure(const std::string& what, int clients, const std::function<Turn(int client)>& turn);

 private:
  const int to_parent_;
  const int from_parent_;
  const double seconds_;
};

// The servers' end, in the parent: prints a row for each measurement until the child has closed its pipe.
void PrintMeasurements(int from_child, int to_child);

// The fields of a measurement; where the two ends differ, there is one for each.
struct Measurement {
  char what[64] = {};
  int64_t calls = 0;
  int64_t bytes = 0;
  double seconds = 0;
  double client_cpu_s = 0;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_BENCH_WIRE_MEASURE_H_
