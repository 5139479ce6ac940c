// craftfleet: the light commands, which start in milliseconds. It starts the programs beside it for those that need
// LibTorch or windows, which have this file too, and Python for those in Python.

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <nlohmann/json.hpp>

#include "common/process/closest_name.h"
#include "common/process/program.h"
#include "common/process/version.h"
#include "deploy/cli/command.h"

namespace craftfleet {
namespace {

constexpr char kSummary[] = "trains agents for the game Crafter, in one process or over a fleet";

// What runs a command.
constexpr char kLight[] = "craftfleet";
constexpr char kTorch[] = "craftfleet-torch";
constexpr char kPlay[] = "craftfleet-play";
constexpr char kPython[] = "python3";

struct Command {
  const char* name;
  const char* program;
  const char* summary;
};

constexpr Command kCommands[] = {
    {"train", kTorch, "train in one process"},
    {"eval", kTorch, "score a checkpoint"},
    {"watch", kTorch, "watch an agent play, live or as a video"},
    {"play", kPlay, "play the game yourself, in a window or a terminal"},
    {"policy", kTorch, "choose actions for observations, for Python"},
    {"sweep", kPython, "run experiments: every cell of a table, with several seeds"},
    {"report", kPython, "make the paper's tables and figures from runs"},
    {"curve", kPython, "draw the learning curves of runs"},
    {"agents", kTorch, "list the agents and the parts of their networks"},
    {"envs", kLight, "list the environments and count the objects in their worlds"},
    {"status", kLight, "print the status of a process of the fleet"},
    {"top", kPython, "watch a whole fleet live, and see what limits its speed"},
    {"admin", kLight, "steer a run: checkpoint, pause, resume, drain or undrain a worker, stop"},
    {"doctor", kTorch, "check this machine and suggest what to change"},
};
constexpr const char* kFleet[] = {"learner", "actor", "envserver"};  // craftfleet-learner, ...

constexpr char kMore[] = R"(
craftfleet help COMMAND and craftfleet COMMAND --help explain a command.

The programs of a fleet: craftfleet-learner, craftfleet-actor, craftfleet-envserver.

First steps:
  craftfleet train --steps=100000 --logdir=runs/first
  craftfleet eval --checkpoint=runs/first
)";

std::string Usage() {
  std::string text = absl::StrCat("craftfleet ", kSummary, ".\n\n");
  for (const Command& command : kCommands) {
    absl::StrAppendFormat(&text, "  craftfleet %-9s%s\n", command.name, command.summary);
  }
  return text + kMore;
}

std::string OwnFolder() {
  char path[4096];
  const ssize_t size = readlink("/proc/self/exe", path, sizeof(path));
  const std::string file(path, size > 0 ? static_cast<size_t>(size) : 0);
  return file.substr(0, file.rfind('/') + 1);
}

// The commands in Python; a link to the sources in the build tree.
std::string PythonScript() { return OwnFolder() + "../share/craftfleet/python/craftfleet_analysis/__main__.py"; }

// Whether this build has the command.
bool IsThere(const Command& command) {
  if (command.program == kLight) return Commands().count(command.name) > 0;
  return access((command.program == kPython ? PythonScript() : OwnFolder() + command.program).c_str(), R_OK) == 0;
}

// Like HelpJson of the other programs, with the commands of this build instead of flags.
std::string UsageJson() {
  nlohmann::ordered_json json = {{"program", "craftfleet"}, {"arguments", "COMMAND"}, {"summary", kSummary}};
  for (const Command& command : kCommands) {
    if (!IsThere(command)) continue;
    json["commands"].push_back({{"name", command.name}, {"program", command.program}, {"summary", command.summary}});
  }
  return json.dump(2) + "\n";
}

// Pointers to the words, with a null at the end, as for main.
std::vector<char*> Pointers(std::vector<std::string>* words) {
  std::vector<char*> pointers;
  pointers.reserve(words->size() + 1);
  for (std::string& word : *words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  return pointers;
}

// Replaces this process by `program` with the arguments `words`; returns only if that fails.
absl::Status Become(const std::string& program, std::vector<std::string> words) {
  words.insert(words.begin(), program);  // what ps shows
  execvp(program.c_str(), Pointers(&words).data());
  return absl::NotFoundError(absl::StrCat("cannot run ", program, ": ", std::generic_category().message(errno)));
}

absl::Status BecomePython(std::vector<std::string> words) {
  setenv("CRAFTFLEET_BIN", OwnFolder().c_str(), /*overwrite=*/0);  // where the script finds this program
  const char* const python = std::getenv("CRAFTFLEET_PYTHON");
  words.insert(words.begin(), PythonScript());
  return Become(python != nullptr && *python != '\0' ? python : kPython, std::move(words));
}

absl::Status UnknownCommand(const std::string& name) {
  std::vector<std::string> names = {"help"};
  names.insert(names.end(), std::begin(kFleet), std::end(kFleet));
  for (const Command& known : kCommands) names.emplace_back(known.name);
  return absl::InvalidArgumentError(
      absl::StrCat("there is no command \"", name, "\"", DidYouMean(name, names), "; see craftfleet --help"));
}

// Starts the program of a command; returns only if that fails. `words`: the command and its arguments.
absl::Status StartProgram(std::vector<std::string> words) {
  const std::string name = words[0];
  if (std::find(std::begin(kFleet), std::end(kFleet), name) != std::end(kFleet)) {
    words.erase(words.begin());
    return Become(absl::StrCat(OwnFolder(), "craftfleet-", name), std::move(words));
  }
  const auto* const command = std::find_if(std::begin(kCommands), std::end(kCommands),
                                           [&name](const Command& known) { return known.name == name; });
  if (command == std::end(kCommands)) return UnknownCommand(name);
  if (command->program == kPython) return BecomePython(std::move(words));
  if (command->program != kLight) return Become(OwnFolder() + command->program, std::move(words));
  return absl::UnimplementedError(absl::StrCat("this build has no command ", name));
}

int Print(const std::string& text) {
  std::fputs(text.c_str(), stdout);
  return ExitCode("craftfleet", absl::OkStatus());
}

int Run(std::vector<std::string> words) {
  if (words.empty()) {
    std::fputs(Usage().c_str(), stderr);
    return 1;
  }
  const bool help_for_command = words[0] == "help" && words.size() > 1;
  if (help_for_command) words = {words[1], "--help"};
  const std::string& command = words[0];
  if (command == "help" || command == "--help" || command == "-h" || command == "--helpfull") return Print(Usage());
  if (command == "--help_json") return Print(UsageJson());
  if (command == "--version") return Print(VersionText("craftfleet") + "\n");
  if (absl::StartsWith(command, "-")) {
    return ExitCode("craftfleet",
                    absl::InvalidArgumentError(absl::StrCat("unknown flag \"", command, "\"; see craftfleet --help")));
  }
  if (const auto found = Commands().find(command); found != Commands().end()) {
    return found->second(static_cast<int>(words.size()), Pointers(&words).data());
  }
  return ExitCode("craftfleet", StartProgram(std::move(words)));
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) { return craftfleet::Run({argv + 1, argv + argc}); }
