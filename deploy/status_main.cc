// craftfleet status: what a process of the fleet is doing.

#include <cstdio>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <google/protobuf/util/json_util.h>

#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/channel.h"
#include "common/wire/channel_flags.h"
#include "craftfleet/v1/status.grpc.pb.h"

ABSL_FLAG(std::string, address, "127.0.0.1:50051", "address of a learner, actor or environment server, HOST:PORT");
ABSL_FLAG(bool, json, false, "print JSON");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet status";
constexpr char kUsage[] =
    R"(craftfleet status asks any process of the fleet what it is doing: role, version, run, uptime, rates, counts, peers.

  craftfleet status --address=127.0.0.1:50051
  craftfleet status --address=127.0.0.1:50051 --json)";

void Print(const v1::StatusReply& reply) {
  absl::PrintF("%-24s %s\n", "role", reply.role());
  absl::PrintF("%-24s %s\n", "version", reply.version());
  absl::PrintF("%-24s %s\n", "run", reply.run_id().empty() ? "-" : reply.run_id());
  absl::PrintF("%-24s %s\n", "uptime",
               absl::FormatDuration(absl::Trunc(absl::Seconds(reply.uptime_s()), absl::Seconds(1))));
  for (const v1::Metric& metric : reply.metrics()) {
    absl::PrintF("%-24s %.10g %s\n", metric.name(), metric.value(), metric.unit());
  }
  if (reply.peers_size() > 0) absl::PrintF("peers\n");
  for (const v1::Peer& peer : reply.peers()) {
    absl::PrintF("  %-10s %-40s %-24s %s\n", peer.role(), peer.name(), peer.address(), peer.state());
  }
}

absl::Status Run() {
  const std::string address = absl::GetFlag(FLAGS_address);
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("address", address));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  const wire::Endpoint endpoint = wire::Connect(address, security);
  CRAFTFLEET_RETURN_IF_ERROR(wire::WaitUntilConnected("process", endpoint, absl::Seconds(3)));
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(2));
  v1::StatusReply reply;
  const grpc::Status status =
      v1::StatusService::NewStub(endpoint.channel)->GetStatus(&context, v1::StatusRequest(), &reply);
  if (!status.ok()) return wire::FromCall(status, address, endpoint);
  if (!absl::GetFlag(FLAGS_json)) {
    Print(reply);
    return absl::OkStatus();
  }
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

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
