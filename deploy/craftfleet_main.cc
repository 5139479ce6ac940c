// craftfleet: runs craftfleet-COMMAND, which lies beside it. Links nothing, so that light commands start in
// milliseconds.

#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "common/version.h"

namespace {

constexpr char kUsage[] =
    R"(craftfleet trains agents for the game Crafter, in one process or over a fleet.

  craftfleet train    train in one process
  craftfleet eval     score a checkpoint
  craftfleet sweep    run experiments: every cell of a table, with several seeds
  craftfleet report   make the paper's tables and figures from runs
  craftfleet curve    draw the learning curves of runs
  craftfleet agents   list the agents and what their networks are made of
  craftfleet envs     list the environments and what their worlds have
  craftfleet status   ask a process of the fleet what it is doing
  craftfleet top      watch a whole fleet live, and what holds it back
  craftfleet admin    steer a run: checkpoint, pause, resume, drain a worker, stop
  craftfleet COMMAND --help tells more about each.

The programs of a fleet: craftfleet-learner, craftfleet-actor, craftfleet-envserver.

First steps:
  craftfleet train --steps=100000 --logdir=runs/first
  craftfleet eval --checkpoint=runs/first
)";

std::string OwnFolder() {
  char path[4096];
  const ssize_t size = readlink("/proc/self/exe", path, sizeof(path));
  const std::string file(path, size > 0 ? static_cast<size_t>(size) : 0);
  return file.substr(0, file.rfind('/') + 1);
}

}  // namespace

int main(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "";
  if (command == "--help" || command == "-h" || command == "help") {
    std::fputs(kUsage, stdout);
    return 0;
  }
  if (command == "--version") {
    std::puts(craftfleet::VersionText("craftfleet").c_str());
    return 0;
  }
  if (command.empty() || command[0] == '-' || command.find('/') != std::string::npos) {
    std::fputs(kUsage, stderr);
    return 1;
  }
  const std::string program = OwnFolder() + "craftfleet-" + command;
  std::vector<char*> arguments(argv + 1, argv + argc);
  arguments.push_back(nullptr);
  execv(program.c_str(), arguments.data());
  std::fprintf(stderr, "craftfleet: there is no command \"%s\" (%s: %s); see craftfleet --help\n", command.c_str(),
               program.c_str(), std::strerror(errno));
  return 1;
}
