// For LD_PRELOAD: a process that may have at most FEW_THREADS threads at a time, its first one included, as with
// `prlimit --nproc` or pids.max, which do not hold for root.
#include <dlfcn.h>
#include <pthread.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <memory>

namespace {

std::atomic<int> running{1};

struct Start {
  void* (*routine)(void*);
  void* argument;
};

// Counts the thread as ended, however it ends.
struct Counted {
  ~Counted() { --running; }
};

void* Run(void* start) {
  const Counted counted;
  const std::unique_ptr<Start> given(static_cast<Start*>(start));
  return given->routine(given->argument);
}

}  // namespace

extern "C" int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*routine)(void*),
                              void* argument) {
  using Create = int (*)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*);
  static const auto create = reinterpret_cast<Create>(dlsym(RTLD_NEXT, "pthread_create"));
  const char* const limit = std::getenv("FEW_THREADS");
  if (limit != nullptr && ++running > std::atoi(limit)) {
    --running;
    return EAGAIN;
  }
  auto start = std::make_unique<Start>(Start{routine, argument});
  const int error = create(thread, attributes, Run, start.get());
  if (error == 0) {
    start.release();  // NOLINT(bugprone-unused-return-value): the thread deletes it
  } else {
    --running;
  }
  return error;
}
