// Thousands of random histories of a fleet, checked against a plain model after every step.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace registry_property_test {

constexpr int kHistories = 2000;
constexpr int kSteps = 120;
constexpr int kNames = 5;
constexpr int64_t kPerIteration = 2;  // fragments of a lane

using FragmentId = std::pair<int, int64_t>;  // lane, fragment

// A fleet with randomly acting actors, and a model of it.
class History {
 public:
  explicit History(int seed) : random_(seed), lanes_(1 + Below(6)), registry_(Options(), Records(), &clock_) {
    Open();
    registry_.AddEvaluation({1, 1000, 1, 1, false, std::make_shared<HostWeights>("weights")});
  }

  void Run() {
    for (int step = 0; step < kSteps && !testing::Test::HasFailure(); ++step) {
      Step();
      CheckAll();
    }
    if (!testing::Test::HasFailure()) FinishIteration();
  }

 private:
  struct Player {
    std::string owner;           // identity that it joined with; empty: not joined
    absl::Time used;             // when the owner last used its name
    std::vector<Permit> active;  // permits it believes to hold
    bool drained = false;
    int64_t evaluation = 0;
  };

  LaneScheduler::Options Options() const {
    LaneScheduler::Options options;
    options.lanes = lanes_;
    return options;
  }
  std::vector<LaneRecord> Records() const { return std::vector<LaneRecord>(lanes_, {0, {"new", {}}, {"older", {}}}); }
  int Below(int n) { return static_cast<int>(random_() % n); }
  std::string AnyName() { return absl::StrCat("actor", Below(kNames)); }

  void Open() {
    last_fragment_ += kPerIteration;
    registry_.OpenIteration(last_fragment_, ++version_);
  }

  void Step() {
    const std::string name = AnyName();
    Player& player = players_[name];
    switch (Below(12)) {
      case 0:
        return Join(name, absl::StrCat("identity", Below(2)));
      case 1:
        return Leave(name);
      case 2:
        return registry_.OnConnectionLost(name);
      case 3:
        player.drained = registry_.SetDraining(name, true).ok() || player.drained;
        return;
      case 4:
        if (registry_.Undrain(name).ok()) player.drained = false;
        return;
      case 5:
        return clock_.Advance(absl::Milliseconds(Below(Below(4) == 0 ? 30000 : 1500)));
      case 6:
        if (IsComplete()) Open();
        if (Below(10) == 0) Rewind();
        return;
      case 7:
        return FinishTask(name, &player);
      case 8:
      case 9:
        return Push(name, &player);
      default:
        return Ask(name, &player, Below(2 * lanes_));
    }
  }

  bool MayUse(const Player& player, const std::string& identity) const {
    return player.owner.empty() || player.owner == identity || clock_.Now() - player.used >= absl::Seconds(20);
  }

  void Join(const std::string& name, const std::string& identity) {
    Player& player = players_[name];
    const bool may = MayUse(player, identity);
    const absl::Status status = registry_.Join({identity}, name, "", {});
    ASSERT_EQ(status.ok(), may) << name << " is " << player.owner << "'s: " << status;
    if (!may) return;
    if (player.owner != identity) player = {};
    player.owner = identity;
    player.used = clock_.Now();
  }

  void Leave(const std::string& name) {
    Player& player = players_[name];
    if (player.owner.empty()) return;
    const std::string other = player.owner == "identity0" ? "identity1" : "identity0";
    if (!MayUse(player, other)) {
      ASSERT_FALSE(registry_.Leave({other}, WorkerRole::kActor, name).ok()) << "the name belongs to another identity";
    }
    ASSERT_TRUE(registry_.Leave({player.owner}, WorkerRole::kActor, name).ok());
    player = {};
  }

  void Ask(const std::string& name, Player* player, int capacity) {
    if (player->owner.empty()) return;
    WorkerRegistry::PermitRequest request;
    request.client.identity = player->owner;
    request.actor = name;
    request.capacity = capacity;
    request.evaluates = true;
    request.evaluation = player->evaluation;
    for (size_t i = 0; i < player->active.size(); ++i) {
      if (Below(20) == 0) {  // returns the permit
        if (Below(2) == 0) request.failures.push_back({player->active[i].lane, player->active[i].fragment, "no game"});
        continue;
      }
      request.active.push_back(player->active[i]);
    }
    player->used = clock_.Now();
    const auto reply = registry_.GetPermits(request);
    player->active = request.active;
    if (!reply.ok()) {
      ASSERT_EQ(reply.status().code(), absl::StatusCode::kAborted) << reply.status();
      player->active.clear();
      return;
    }
    for (const Permit& lost : reply->lost) Drop(player, lost);
    const int before = Live(*player);
    for (const Permit& permit : reply->granted) {
      player->active.push_back(permit);
    }
    if (!reply->granted.empty()) {
      ASSERT_LE(Live(*player), std::max(capacity, before)) << name << " got more than it can play";
    }
    if (reply->evaluation.has_value()) player->evaluation = reply->evaluation->id;
    if (player->drained) {
      ASSERT_TRUE(reply->granted.empty()) << name << " is drained and got permits";
      ASSERT_FALSE(reply->evaluation.has_value()) << name << " is drained and got an evaluation";
    }
  }

  // The number of its permits whose fragments are not accepted yet.
  int Live(const Player& player) const {
    const std::vector<LaneRecord> records = registry_.Records();
    return static_cast<int>(std::count_if(player.active.begin(), player.active.end(), [&](const Permit& permit) {
      return permit.fragment >= records[permit.lane].next_fragment;
    }));
  }

  static void Drop(Player* player, const Permit& permit) {
    const auto at = std::find(player->active.begin(), player->active.end(), permit);
    if (at == player->active.end()) return;
    player->active.erase(at);
  }

  void Push(const std::string& name, Player* player) {
    if (player->active.empty()) return;
    const Permit permit = player->active[Below(static_cast<int>(player->active.size()))];
    player->used = clock_.Now();
    if (!registry_.UseName(WorkerRole::kActor, name, {player->owner}).ok()) return;
    const int64_t next = registry_.Records()[permit.lane].next_fragment;
    const auto verdict = registry_.Accept(name, permit, {absl::StrCat("after ", permit.fragment), {}});
    if (!verdict.ok()) return;  // another version of the weights
    if (*verdict == LaneScheduler::Verdict::kAccepted) {
      ASSERT_EQ(permit.fragment, next) << "fragments of a lane are accepted in order, each once";
      ASSERT_EQ(registry_.Records()[permit.lane].next_fragment, next + 1);
    } else {
      ASSERT_EQ(registry_.Records()[permit.lane].next_fragment, next);
    }
    Drop(player, permit);
  }

  void FinishTask(const std::string& name, Player* player) {
    if (player->evaluation == 0) return;
    const std::vector<LaneActor> actors = registry_.Actors();
    const bool is_known =
        std::any_of(actors.begin(), actors.end(), [&](const auto& actor) { return actor.worker->name == name; });
    const absl::Status status = registry_.FinishEvaluation(name, player->evaluation, std::vector<Episode>(1));
    ASSERT_EQ(status.code(), is_known ? absl::StatusCode::kOk : absl::StatusCode::kAborted) << status;
    player->evaluation = 0;
    if (!status.ok()) return;
    if (!registry_.FrontEvaluation(absl::ZeroDuration()).has_value()) return;
    registry_.PopEvaluation();
    registry_.AddEvaluation({++evaluations_, 1000, 1, 1, false, std::make_shared<HostWeights>("weights")});
  }

  void Rewind() {
    registry_.RewindIterations(1);
    registry_.OpenIteration(last_fragment_, version_);
  }

  bool IsComplete() const {
    for (const LaneRecord& lane : registry_.Records()) {
      if (lane.next_fragment < last_fragment_) return false;
    }
    return true;
  }

  // Checks the invariants.
  void CheckAll() {
    std::set<std::string> names;
    std::set<int> played;
    for (const LaneActor& actor : registry_.Actors()) {
      const std::string& name = actor.worker->name;
      ASSERT_TRUE(names.insert(name).second);
      ASSERT_EQ(actor.worker->draining, players_[name].drained) << name;
      played.insert(actor.permits.begin(), actor.permits.end());
    }
    ASSERT_EQ(played.size(), registry_.lanes()->table().playing()) << "a lane has a permit if an actor has it";
    for (const LaneRecord& lane : registry_.Records()) {
      ASSERT_GE(lane.next_fragment, last_fragment_ - kPerIteration) << "a finished iteration stays finished";
      ASSERT_LE(lane.next_fragment, last_fragment_);
    }
  }

  // Two correct actors finish the iteration, in equal shares.
  void FinishIteration() {
    const std::string one = "good one";
    const std::string two = "good two";
    for (const auto& [name, player] : players_) {
      if (!player.owner.empty()) registry_.Leave({player.owner}, WorkerRole::kActor, name).IgnoreError();
    }
    clock_.Advance(absl::Seconds(60));
    players_.clear();
    if (IsComplete()) Open();
    for (const std::string& name : {one, two}) Join(name, "identity0");  // the leases of all others have expired
    std::map<FragmentId, int> players;
    const int before = Unplayed();
    if (before == lanes_) {
      Ask(one, &players_[one], lanes_);
      Ask(two, &players_[two], lanes_);
      const int difference =
          static_cast<int>(players_[one].active.size()) - static_cast<int>(players_[two].active.size());
      ASSERT_LE(std::abs(difference), 1) << "shares are fair";
      ASSERT_EQ(players_[one].active.size() + players_[two].active.size(), static_cast<size_t>(lanes_));
      for (const auto& [name, player] : players_) {
        for (const Permit& permit : player.active) ++players[{permit.lane, permit.fragment}];
      }
      for (const auto& [fragment, times] : players) ASSERT_EQ(times, 1) << "lane " << fragment.first;
    }
    for (int i = 0; !IsComplete(); ++i) {
      ASSERT_LT(i, 2000) << "a fragment is lost";
      for (const std::string& name : {one, two}) {
        Ask(name, &players_[name], lanes_);
        Push(name, &players_[name]);
      }
      clock_.Advance(absl::Milliseconds(200));
    }
  }
  // The number of lanes that are not done.
  int Unplayed() const {
    int lanes = 0;
    for (const LaneRecord& lane : registry_.Records()) lanes += lane.next_fragment < last_fragment_ ? 1 : 0;
    return lanes;
  }

  std::mt19937 random_;
  mutable FakeClock clock_;
  const int lanes_;
  TestRegistry registry_;
  std::map<std::string, Player> players_;
  int64_t last_fragment_ = 0;
  int64_t version_ = 0;
  int64_t evaluations_ = 1;
};

TEST(RegistryProperty, WhateverActorsDoNothingIsGrantedTwiceOrLost) {
  for (int seed = 0; seed < kHistories; ++seed) {
    SCOPED_TRACE(seed);
    History(seed).Run();
    if (HasFailure()) return;
  }
}

}  // namespace registry_property_test
}  // namespace craftfleet
