// Checks of invariants: a failure is a bug in this program, never bad input.

#pragma once

#include <cstdio>
#include <cstdlib>

// Aborts with file, line and the condition when `condition` is false.
#define CRAFTFLEET_CHECK(condition)                                                          \
  do {                                                                                       \
    if (!(condition)) {                                                                      \
      std::fprintf(stderr, "%s:%d: broken invariant: %s\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                          \
    }                                                                                        \
  } while (false)
