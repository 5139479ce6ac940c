// The program of all targets. With CRAFTFLEET_FUZZ libFuzzer calls it for a search:
//   fuzz --target=NAME [flag of libFuzzer]... FOLDER...
// Otherwise it tries the sound inputs of each target, and every file in FOLDER/NAME:
//   fuzz_replay FOLDER...
// or writes the sound inputs to FOLDER/NAME, as seeds of a search:
//   fuzz_replay --write_seeds FOLDER

#include <cstdio>
#include <cstdlib>

#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>

#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

const std::string& FuzzFolder() {
  static const std::string* folder = [] {
    std::string path = PathExists("/dev/shm") ? "/dev/shm/craftfleet-fuzz-XXXXXX" : "/tmp/craftfleet-fuzz-XXXXXX";
    CRAFTFLEET_CHECK(::mkdtemp(path.data()) != nullptr);
    std::atexit([] { RemoveAll(FuzzFolder()).IgnoreError(); });
    return new std::string(path);
  }();
  return *folder;
}

namespace {

// Silences warnings: most of the hundred thousand inputs are invalid.
void LogOnlyErrors() {
  LogOptions options;
  options.level = LogLevel::kError;
  SetUpLog(options);
}

#ifdef CRAFTFLEET_LIBFUZZER

const FuzzTarget* g_target = nullptr;

}  // namespace
}  // namespace craftfleet

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  craftfleet::LogOnlyErrors();
  for (int i = 1; i < *argc; ++i) {
    absl::string_view name = (*argv)[i];
    if (absl::ConsumePrefix(&name, "--target="))
      craftfleet::g_target = craftfleet::FuzzTarget::All().at(std::string(name));
  }
  CRAFTFLEET_CHECK(craftfleet::g_target != nullptr);
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  craftfleet::g_target->try_input({reinterpret_cast<const char*>(data), size});
  return 0;
}

#else

absl::Status WriteSeeds(const std::string& folder) {
  for (const auto& [name, target] : FuzzTarget::All()) {
    const std::string own = JoinPath(folder, name);
    CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(own));
    const std::vector<std::string> inputs = target->sound_inputs();
    for (size_t i = 0; i < inputs.size(); ++i) {
      CRAFTFLEET_RETURN_IF_ERROR(WriteFileSynced(JoinPath(own, absl::StrCat("sound-", i)), inputs[i]));
    }
  }
  return absl::OkStatus();
}

// Returns the number of inputs.
absl::StatusOr<size_t> Replay(const FuzzTarget& target, const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(folder));
  if (names.empty()) return absl::NotFoundError(absl::StrCat("no inputs in ", folder));
  for (const std::string& name : names) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string input, ReadFile(JoinPath(folder, name)));
    target.try_input(input);
  }
  return names.size();
}

// `partial`: a build without the fleet lacks some targets.
absl::Status ReplayAll(const std::vector<std::string>& folders, bool partial) {
  for (const auto& [name, target] : FuzzTarget::All()) {
    const std::vector<std::string> sound = target->sound_inputs();
    for (const std::string& input : sound) target->try_input(input);
    std::printf("%s: %zu sound inputs\n", name.c_str(), sound.size());
  }
  for (const std::string& folder : folders) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(folder));
    for (const std::string& name : names) {
      const auto target = FuzzTarget::All().find(name);
      if (target == FuzzTarget::All().end() && partial) continue;
      if (target == FuzzTarget::All().end()) {
        return absl::NotFoundError(absl::StrCat(folder, "/", name, ": there is no such target"));
      }
      CRAFTFLEET_ASSIGN_OR_RETURN(const size_t inputs, Replay(*target->second, JoinPath(folder, name)));
      std::printf("%s: %zu inputs\n", name.c_str(), inputs);
    }
  }
  return absl::OkStatus();
}

absl::Status Run(std::vector<std::string> arguments) {
  LogOnlyErrors();
  if (arguments.size() == 2 && arguments[0] == "--write_seeds") return WriteSeeds(arguments[1]);
  const bool partial = !arguments.empty() && arguments[0] == "--partial";
  if (partial) arguments.erase(arguments.begin());
  return ReplayAll(arguments, partial);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const absl::Status status = craftfleet::Run({argv + 1, argv + argc});
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}

#endif  // CRAFTFLEET_LIBFUZZER
