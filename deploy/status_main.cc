// craftfleet status: what a process of the fleet is doing.

#include <cstdio>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/time.h>
#include <google/protobuf/util/json_util.h>

#include "common/program.h"
#include "common/status_macros.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "deploy/status_client.h"

ABSL_FLAG(std::string, address, "127.0.0.1:50051", "address of a learner, actor or environment server, HOST:PORT");
ABSL_FLAG(bool, json, false, "print JSON");
ABSL_FLAG(bool, watch, false, "print it again and again, until stopped");
ABSL_FLAG(absl::Duration, interval, absl::Seconds(1), "with --watch: between two, 100ms to 1m");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet status";
constexpr char kUsage[] =
    R"(craftfleet status asks any process of the fleet what it is doing: role, version, run, uptime, rates, counts, peers.

  craftfleet status --address=127.0.0.1:50051
  craftfleet status --address=127.0.0.1:50051 --json
  craftfleet status --address=127.0.0.1:50051 --watch --interval=5s
A learner's status has the whole fleet; craftfleet top shows it as a live page.)";

void PrintTimes(const google::protobuf::RepeatedPtrField<v1::ActivityTime>& times) {
  for (const v1::ActivityTime& time : times) {
    absl::PrintF("  %-22s %5.1f %%", time.activity(), 100 * time.share());
    if (time.seconds() > 0) absl::PrintF(" %12.1f s since the start", time.seconds());
    absl::PrintF("\n");
  }
}

const char* StateOf(const v1::Peer& peer) {
  if (peer.health() == v1::Peer::LOST) return "LOST";
  return peer.health() == v1::Peer::LEFT ? "left" : "";
}

void PrintPeers(const v1::StatusReply& reply) {
  if (reply.peers_size() > 0) absl::PrintF("peers\n");
  for (const v1::Peer& peer : reply.peers()) {
    absl::PrintF("  %-10s %-28s %-22s %-4s %s", peer.role(), peer.name(), peer.address(), StateOf(peer), peer.state());
    if (peer.has_summary()) {
      absl::PrintF("  %.0f steps/s, %d lanes, %.0f MiB", peer.summary().steps_per_second(), peer.summary().lanes(),
                   static_cast<double>(peer.summary().memory_bytes()) / (1 << 20));
    }
    absl::PrintF("\n");
  }
}

void PrintText(const v1::StatusReply& reply) {
  absl::PrintF("%-24s %s\n", "role", reply.role());
  absl::PrintF("%-24s %s\n", "name", reply.name());
  absl::PrintF("%-24s %s\n", "version", reply.version());
  absl::PrintF("%-24s %s\n", "run", reply.run_id().empty() ? "-" : reply.run_id());
  if (!reply.metrics_address().empty()) absl::PrintF("%-24s %s\n", "metrics", reply.metrics_address());
  for (const v1::Metric& metric : reply.metrics()) {
    absl::PrintF("%-24s %.10g %s\n", metric.name(), metric.value(), metric.unit());
  }
  if (!reply.summary().last_error().empty()) absl::PrintF("%-24s %s\n", "last error", reply.summary().last_error());
  if (reply.summary().threads() > 0) absl::PrintF("time of %d threads\n", reply.summary().threads());
  PrintTimes(reply.summary().times());
  if (reply.has_fleet()) {
    absl::PrintF("time of the fleet\n");
    PrintTimes(reply.fleet().times());
    absl::PrintF("%-24s %s: %s\n", "bottleneck", reply.fleet().bottleneck(), reply.fleet().advice());
  }
  PrintPeers(reply);
}

absl::Status PrintJson(const v1::StatusReply& reply) {
  google::protobuf::util::JsonPrintOptions options;
  options.add_whitespace = true;
  options.always_print_primitive_fields = true;
  options.preserve_proto_field_names = true;
  std::string json;
  if (!google::protobuf::util::MessageToJsonString(reply, &json, options).ok()) {
    return absl::InternalError("the status has no JSON form");
  }
  std::fputs(json.c_str(), stdout);
  return absl::OkStatus();
}

absl::Status Print(const v1::StatusReply& reply) {
  absl::Status status;
  if (absl::GetFlag(FLAGS_json)) {
    status = PrintJson(reply);
  } else {
    PrintText(reply);
  }
  std::fflush(stdout);
  return status;
}

// Prints what the process streams, until it or the reader ends.
absl::Status Watch(const wire::Endpoint& process, absl::Duration interval) {
  v1::WatchRequest request;
  request.set_interval_ms(static_cast<int>(absl::ToInt64Milliseconds(interval)));
  grpc::ClientContext context;
  const auto stream = v1::StatusService::NewStub(process.channel)->WatchStatus(&context, request);
  v1::StatusReply reply;
  while (std::ferror(stdout) == 0 && stream->Read(&reply)) {
    CRAFTFLEET_RETURN_IF_ERROR(Print(reply));
    std::puts("");
  }
  return wire::FromCall(stream->Finish(), process.address, process);
}

absl::Status Run() {
  const absl::Duration interval = absl::GetFlag(FLAGS_interval);
  CRAFTFLEET_RETURN_IF_ERROR(CheckInterval(interval));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::Endpoint process, ConnectToProcess("process", absl::GetFlag(FLAGS_address)));
  if (absl::GetFlag(FLAGS_watch)) return Watch(process, interval);
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::StatusReply reply, AskStatus(process));
  return Print(reply);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
