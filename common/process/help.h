// The output of --help, --helpfull and --help_json, generated from the program's flags.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include <absl/flags/reflection.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// A program, or a command of one, in its help. The strings behind the views must outlive it.
struct ProgramHelp {
  absl::string_view name;   // "craftfleet train"
  absl::string_view usage;  // begins with a sentence "<name> [ARGUMENTS] <does something>."; then details and examples
  // The most important flags, in the order in which --help shows them. Empty: the program's own flags, by name, without
  // those that programs share (files named *_flags.cc, and program.cc).
  std::vector<absl::string_view> main_flags = {};
  // Its other flags, by name or by the file that declares them ("channel_flags.cc"), apart from those of every program
  // (program.cc). {""}: all flags of the process.
  std::vector<absl::string_view> more_flags = {""};
  // Names of flags that it explains in its own words, and these words.
  std::vector<std::pair<absl::string_view, absl::string_view>> texts = {};
};

// Whether the program has this flag of its process.
bool HasFlag(const ProgramHelp& program, const absl::CommandLineFlag& flag);

// For --help: the usage, and one line for each main flag.
std::string ShortHelp(const ProgramHelp& program);

// For --helpfull: the usage, and every flag with its whole help text, main flags first.
std::string FullHelp(const ProgramHelp& program);

// For --help_json. craftfleet top, a Python program, takes from it the flags that it shares with craftfleet status. A
// JSON object:
//   program, usage: texts.
//   flags: main flags first, each with name (without dashes), type (bool, integer, number, duration, list or string),
//   default (empty if there is none or the help text names it), help, and group (main or other).
std::string HelpJson(const ProgramHelp& program);

}  // namespace craftfleet
