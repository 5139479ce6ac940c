#include "learner/training/distributed/rank_messages.h"

#include <algorithm>
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

// Before the configuration. Its number changes with the messages and connections between ranks.
constexpr absl::string_view kProtocol = "craftfleet ranks 3\n";

std::string Serialized(const Fragment& fragment) {
  if (fragment.scenes.empty()) return wire::ToProto(fragment).SerializeAsString();
  v1::FragmentMessage message = wire::ToProtoWithoutFrames(fragment);
  message.set_frames(fragment.scenes);
  message.set_frame_format(v1::FRAMES_SCENE);
  return message.SerializeAsString();
}

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

std::string FormatRankOffer(const RankOffer& offer) {
  return absl::StrCat(kProtocol, offer.texture_digest, "\n", offer.config.SerializeAsString());
}

absl::StatusOr<RankOffer> ParseRankOffer(absl::string_view text) {
  RankOffer offer;
  const bool is_known = absl::ConsumePrefix(&text, kProtocol);
  const size_t end = std::min(text.find('\n'), text.size());
  offer.texture_digest = std::string(text.substr(0, end));
  text.remove_prefix(std::min(end + 1, text.size()));
  if (!is_known || !offer.config.ParseFromString(std::string(text))) {
    return absl::FailedPreconditionError(
        "rank 0 is of another version of CraftFleet: use the same build for all ranks");
  }
  return offer;
}

absl::Status ShareState(PpoUpdater* updater, RankGroup* group) {
  const bool is_first = group->rank() == 0;
  std::string weights;
  std::string optimizer;
  if (is_first) {
    CRAFTFLEET_ASSIGN_OR_RETURN(weights, updater->SaveWeights());
    CRAFTFLEET_ASSIGN_OR_RETURN(optimizer, updater->SaveOptimizer());
  }
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
    std::string bytes = Serialized(fragment);
    CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&bytes));
  }
  return absl::OkStatus();
}

absl::StatusOr<RankCommand> ReceiveCommand(const wire::FragmentShape& shape, const FragmentFrames& frames,
                                           RankGroup* group) {
  std::string bytes;
  CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&bytes));
  Head head = {};
  if (bytes.size() >= sizeof(head)) std::memcpy(&head, bytes.data(), sizeof(head));
  const size_t scales = (bytes.size() - sizeof(head)) / sizeof(ValueScale);
  if (bytes.size() < sizeof(head) || head.fragments < 0 || static_cast<size_t>(head.fragments) != scales) {
    return absl::InvalidArgumentError("rank 0 sent something other than a command");
  }
  RankCommand command = {head.kind, head.iteration, std::vector<ValueScale>(head.fragments), {}};
  std::memcpy(command.scales.data(), bytes.data() + sizeof(head), head.fragments * sizeof(ValueScale));
  while (command.fragments.size() < command.scales.size()) {
    CRAFTFLEET_RETURN_IF_ERROR(group->Broadcast(&bytes));
    v1::FragmentMessage message;
    if (!message.ParseFromString(bytes))
      return absl::InvalidArgumentError("rank 0 sent something other than a fragment");
    CRAFTFLEET_RETURN_IF_ERROR(frames.Draw(shape.steps, &message));
    CRAFTFLEET_ASSIGN_OR_RETURN(Fragment fragment, wire::FromProto(&message, shape));
    command.fragments.push_back(std::move(fragment));
  }
  return command;
}

}  // namespace craftfleet
