// From costs to a fleet: how many learners, actors and environment servers, at what rate, and what limits it.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLAN_PLANNER_H_
#define CRAFTFLEET_DEPLOY_CLI_PLAN_PLANNER_H_

#include <string>
#include <vector>

#include "craftfleet/v1/config.pb.h"
#include "deploy/cli/plan/costs.h"
#include "learner/bottleneck.h"

namespace craftfleet {

// What there is to run a fleet on. All of it is like the machine of the costs.
struct Machines {
  int cores = 1;         // CPU cores, of all hosts together
  int host_cores = 1;    // of each host; the last one may have fewer
  int gpus = 0;          // for updates, 0..1: several learners compute on CPUs
  double gbit = 0;       // of a host's network link, Gbit/s; 0: as fast as needed
  int max_learners = 1;  // of the run (learner/ranks/README.md)
};

// The processes of a fleet, and what they do a second of a run.
struct FleetPlan {
  int hosts = 1;
  int learners = 1;
  int learner_threads = 1;  // of each learner, for updates
  int actors = 1;           // processes, one for each host that plays
  int actor_threads = 1;    // of all actors together
  int env_servers = 1;      // one beside each actor

  double steps_per_second = 0;
  double update_us = 0;      // elapsed time a step while the learners update
  double play_us = 0;        // elapsed time a step while the actors play and send
  double link_us = 0;        // elapsed time of a step on the learner's link; 0: no limit
  double cores_used = 0;     // in the mean, of all processes; at most Machines::cores
  bool lacks_lanes = false;  // further actors would have nothing to play

  FleetView view;    // what the learner of this fleet would see
  Bottleneck limit;  // FindBottleneck of it, as craftfleet top will show it. Where a plan knows more than a learner
                     // sees, that the link is full or that no lanes are left, the advice says so
};

// The fastest fleet on all of `machines` or fewer, and of equally fast ones that with the fewest learners and threads,
// for a run with `config`, which is complete (ResolveRunConfig), and frames that travel in `format`. `costs` have those
// of a GPU if `machines` has one.
//
// With S steps a second, T = 1/S, the model is
//   one after the other (neither overlap nor max_staleness)   T = update + play
//   play during updates                                       T = max(update, play, work of a step / cores)
// where `update` is the time of epochs * update_us, shortened by threads and learners as far as gradient_shards allow,
// and lengthened by the gradients and frames that learners send each other; and `play` the longest of these: the work
// of actors and environment servers, divided among the actors' threads; the bytes on the learner's link; and the work
// of all workers and of the learner's intake, divided among the cores.
FleetPlan PlanFleet(const Costs& costs, const v1::RunConfig& config, FrameFormat format, const Machines& machines);

// The elapsed time of one epoch's sample where `parallel` threads, of all learners together, compute `shards` parts.
// The part of the work that threads do not shorten follows from costs.two_thread_us; without it all of it is shared
// out.
double UpdateMicros(const Costs& costs, int shards, int parallel);

// A change that makes a planned fleet faster.
struct Remedy {
  std::string change;  // "twice the cores", "--overlap=1"
  double steps_per_second = 0;
};

// What would make the fleet of PlanFleet with these arguments at least 5% faster, by the rate.
std::vector<Remedy> FindRemedies(const Costs& costs, const v1::RunConfig& config, FrameFormat format,
                                 const Machines& machines);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLAN_PLANNER_H_
