#include "deploy/cli/command.h"

#include <map>

namespace craftfleet {
namespace {

std::map<absl::string_view, CommandFunction>& Commands() {
  static auto* const commands = new std::map<absl::string_view, CommandFunction>;  // used before main
  return *commands;
}

}  // namespace

RegisterCommand::RegisterCommand(absl::string_view name, CommandFunction run) { Commands()[name] = run; }

CommandFunction FindCommand(absl::string_view name) {
  const auto found = Commands().find(name);
  return found == Commands().end() ? nullptr : found->second;
}

}  // namespace craftfleet
