// craftfleet: runs craftfleet-COMMAND from its own folder. It links no large library, so that light commands start in
// milliseconds.

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "common/process/closest_name.h"
#include "common/process/version.h"

namespace {

struct Command {
  const char* name;
  const char* summary;
};

constexpr char kSummary[] = "trains agents for the game Crafter, in one process or over a fleet";

constexpr Command kCommands[] = {
    {"train", "train in one process"},
    {"eval", "score a checkpoint"},
    {"watch", "watch an agent play, live or as a video"},
    {"play", "play the game yourself, in a window or a terminal"},
    {"policy", "choose actions for observations, for Python"},
    {"sweep", "run experiments: every cell of a table, with several seeds"},
    {"report", "make the paper's tables and figures from runs"},
    {"curve", "draw the learning curves of runs"},
    {"agents", "list the agents and the parts of their networks"},
    {"envs", "list the environments and count the objects in their worlds"},
    {"status", "print the status of a process of the fleet"},
    {"top", "watch a whole fleet live, and see what limits its speed"},
    {"admin", "steer a run: checkpoint, pause, resume, drain or undrain a worker, stop"},
    {"doctor", "check this machine and suggest what to change"},
};

constexpr char kMore[] = R"(
craftfleet help COMMAND and craftfleet COMMAND --help explain a command.

The programs of a fleet: craftfleet-learner, craftfleet-actor, craftfleet-envserver.

First steps:
  craftfleet train --steps=100000 --logdir=runs/first
  craftfleet eval --checkpoint=runs/first
)";

std::string Usage() {
  std::string text = std::string("craftfleet ") + kSummary + ".\n\n";
  for (const Command& command : kCommands) {
    std::string name = command.name;
    name.resize(9, ' ');
    text += "  craftfleet " + name + command.summary + "\n";
  }
  return text + kMore;
}

// Like HelpJson of the other programs, with commands instead of flags. None of the texts needs escapes.
std::string UsageJson() {
  std::string commands;
  for (const Command& command : kCommands) {
    commands += commands.empty() ? "\n" : ",\n";
    commands += std::string("    {\"name\": \"") + command.name + "\", \"summary\": \"" + command.summary + "\"}";
  }
  return std::string("{\n  \"program\": \"craftfleet\",\n  \"arguments\": \"COMMAND\",\n  \"summary\": \"") + kSummary +
         "\",\n  \"commands\": [" + commands + "\n  ]\n}\n";
}

// Returns the exit code: 1 if standard output can't be written.
int Print(const std::string& text) {
  std::fputs(text.c_str(), stdout);
  if (std::fflush(stdout) == 0) return 0;
  std::fprintf(stderr, "craftfleet: cannot write standard output: %s\n", std::strerror(errno));
  return 1;
}

std::string OwnFolder() {
  char path[4096];
  const ssize_t size = readlink("/proc/self/exe", path, sizeof(path));
  const std::string file(path, size > 0 ? static_cast<size_t>(size) : 0);
  return file.substr(0, file.rfind('/') + 1);
}

// Replaces this process by craftfleet-COMMAND with `arguments`. Returns the exit code if that fails.
int RunCommand(const std::string& command, std::vector<std::string> arguments) {
  const bool is_path = command.find('/') != std::string::npos;
  const std::string program = OwnFolder() + "craftfleet-" + command;
  arguments.insert(arguments.begin(), program);  // what ps shows
  std::vector<char*> pointers;
  pointers.reserve(arguments.size() + 1);
  for (std::string& argument : arguments) pointers.push_back(argument.data());
  pointers.push_back(nullptr);
  if (!is_path) execv(program.c_str(), pointers.data());
  const int error = errno;
  std::vector<std::string> names = {"help", "learner", "actor", "envserver"};
  for (const Command& known : kCommands) names.emplace_back(known.name);
  const std::string closest = craftfleet::ClosestName(command, names);
  const std::string suggestion = closest.empty() ? "" : " (did you mean \"" + closest + "\"?)";
  const bool is_known = std::find(names.begin(), names.end(), command) != names.end();
  if ((error == ENOENT && !is_known) || is_path) {
    std::fprintf(stderr, "craftfleet: there is no command \"%s\"%s; see craftfleet --help\n", command.c_str(),
                 suggestion.c_str());
  } else {
    std::fprintf(stderr, "craftfleet: cannot run %s: %s\n", program.c_str(), std::strerror(error));
  }
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  const std::string command = words.empty() ? "" : words[0];
  const bool help = command == "help" || command == "--help" || command == "-h" || command == "--helpfull";
  const bool help_for_command = command == "help" && words.size() > 1;
  if (help && !help_for_command) return Print(Usage());
  if (command == "--help_json") return Print(UsageJson());
  if (command == "--version") return Print(craftfleet::VersionText("craftfleet") + "\n");
  const std::string& wanted = help_for_command ? words[1] : command;
  if (wanted.empty()) {
    std::fputs(Usage().c_str(), stderr);
    return 1;
  }
  if (wanted[0] == '-') {
    std::fprintf(stderr, "craftfleet: unknown flag \"%s\"; see craftfleet --help\n", wanted.c_str());
    return 1;
  }
  if (help_for_command) return RunCommand(wanted, {"--help"});
  return RunCommand(wanted, {words.begin() + 1, words.end()});
}
