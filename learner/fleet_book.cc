#include "learner/fleet_book.h"

#include <algorithm>
#include <iterator>

#include "common/activity.h"
#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

constexpr char kEnvServer[] = "envserver";
constexpr size_t kMaxNameBytes = 32;                    // of an activity
constexpr absl::Duration kRelayed = absl::Seconds(10);  // actors speak of their servers in turn, so less often

// What a worker sent, cut to what a page has room for.
v1::ProcessSummary Cut(v1::ProcessSummary summary) {
  const bool known = std::all_of(summary.times().begin(), summary.times().end(),
                                 [](const v1::ActivityTime& time) { return time.activity().size() <= kMaxNameBytes; });
  if (summary.times_size() > kNumActivities || !known) summary.clear_times();
  if (summary.last_error().size() > wire::kMaxErrorBytes) summary.mutable_last_error()->resize(wire::kMaxErrorBytes);
  return summary;
}

// What a worker did while it was there, or before it fell silent, is over.
void Rest(v1::ProcessSummary* summary) {
  summary->set_steps_per_second(0);
  summary->set_lanes(0);
  summary->clear_times();
}

}  // namespace

void FleetBook::Heard(absl::string_view role, absl::string_view name, absl::string_view address,
                      const v1::ProcessSummary& summary) {
  const MutexLock lock(&mu_);
  if (role == kEnvServer && workers_.count(Key(role, name)) == 0) {
    // One that came back, or of which actors spoke by its address alone, is the same to people.
    for (auto it = workers_.begin(); it != workers_.end();) {
      const bool same = it->first.first == role && it->first.second != name && it->second.address == address;
      it = same ? workers_.erase(it) : std::next(it);
    }
  }
  const auto [entry, is_new] = workers_.try_emplace(Key(role, name));
  Worker& worker = entry->second;
  if (!address.empty()) worker.address.assign(address.data(), address.size());
  worker.last_word = clock_->Now();
  if (summary.ByteSizeLong() > 0) {
    worker.summary = Cut(summary);
    worker.summary_time = worker.last_word;
  }
  worker.own_word = worker.last_word;
  worker.left = false;
  if (is_new) Forget();
}

void FleetBook::HeardOf(const v1::Peer& server) {
  const MutexLock lock(&mu_);
  const bool hangs = server.health() == v1::Peer::NOT_ANSWERING;
  for (auto& [key, worker] : workers_) {
    const bool same = key.first == kEnvServer && worker.address == server.address();
    if (!same || worker.own_word == absl::InfinitePast()) continue;
    if (hangs) worker.hung_at = clock_->Now();
    return;
  }
  const auto [entry, is_new] = workers_.try_emplace({kEnvServer, server.address()});
  Worker& worker = entry->second;
  if (is_new) {
    worker.address = server.address();
    worker.last_word = server.health() == v1::Peer::OK ? clock_->Now() : clock_->Now() - kRelayed;
  }
  if (server.health() == v1::Peer::OK) worker.last_word = clock_->Now();
  if (hangs) worker.hung_at = clock_->Now();
  if (server.has_summary()) {
    worker.summary = Cut(server.summary());
    worker.summary_time = clock_->Now();
  }
  if (is_new) Forget();
}

void FleetBook::Left(absl::string_view role, absl::string_view name) {
  const MutexLock lock(&mu_);
  const auto entry = workers_.find(Key(role, name));
  if (entry == workers_.end()) return;
  entry->second.left = true;
  entry->second.last_word = clock_->Now();
}

std::vector<v1::Peer> FleetBook::Workers() const {
  std::vector<v1::Peer> peers;
  const MutexLock lock(&mu_);
  for (const auto& [key, worker] : workers_) {
    const v1::Peer::Health health = HealthOf(worker);
    const absl::Duration silent = clock_->Now() - worker.last_word;
    if (silent > (health == v1::Peer::LEFT ? kRememberLeft : kRememberLost)) continue;
    v1::Peer& peer = peers.emplace_back();
    peer.set_role(key.first);
    peer.set_name(key.second);
    peer.set_address(worker.address);
    peer.set_health(health);
    peer.set_last_seen_s(absl::ToDoubleSeconds(silent));
    *peer.mutable_summary() = worker.summary;
    const bool silent_about_work = clock_->Now() - worker.summary_time > kRelayed;
    if (health != v1::Peer::OK || silent_about_work) Rest(peer.mutable_summary());
  }
  return peers;
}

v1::Peer::Health FleetBook::HealthOf(const Worker& worker) const {
  if (worker.left) return v1::Peer::LEFT;
  if (clock_->Now() - worker.hung_at < kRelayed) return v1::Peer::NOT_ANSWERING;
  const absl::Duration lease = worker.own_word == absl::InfinitePast() ? kRelayed : lease_;
  return clock_->Now() - worker.last_word < lease ? v1::Peer::OK : v1::Peer::LOST;
}

void FleetBook::Forget() {
  std::vector<std::pair<absl::Time, Key>> gone;
  for (const auto& [key, worker] : workers_) {
    if (HealthOf(worker) != v1::Peer::OK) gone.emplace_back(worker.last_word, key);
  }
  std::sort(gone.begin(), gone.end());
  const absl::Time oldest = clock_->Now() - kRememberLost;
  for (size_t i = 0; i < gone.size(); ++i) {
    if (gone[i].first < oldest || gone.size() - i > kMaxGone) workers_.erase(gone[i].second);
  }
}

}  // namespace craftfleet
