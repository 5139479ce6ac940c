// Which threads the signals that stop a program may interrupt.

#ifndef CRAFTFLEET_COMMON_BASE_STOP_SIGNALS_H_
#define CRAFTFLEET_COMMON_BASE_STOP_SIGNALS_H_

#include <csignal>

namespace craftfleet {

// For `how` SIG_BLOCK: SIGTERM, SIGINT and SIGHUP don't interrupt the calling thread, nor those that it starts.
// SIG_UNBLOCK: they do. Returns the mask from before.
//
// Threads that compute block them: code that oneDNN generates uses the stack pointer for data, and there a signal's
// handler writes over the heap.
inline sigset_t MaskStopSignals(int how) {
  sigset_t signals;
  sigset_t before;
  sigemptyset(&signals);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&signals, signal);
  pthread_sigmask(how, &signals, &before);
  return before;
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_BASE_STOP_SIGNALS_H_
