#include "learner/build_check.h"

#include <algorithm>

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/log.h"
#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kActor = "actor";
constexpr absl::string_view kEnvServer = "envserver";
constexpr absl::string_view kComputes =
    "run the same build with the same libraries everywhere; where CPUs differ, begin the run with --cpu=avx2";
constexpr absl::string_view kPlays = "run the same build everywhere";
constexpr size_t kMaxShown = 64;  // bytes of what a worker says; a canary has 16

// `text` of a worker, for logs and pages.
std::string Shown(absl::string_view text, absl::string_view nothing) {
  return text.empty() ? std::string(nothing) : absl::CHexEscape(text.substr(0, kMaxShown));
}
std::string ShownBuild(absl::string_view build) { return Shown(build, "older than this one"); }
std::string ShownCanary(absl::string_view canary) { return Shown(canary, "none"); }

}  // namespace

absl::Status BuildCheck::CheckActor(const v1::JoinRequest& request) {
  const MutexLock lock(&mu_);
  different_.erase({std::string(kActor), request.actor()});
  if (options_.policy_canary.empty() || request.canary() == options_.policy_canary) return absl::OkStatus();
  return Differs(
      {kActor, request.actor(), request.address(), ShownBuild(request.build()), ShownCanary(request.canary()),
       absl::StrCat("computes other numbers than this learner, on \"", Shown(request.cpu(), "?"), "\""), kComputes},
      options_.policy_canary);
}

absl::Status BuildCheck::CheckServer(const v1::Announcement& announcement) {
  const MutexLock lock(&mu_);
  different_.erase({std::string(kEnvServer), announcement.name()});
  if (game_canary_.empty()) game_canary_ = announcement.canary();
  if (announcement.canary() == game_canary_) return absl::OkStatus();
  const char* does = options_.game_canary.empty() ? "plays another game than the first one" : "plays another game";
  return Differs({kEnvServer, announcement.name(), announcement.address(), ShownBuild(announcement.build()),
                  ShownCanary(announcement.canary()), does, kPlays},
                 game_canary_);
}

absl::Status BuildCheck::Differs(const Worker& worker, absl::string_view want) {
  ++count_;
  if (different_.size() >= kMaxRemembered) {
    different_.erase(std::min_element(different_.begin(), different_.end(), [](const auto& a, const auto& b) {
      return a.second.last_word < b.second.last_word;
    }));
  }
  different_[{std::string(worker.role), std::string(worker.name)}] = {std::string(worker.address), worker.build,
                                                                      clock_->Now()};
  const std::string text = absl::StrFormat("%s %s (build %s) %s (build %s): its canary is %s, want %s",
                                           worker.role == kActor ? kActor : "environment server", worker.name,
                                           worker.build, worker.does, options_.build, worker.shown, want);
  if (!options_.allow_mixed) {
    return absl::FailedPreconditionError(
        absl::StrCat(text, ". ", worker.remedy, "; --allow_mixed of the learner lets it in all the same"));
  }
  if (warned_ != worker.build) LogWarning("%s; let in by --allow_mixed: the result depends on who plays", text);
  warned_ = worker.build;
  return absl::OkStatus();
}

std::string BuildCheck::GameCanary() const {
  const MutexLock lock(&mu_);
  return options_.allow_mixed ? "" : game_canary_;
}

void BuildCheck::FillStatus(v1::StatusReply* reply) const {
  const MutexLock lock(&mu_);
  for (const auto& [key, different] : different_) {
    if (clock_->Now() - different.last_word > kRemember) continue;
    const auto known = std::find_if(
        reply->mutable_peers()->begin(), reply->mutable_peers()->end(),
        [&key = key](const v1::Peer& peer) { return peer.role() == key.first && peer.name() == key.second; });
    const std::string says =
        absl::StrFormat("%s: another canary, build %s", options_.allow_mixed ? "mixed" : "refused", different.build);
    if (known != reply->mutable_peers()->end()) {
      known->set_state(known->state().empty() ? says : absl::StrCat(known->state(), "; ", says));
    } else if (!options_.allow_mixed) {
      v1::Peer* peer = reply->add_peers();
      peer->set_role(key.first);
      peer->set_name(key.second);
      peer->set_address(different.address);
      peer->set_health(v1::Peer::LOST);
      peer->set_last_seen_s(absl::ToDoubleSeconds(clock_->Now() - different.last_word));
      peer->set_state(says);
    }
  }
  wire::AddMetric("workers_mixed", static_cast<double>(count_), reply);
}

}  // namespace craftfleet
