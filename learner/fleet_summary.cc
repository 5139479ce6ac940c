#include "learner/fleet_summary.h"

#include "common/wire/status_service.h"

namespace craftfleet {

FleetView ViewFleet(const Work& trainer, const v1::StatusReply& reply) {
  FleetView view;
  view.learner = trainer.times;
  view.early = trainer.times[Activity::kUpdate] == 0;  // times cover at least one whole iteration
  for (const v1::Peer& peer : reply.peers()) {
    const bool ok = peer.health() == v1::Peer::OK;
    const bool drained = peer.drain() == v1::Peer::DRAINED;
    if (peer.role() == "envserver") {
      view.env_servers += ok ? 1 : 0;
      view.drained_env_servers += ok && drained ? 1 : 0;
      view.lost_env_servers += peer.health() == v1::Peer::LOST || peer.health() == v1::Peer::NOT_ANSWERING ? 1 : 0;
    } else if (ok) {
      ++view.actors;
      view.drained_actors += drained ? 1 : 0;
      view.steps_per_second += peer.summary().steps_per_second();
      view.actors_times.Add(wire::TimesOf(peer.summary()));
    }
  }
  return view;
}

namespace {

v1::FleetSummary::RunState RunStateOf(const FleetView& view) {
  if (view.finished) return v1::FleetSummary::COMPLETE;
  if (view.evaluating) return v1::FleetSummary::EVALUATING;
  return view.paused ? v1::FleetSummary::PAUSED : v1::FleetSummary::TRAINING;
}

}  // namespace

v1::FleetSummary SummarizeFleet(const FleetView& view) {
  v1::FleetSummary summary;
  wire::AddShares(FleetTimes(view), summary.mutable_times());
  const Bottleneck bottleneck = FindBottleneck(view);
  summary.set_bottleneck(bottleneck.part);
  summary.set_advice(bottleneck.advice);
  summary.set_run_state(RunStateOf(view));
  return summary;
}

}  // namespace craftfleet
