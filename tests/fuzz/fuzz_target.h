// The interface of a fuzz target.

#pragma once

#include <map>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Makes a target known to the program. For objects outside functions.
struct FuzzTarget {
  // Passes the untrusted `input` to the code under test, and aborts (CRAFTFLEET_CHECK) if an invariant is broken.
  using Try = void (*)(absl::string_view input);
  // Valid inputs, and some that are nearly valid, to start from.
  using Inputs = std::vector<std::string> (*)();

  FuzzTarget(const std::string& name, Try try_input, Inputs sound_inputs)
      : try_input(try_input), sound_inputs(sound_inputs) {
    All().emplace(name, this);
  }
  FuzzTarget(const FuzzTarget&) = delete;
  FuzzTarget& operator=(const FuzzTarget&) = delete;

  // By name.
  static std::map<std::string, const FuzzTarget*>& All() {
    static auto* const all = new std::map<std::string, const FuzzTarget*>;  // used before main
    return *all;
  }

  const Try try_input;
  const Inputs sound_inputs;
};

// A folder of this process for the files of targets, in memory if possible; removed when it exits.
const std::string& FuzzFolder();

}  // namespace craftfleet
