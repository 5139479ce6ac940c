#include "learner/fleet_summary.h"

#include "common/wire/status_service.h"

namespace craftfleet {

FleetView ViewFleet(const Work& trainer, const v1::StatusReply& reply) {
  FleetView view;
  view.learner = trainer.times;
  for (const v1::Peer& peer : reply.peers()) {
    const bool ok = peer.health() == v1::Peer::OK;
    if (peer.role() == "envserver") {
      view.env_servers += ok ? 1 : 0;
      view.lost_env_servers += peer.health() == v1::Peer::LOST || peer.health() == v1::Peer::NOT_ANSWERING ? 1 : 0;
    } else if (ok) {
      ++view.actors;
      view.steps_per_second += peer.summary().steps_per_second();
      view.actors_times.Add(wire::TimesOf(peer.summary()));
    }
  }
  return view;
}

v1::FleetSummary SummarizeFleet(const FleetView& view) {
  v1::FleetSummary summary;
  wire::AddShares(FleetTimes(view), summary.mutable_times());
  const Bottleneck bottleneck = FindBottleneck(view);
  summary.set_bottleneck(bottleneck.part);
  summary.set_advice(bottleneck.advice);
  return summary;
}

}  // namespace craftfleet
