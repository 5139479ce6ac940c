// The result of `craftfleet eval`, as text and as JSON.

#ifndef CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_RESULT_H_
#define CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_RESULT_H_

#include <string>

#include <nlohmann/json_fwd.hpp>

#include "learner/run/score.h"

namespace craftfleet {

// As text: a line for each achievement, then reward, length and score.
std::string DescribeResult(const ScoreBoard& board);

// As JSON: adds "episodes", "reward", "length", "score" and "success_percentages" to `json`.
void AddResult(const ScoreBoard& board, nlohmann::ordered_json* json);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_RESULT_H_
