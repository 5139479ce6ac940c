// Runs that version 0.1 wrote (tests/data/v0.1) can be resumed.
//
// Episode logs are compared to the byte on every machine. Other CPUs add numbers in another order, so their weights
// differ in the last bits. That changes an action only if a random number falls into such a difference, in about one of
// a million steps; these runs have some hundred. Weights are compared to the byte on the CPU that made them, and within
// a tolerance elsewhere.

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/base/little_endian.h"
#include "tests/fakes/test_paths.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr char kLast[] = "checkpoints/iter-00000006/";

std::string ReadText(const std::string& path) { return ReadFile(path).value_or("none of " + path); }

std::vector<std::string> Lines(const std::string& path) {
  return absl::StrSplit(ReadText(path), '\n', absl::SkipEmpty());
}

// As in make.py: the CPU features that determine the code paths of BLAS and LibTorch.
std::string OwnCpu() {
  std::map<std::string, std::string> fields;
  for (const std::string& line : Lines("/proc/cpuinfo")) {
    const std::vector<std::string> parts = absl::StrSplit(line, absl::MaxSplits(": ", 1));
    if (parts.size() == 2) fields[std::string(absl::StripTrailingAsciiWhitespace(parts[0]))] = parts[1];
  }
  std::string cpu = absl::StrCat(fields["vendor_id"], " ", fields["cpu family"], " ", fields["model"]);
  const std::string flags = absl::StrCat(" ", fields["flags"], " ");
  for (const char* flag : {"avx2", "fma", "avx512f", "avx512bw", "avx512_vnni", "avx512_bf16"}) {
    if (absl::StrContains(flags, absl::StrCat(" ", flag, " "))) absl::StrAppend(&cpu, " ", flag);
  }
  return cpu;
}

// For each tensor of a safetensors file of floats: the number of values, their sum, and the sum of their squares.
struct Sums {
  int64_t count = 0;
  double sum = 0;
  double squares = 0;
};
std::map<std::string, Sums> TensorSums(const std::string& path) {
  const std::string bytes = ReadText(path);
  const auto head_size = FromLittleEndian<uint64_t>(absl::string_view(bytes).substr(0, 8));
  const auto head = nlohmann::json::parse(bytes.substr(8, head_size));
  std::map<std::string, Sums> all;
  for (const auto& [name, tensor] : head.items()) {
    if (name == "__metadata__") continue;
    Sums& sums = all[name];
    const std::vector<size_t> offsets = tensor["data_offsets"];
    for (size_t at = offsets[0]; at < offsets[1]; at += sizeof(float), ++sums.count) {
      float number = 0;
      std::memcpy(&number, &bytes[8 + head_size + at], sizeof(number));
      sums.sum += number;
      sums.squares += double{number} * number;
    }
  }
  return all;
}

class OldRunsTest : public SmallRunTest, public testing::WithParamInterface<const char*> {
 protected:
  OldRunsTest() { std::filesystem::copy(data_ + "/run", Logdir("run"), std::filesystem::copy_options::recursive); }

  void ExpectLogs() {
    for (const char* log :
         {"stats.jsonl", "eval_argmax.jsonl", "eval_sampled.jsonl", "final_argmax.jsonl", "final_sampled.jsonl"}) {
      EXPECT_EQ(ReadText(JoinPath(Logdir("run"), log)), ReadText(JoinPath(data_, log))) << log;
    }
  }
  void ExpectWeights() {
    const auto actual = TensorSums(JoinPath(Logdir("run"), absl::StrCat(kLast, "weights.safetensors")));
    const std::vector<std::string> lines = Lines(data_ + "/weights.txt");
    EXPECT_EQ(actual.size(), lines.size());
    for (const std::string& line : lines) {
      const std::vector<std::string> words = absl::StrSplit(line, ' ');
      ASSERT_EQ(words.size(), 4U);
      const auto found = actual.find(words[0]);
      ASSERT_NE(found, actual.end()) << line;
      double sum = 0;
      double squares = 0;
      ASSERT_TRUE(absl::SimpleAtod(words[2], &sum) && absl::SimpleAtod(words[3], &squares));
      EXPECT_EQ(absl::StrCat(found->second.count), words[1]) << line;
      // The first Adam steps move a weight by the learning rate in the direction of its gradient, however small that
      // is. A thousandth of the weights may move in the other direction.
      EXPECT_NEAR(found->second.sum, sum, 1e-3 + 1e-6 * static_cast<double>(found->second.count)) << line;
      EXPECT_NEAR(found->second.squares, squares, 1e-3 * squares + 1e-6) << line;
    }
    const std::vector<std::string> manifest = Lines(data_ + "/manifest.txt");
    ASSERT_EQ(manifest.size(), 3U);
    if (manifest[0] != OwnCpu()) return;
    const std::string own = ReadText(JoinPath(Logdir("run"), absl::StrCat(kLast, "MANIFEST")));
    EXPECT_THAT(own, HasSubstr(manifest[1] + "\n"));
    EXPECT_THAT(own, HasSubstr(manifest[2] + "\n"));
  }

  const std::string data_ = SourcePath(absl::StrCat("tests/data/v0.1/", GetParam()));
};

TEST_P(OldRunsTest, ResumesInOneProcess) {
  const Ended ended = Run("craftfleet-train", {"--resume", "--logdir=" + Logdir("run")});
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("2 fragments of iteration"));
  ExpectLogs();
  ExpectWeights();
}

TEST_P(OldRunsTest, ResumesInAFleet) {
  const auto learner = Start("craftfleet-learner", {"--resume", "--listen=127.0.0.1:0", "--logdir=" + Logdir("run")});
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
  const auto actor = Start("craftfleet-actor", {"--learner=" + learner->WaitForAddress().value(),
                                                "--envservers=" + server->WaitForAddress().value()});
  const Ended ended = Finish(learner.get());
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  ExpectLogs();
  ExpectWeights();
}

TEST_P(OldRunsTest, IsEvaluated) {
  const std::string json = folder_ / "eval.json";
  const Ended ended = Run("craftfleet-eval", {"--checkpoint=" + Logdir("run"), "--episodes=3", "--json=" + json});
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  // The output must contain that of version 0.1; later versions may print more.
  const auto actual = nlohmann::json::parse(ReadText(json));
  const auto wanted = nlohmann::json::parse(ReadText(data_ + "/eval.json"));
  for (const auto& [key, value] : wanted.items()) EXPECT_EQ(actual.value(key, nlohmann::json()), value) << key;
}

TEST_P(OldRunsTest, IsReported) {
  const Ended ended = Run("craftfleet-report", {Logdir("run"), "--out=" + folder_ / "report"});
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ReadText(folder_ / "report/report.md"), HasSubstr(Logdir("run")));
}

INSTANTIATE_TEST_SUITE_P(Agents, OldRunsTest, testing::Values("ppo_cnn", "lstm_cnn"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace craftfleet
