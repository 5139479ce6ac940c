// Which threads the signals that stop a program may interrupt.

#pragma once

#include <csignal>
#include <initializer_list>

namespace craftfleet {

// SIGTERM, SIGINT and SIGHUP.
inline sigset_t StopSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&signals, signal);
  return signals;
}

// For `how` SIG_BLOCK: these signals don't interrupt the calling thread, nor those that it starts.
// SIG_UNBLOCK: they do. Returns the mask from before.
//
// Threads that compute block them: code that oneDNN generates uses the stack pointer for data, and there a signal's
// handler writes over the heap.
inline sigset_t MaskStopSignals(int how) {
  const sigset_t signals = StopSignals();
  sigset_t before;
  pthread_sigmask(how, &signals, &before);
  return before;
}

}  // namespace craftfleet
