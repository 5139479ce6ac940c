#include "learner/rank_messages.h"

#include <cstring>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <absl/strings/strip.h>

#include "common/base/status_macros.h"
#include "common/wire/convert.h"

namespace craftfleet {
namespace {

// Before the configuration. Its number changes with the messages between ranks.
constexpr absl::string_view kProtocol = "craftfleet ranks 1\n";

// The beginning of a command; the scales follow.
struct Head {
  RankCommand::Kind kind;
  int64_t iteration;
  int64_t fragments;
};

absl::Status SendHead(const Head& head, absl::Span<const ValueScale> scales, RankGroup* group) {
  std::string bytes(reinterpret_cast<const char*>(&head), sizeof(head));
  bytes.append(reinterpret_cast<const char*>(scales.data()), scales.size() * sizeof(ValueScale));
  return group->Broadcast(&bytes);
}

}  // namespace

std::string RankOffer(const v1::RunConfig& config) { return absl::StrCat(kProtocol, config.SerializeAsString()); }

absl::StatusOr<v1::RunConfig> ParseRankOffer(const std::string& offer) {
  absl::string_view bytes = offer;
  v1::RunConfig config;
  if (!absl::ConsumePrefix(&bytes, kProtocol) || !config.ParseFromString(std::string(bytes))) {
    return absl::FailedPreconditionError(
        "rank 0 is of another version of CraftFleet: use the same build for all ranks");
  }
  return config;
}

absl::Status ShareState(PpoUpdater* updater, RankGroup* group) {
  const bool is_first = group->rank() == 0;
  std::string weights = is_first ? updater->SaveWeights() : "";
  std::string optimizer = is_first ? updater->SaveOptimizer() : "";
  CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&weights));
  CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&optimizer));
  return is_first ? absl::OkStatus() : updater->Load(weights, optimizer);
}

absl::Status SendCommand(RankCommand::Kind kind, RankGroup* group) { return SendHead({kind, 0, 0}, {}, group); }

absl::Status SendUpdate(int64_t iteration, absl::Span<const ValueScale> scales, absl::Span<const Fragment> fragments,
                        RankGroup* group) {
  const Head head = {RankCommand::Kind::kUpdate, iteration, static_cast<int64_t>(fragments.size())};
  CRAFTFLEET_RETURN_IF_ERROR(SendHead(head, scales, group));
  for (const Fragment& fragment : fragments) {
    std::string bytes = wire::ToProto(fragment).SerializeAsString();
    CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&bytes));
  }
  return absl::OkStatus();
}

absl::StatusOr<RankCommand> ReceiveCommand(const wire::FragmentShape& shape, RankGroup* group) {
  std::string bytes;
  CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&bytes));
  Head head;
  std::memcpy(&head, bytes.data(), sizeof(head));
  RankCommand command = {head.kind, head.iteration, std::vector<ValueScale>(head.fragments), {}};
  std::memcpy(command.scales.data(), bytes.data() + sizeof(head), head.fragments * sizeof(ValueScale));
  while (command.fragments.size() < command.scales.size()) {
    CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&bytes));
    v1::FragmentMessage message;
    if (!message.ParseFromString(bytes))
      return absl::InvalidArgumentError("rank 0 sent something else than a fragment");
    CRAFTFLEET_ASSIGN_OR_RETURN(Fragment fragment, wire::FromProto(&message, shape));
    command.fragments.push_back(std::move(fragment));
  }
  return command;
}

}  // namespace craftfleet
