// craftfleet inspect: answers questions of the Python commands.

#include <iostream>
#include <string>

#include "common/process/program.h"
#include "deploy/cli/inspect/answer.h"

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet inspect";
constexpr char kUsage[] =
    R"(craftfleet inspect answers questions about configurations and run folders. It is what craftfleet report, curve and sweep
ask: each line of standard input is a JSON object, and so is each line of its output.

  echo '{"config": "agent: \"lstm_cnn\""}' | craftfleet inspect)";

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  for (std::string line; std::getline(std::cin, line);) std::cout << craftfleet::Answer(line) << "\n";
  std::cout.flush();
  return craftfleet::ExitCode(craftfleet::kProgram, absl::OkStatus());
}
