// replay_trace [--textures=DIR] FILE...: plays golden traces again and says whether all is as recorded. A file named
// frames.jsonl stands for the traces it names, with their pictures. Exit code: 0 all agree, 1 a difference or an error.

#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/flags/parse.h>
#include <absl/flags/usage.h>
#include <absl/flags/usage_config.h>
#include <absl/status/statusor.h>

#include "common/paths.h"
#include "common/version.h"
#include "tests/golden/trace_replayer.h"

ABSL_FLAG(std::string, textures, "", "folder with the textures' PNG files; default: those that come with the programs");

namespace craftfleet {
namespace {

// Prints the file's line; says whether all agrees.
bool ReplayFile(const std::string& path, const std::string& textures) {
  const bool frames = std::filesystem::path(path).filename() == "frames.jsonl";
  const absl::StatusOr<ReplayReport> report = frames ? ReplayFrames(path, textures) : ReplayTrace(path, textures);
  if (!report.ok()) {
    std::fprintf(stderr, "%s: error: %s\n", path.c_str(), report.status().ToString().c_str());
    return false;
  }
  if (!report->difference.empty()) {
    std::printf("%s: DIFFERS at %s\n", path.c_str(), report->difference.c_str());
    return false;
  }
  std::printf("%s: ok, %lld steps, %lld frames\n", path.c_str(), static_cast<long long>(report->steps),
              static_cast<long long>(report->frames));
  return true;
}

int Run(const std::vector<char*>& files) {
  std::string textures = absl::GetFlag(FLAGS_textures);
  if (textures.empty()) {
    absl::StatusOr<std::string> folder = DefaultTextureDir();
    if (!folder.ok()) {
      std::fprintf(stderr, "replay_trace: %s\n", folder.status().ToString().c_str());
      return 1;
    }
    textures = *std::move(folder);
  }
  if (files.empty()) {
    std::fprintf(stderr, "replay_trace: no files given, want [--textures=DIR] FILE...\n");
    return 1;
  }
  bool agree = true;
  for (const char* file : files) agree = ReplayFile(file, textures) && agree;
  return agree ? 0 : 1;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  absl::SetProgramUsageMessage("replays golden traces and compares every field: replay_trace [--textures=DIR] FILE...");
  absl::FlagsUsageConfig config;
  config.version_string = [] { return craftfleet::VersionText("replay_trace") + "\n"; };
  absl::SetFlagsUsageConfig(config);
  std::vector<char*> files = absl::ParseCommandLine(argc, argv);
  files.erase(files.begin());  // the program
  return craftfleet::Run(files);
}
