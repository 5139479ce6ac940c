// The commands of craftfleet that are part of this program. Each is a file NAME_command.cc, which registers it.

#pragma once

#include <map>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Runs a command with its own arguments from argv[1] on. Returns the exit code.
using CommandFunction = int (*)(int argc, char** argv);

// By name.
inline std::map<absl::string_view, CommandFunction>& Commands() {
  static auto* const commands = new std::map<absl::string_view, CommandFunction>;  // used before main
  return *commands;
}

// Adds a command to the program; for objects outside functions. `name` must outlive it.
struct RegisterCommand {
  RegisterCommand(absl::string_view name, CommandFunction run) { Commands()[name] = run; }
};

}  // namespace craftfleet
