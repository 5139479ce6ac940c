#include "deploy/cli/status_text.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include <absl/strings/ascii.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/printable.h"

namespace craftfleet {
namespace {

void AddLine(absl::string_view line, std::string* text) { absl::StrAppend(text, Printable(line), "\n"); }

void AddField(absl::string_view name, absl::string_view value, std::string* text) {
  AddLine(absl::StrFormat("%-24s %s", name, value), text);
}

// "12288", "0.25".
std::string NumberText(double value) {
  const bool is_whole = std::abs(value) < 0x1p53 && value == std::trunc(value);
  return is_whole ? absl::StrCat(static_cast<int64_t>(value)) : absl::StrFormat("%.10g", value);
}

void AddTimes(const google::protobuf::RepeatedPtrField<v1::ActivityTime>& times, std::string* text) {
  for (const v1::ActivityTime& time : times) {
    std::string line = absl::StrFormat("  %-22s %5.1f %%", time.activity(), 100 * time.share());
    if (time.seconds() > 0) absl::StrAppendFormat(&line, " %12.1f s since the start", time.seconds());
    AddLine(line, text);
  }
}

const char* StateOf(const v1::Peer& peer) {
  if (peer.health() == v1::Peer::LOST) return "LOST";
  if (peer.health() == v1::Peer::NOT_ANSWERING) return "NOT ANSWERING";
  if (peer.health() == v1::Peer::SLOW) return "SLOW";
  if (peer.health() == v1::Peer::LEFT) return "left";
  if (peer.drain() == v1::Peer::DRAINING) return "draining";
  return peer.drain() == v1::Peer::DRAINED ? "drained" : "";
}

void AddPeers(const v1::StatusReply& reply, std::string* text) {
  if (reply.peers_size() > 0) AddLine("peers", text);
  for (const v1::Peer& peer : reply.peers()) {
    std::string line = absl::StrFormat("  %-10s %-28s %-22s %-4s %s", peer.role(), peer.name(), peer.address(),
                                       StateOf(peer), peer.state());
    if (peer.has_summary()) {
      absl::StrAppendFormat(&line, "  %.0f steps/s, %d lanes, %.0f MiB", peer.summary().steps_per_second(),
                            peer.summary().lanes(), static_cast<double>(peer.summary().memory_bytes()) / (1 << 20));
    }
    AddLine(line, text);
  }
  int workers = 0;
  for (const v1::WorkerCount& count : reply.fleet().workers()) workers += count.number();
  if (workers > reply.peers_size()) {
    AddLine(absl::StrFormat("  and %d more workers", workers - reply.peers_size()), text);
  }
  const bool any_drained = std::any_of(reply.peers().begin(), reply.peers().end(), [](const v1::Peer& peer) {
    return peer.drain() != v1::Peer::NO_DRAIN && peer.health() == v1::Peer::OK;
  });
  if (any_drained) AddLine("  craftfleet admin undrain NAME gives a drained worker work again", text);
}

}  // namespace

std::string StatusText(const v1::StatusReply& reply) {
  std::string text;
  AddField("role", reply.role(), &text);
  AddField("name", reply.name(), &text);
  AddField("version", reply.version(), &text);
  AddField("run", reply.run_id().empty() ? "-" : reply.run_id(), &text);
  if (const auto state = reply.fleet().run_state(); state > 0 && v1::FleetSummary::RunState_IsValid(state)) {
    AddField("state", absl::AsciiStrToLower(v1::FleetSummary::RunState_Name(state)), &text);
  }
  if (!reply.metrics_address().empty()) AddField("metrics", reply.metrics_address(), &text);
  for (const v1::Metric& metric : reply.metrics()) {
    AddField(metric.name(), absl::StrCat(NumberText(metric.value()), " ", metric.unit()), &text);
  }
  if (!reply.summary().gpu().empty()) AddField("gpu", reply.summary().gpu(), &text);
  if (!reply.summary().last_error().empty()) AddField("last error", reply.summary().last_error(), &text);
  if (reply.summary().threads() > 0) AddLine(absl::StrFormat("time of %d threads", reply.summary().threads()), &text);
  AddTimes(reply.summary().times(), &text);
  if (reply.has_fleet()) {
    AddLine("time of the fleet", &text);
    AddTimes(reply.fleet().times(), &text);
    AddField("bottleneck", absl::StrCat(reply.fleet().bottleneck(), ": ", reply.fleet().advice()), &text);
  }
  AddPeers(reply, &text);
  return text;
}

}  // namespace craftfleet
