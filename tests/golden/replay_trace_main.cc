// replay_trace: replays golden traces and reports the first difference from the recording.

#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>

#include "common/io/paths.h"
#include "common/process/program.h"
#include "tests/golden/trace_replayer.h"

ABSL_FLAG(std::string, textures, "", "folder with the textures' PNG files [the ones that come with the programs]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "replay_trace";
constexpr char kUsage[] =
    R"(replay_trace replays golden traces and compares every field of every line, including the picture's checksum.

  replay_trace [--textures=DIR] FILE...

A file named frames.jsonl lists traces, which are replayed with their pictures, byte for byte. Prints one line per file:
"ok" with the number of steps and frames that agree, or the first difference with the expected and the found value.
Exit code 1 if anything differs or a file can't be read.)";

// Replays a file and prints its line; returns whether everything agrees.
bool ReplayFile(const std::string& path, const std::string& textures) {
  const bool frames = std::filesystem::path(path).filename() == "frames.jsonl";
  const absl::StatusOr<ReplayReport> report = frames ? ReplayFrames(path, textures) : ReplayTrace(path, textures);
  if (!report.ok()) {
    std::fprintf(stderr, "%s: error: %s\n", path.c_str(), absl::StrCat(report.status().message()).c_str());
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

int Run(const std::vector<std::string>& files) {
  const absl::StatusOr<std::string> textures = TextureDir(absl::GetFlag(FLAGS_textures));
  if (!textures.ok()) return ExitCode(kProgram, textures.status());
  if (files.empty()) {
    std::fprintf(stderr, "%s: no files given, want [--textures=DIR] FILE...\n", kProgram);
    return 1;
  }
  bool agree = true;
  for (const std::string& file : files) agree = ReplayFile(file, *textures) && agree;
  return agree ? 0 : 1;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  return craftfleet::Run(craftfleet::ParseFlagsAndArguments({craftfleet::kProgram, craftfleet::kUsage}, argc, argv));
}
