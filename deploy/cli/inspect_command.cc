// craftfleet inspect: answers questions of the Python commands.

#include <iostream>
#include <string>

#include "common/process/program.h"
#include "deploy/cli/answer.h"
#include "deploy/cli/command.h"

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet inspect";
constexpr char kUsage[] =
    R"(craftfleet inspect answers questions about configurations and run folders. It is what craftfleet report, curve and sweep
ask: each line of standard input is a JSON object, and so is each line of its output.

  echo '{"config": "agent: \"lstm_cnn\""}' | craftfleet inspect)";

int RunInspect(int argc, char** argv) {
  ParseFlags({kProgram, kUsage, {}, {}}, argc, argv);
  for (std::string line; std::getline(std::cin, line);) std::cout << Answer(line) << "\n";
  const absl::Status read = CheckStandardInput();
  std::cout.flush();
  return ExitCode(kProgram, read);
}

const RegisterCommand kRegistered("inspect", &RunInspect);

}  // namespace
}  // namespace craftfleet
