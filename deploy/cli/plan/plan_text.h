// What craftfleet plan prints: text for people, which says where the numbers come from, and JSON for programs.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLAN_PLAN_TEXT_H_
#define CRAFTFLEET_DEPLOY_CLI_PLAN_PLAN_TEXT_H_

#include <string>

#include "craftfleet/v1/config.pb.h"
#include "deploy/cli/plan/costs.h"
#include "deploy/cli/plan/planner.h"

namespace craftfleet {

// What a plan is made for.
struct PlanRequest {
  Costs costs;
  v1::RunConfig config;                      // complete (ResolveRunConfig)
  FrameFormat frames = FrameFormat::kScene;  // how they travel
  Machines machines;
  std::string config_file;  // of the run, for the commands; empty: none
};

std::string PlanText(const PlanRequest& request);
std::string PlanJson(const PlanRequest& request);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLAN_PLAN_TEXT_H_
