#include "deploy/cli/report/run_record.h"

#include <algorithm>
#include <filesystem>
#include <set>
#include <system_error>
#include <utility>

#include <absl/strings/str_cat.h>
#include <nlohmann/json.hpp>

#include "common/base/numbers.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "deploy/cli/sweep/run_identity.h"
#include "deploy/cli/sweep/run_state.h"
#include "learner/run/stats_log.h"
#include "learner/training/steps_to_train.h"

namespace craftfleet {
namespace {

// The path of `name` in `folder`, plain or gzipped; "" if there is neither.
std::string FindLog(const std::string& folder, const std::string& name) {
  for (const std::string& file : {name, name + ".gz"}) {
    if (std::string path = JoinPath(folder, file); PathExists(path)) return path;
  }
  return "";
}

absl::StatusOr<Performance> ReadPerformance(const std::string& folder, const std::string& name) {
  const std::string path = FindLog(folder, name);
  if (path.empty()) return Performance{};
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Episode> episodes, ReadStats(path));
  return PerformanceOf(episodes);
}

// The last step of the iteration in which the finished episodes reached that many steps.
int64_t StepsOfFinishedIterations(int64_t episode_steps, const v1::RunConfig& config) {
  const int64_t rollout = config.ppo().rollout_steps();
  return (episode_steps + rollout - 1) / rollout * rollout;
}

absl::Status ReadProgress(RunRecord* run) {
  const int64_t wanted = run->config.steps();
  CRAFTFLEET_ASSIGN_OR_RETURN(const RunState state, ReadRunState(run->folder, wanted));
  if (state.begun) {
    run->steps = state.steps;
    run->complete = state.finished;
    return absl::OkStatus();
  }
  const int64_t episode_steps = run->curve.empty() ? 0 : run->curve.back().steps;
  run->steps = StepsOfFinishedIterations(episode_steps, run->config);
  const int64_t final_episodes = run->config.eval().final_episodes();
  const bool evaluated = final_episodes > 0 && run->final_argmax.episodes >= final_episodes &&
                         run->final_sampled.episodes >= final_episodes;
  run->complete = evaluated || run->steps >= wanted;
  if (evaluated) run->steps = std::max(run->steps, StepsToTrain(run->config));
  return absl::OkStatus();
}

absl::StatusOr<std::string> ReadTextureDigest(const std::string& folder) {
  const std::string path = JoinPath(folder, "run.json");
  if (!PathExists(path)) return "";
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  const nlohmann::json run = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!run.is_object() || !run.contains("texture_digest") || !run["texture_digest"].is_string()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": no \"texture_digest\", want the digest of the textures"));
  }
  return run["texture_digest"].get<std::string>();
}

bool IsRun(const std::string& folder) {
  return PathExists(JoinPath(folder, "config.txt")) && !FindLog(folder, "stats.jsonl").empty();
}

// Adds the runs in and below `folder`, and the errors of folders that cannot be listed. Links to folders are not
// entered.
void AddRunFolders(const std::string& folder, std::set<std::string>* found, std::vector<absl::Status>* unreadable) {
  if (IsRun(folder)) found->insert(folder);
  const absl::StatusOr<std::vector<std::string>> names = ListFolder(folder);
  if (!names.ok()) {
    unreadable->push_back(names.status());
    return;
  }
  for (const std::string& name : *names) {
    const std::string path = JoinPath(folder, name);
    std::error_code ignored;
    if (std::filesystem::is_directory(std::filesystem::symlink_status(path, ignored))) {
      AddRunFolders(path, found, unreadable);
    } else if (std::filesystem::is_directory(path, ignored) && IsRun(path)) {
      found->insert(path);
    }
  }
}

}  // namespace

Performance PerformanceOf(absl::Span<const Episode> episodes) {
  ScoreBoard board;
  for (const Episode& episode : episodes) board.Add(episode);
  return {board.episodes(),     board.Score(),    board.MeanReward(),
          board.RecentReward(), board.Unlocked(), board.SuccessPercentages()};
}

absl::StatusOr<RunRecord> ReadRun(const std::string& folder) {
  RunRecord run;
  run.folder = folder;
  const std::string path = JoinPath(folder, "config.txt");
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  CRAFTFLEET_ASSIGN_OR_RETURN(run.config, ParseRunConfig(text, path));
  absl::StatusOr<v1::RunConfig> config = ResolveRunConfig(run.config);
  if (!config.ok()) return absl::InvalidArgumentError(absl::StrCat(path, ": ", config.status().message()));
  run.config = *std::move(config);
  CRAFTFLEET_ASSIGN_OR_RETURN(run.texture_digest, ReadTextureDigest(folder));
  run.identity = RunIdentity(run.config, run.texture_digest);
  const std::string stats = FindLog(folder, "stats.jsonl");
  if (stats.empty()) return absl::NotFoundError(absl::StrCat(folder, ": not a run folder: it has no stats.jsonl"));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Episode> episodes, ReadStats(stats));
  run.training = PerformanceOf(episodes);
  run.curve = CurveOfEpisodes(episodes);
  CRAFTFLEET_ASSIGN_OR_RETURN(run.eval_argmax, ReadPerformance(folder, "eval_argmax.jsonl"));
  CRAFTFLEET_ASSIGN_OR_RETURN(run.eval_sampled, ReadPerformance(folder, "eval_sampled.jsonl"));
  CRAFTFLEET_ASSIGN_OR_RETURN(run.final_argmax, ReadPerformance(folder, "final_argmax.jsonl"));
  CRAFTFLEET_ASSIGN_OR_RETURN(run.final_sampled, ReadPerformance(folder, "final_sampled.jsonl"));
  CRAFTFLEET_RETURN_IF_ERROR(ReadProgress(&run));
  return run;
}

std::string StepsText(const RunRecord& run) {
  return absl::StrCat(WithCommas(run.steps), " of ", WithCommas(StepsToTrain(run.config)));
}

absl::StatusOr<FoundRuns> FindRuns(absl::Span<const std::string> folders) {
  std::set<std::string> run_folders;
  FoundRuns found;
  for (const std::string& folder : folders) {
    std::error_code ignored;
    if (!std::filesystem::is_directory(folder, ignored)) {
      return absl::NotFoundError(absl::StrCat(folder, ": no such folder"));
    }
    AddRunFolders(folder, &run_folders, &found.unreadable);
  }
  for (const std::string& folder : run_folders) {
    absl::StatusOr<RunRecord> run = ReadRun(folder);
    if (run.ok()) {
      found.runs.push_back(*std::move(run));
    } else {
      found.unreadable.push_back(run.status());
    }
  }
  return found;
}

}  // namespace craftfleet
