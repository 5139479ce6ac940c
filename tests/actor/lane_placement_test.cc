#include "actor/lane_placement.h"

#include <algorithm>
#include <map>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

// Servers a, b, ..., all available.
LanePlacement PlacementOn(int servers, size_t first = 0) {
  LanePlacement placement(first);
  std::vector<std::string> addresses;
  for (int i = 0; i < servers; ++i) addresses.emplace_back(1, static_cast<char>('a' + i));
  placement.SetServers(addresses);
  for (int i = 0; i < servers; ++i) placement.SetAvailable(i, true);
  return placement;
}

TEST(LanePlacement, SpreadsLanesEvenly) {
  LanePlacement placement = PlacementOn(2);
  for (int lane = 0; lane < 4; ++lane) EXPECT_EQ(placement.Place(lane), lane % 2);
  EXPECT_EQ(placement.LanesOn(0), 2);
  EXPECT_EQ(placement.LanesOn(1), 2);
  EXPECT_THAT(placement.Arrange({3, 2, 1, 0}), ElementsAre(2, 0, 3, 1));
  EXPECT_THAT(placement.ByServer({0, 1, 2, 9}), ElementsAre(ElementsAre(0, 2), ElementsAre(1)));
}

TEST(LanePlacement, PrefersTheGivenFirstServer) {
  for (size_t first = 0; first < 7; ++first) EXPECT_EQ(PlacementOn(3, first).Place(0), first % 3);
}

TEST(LanePlacement, UsesOnlyAvailableServers) {
  LanePlacement placement = PlacementOn(2);
  placement.SetAvailable(0, false);
  EXPECT_EQ(placement.Place(0), 1);
  EXPECT_EQ(placement.Place(1, /*except=*/1), std::nullopt) << "there is no other server";
  EXPECT_EQ(placement.ServerOf(1), std::nullopt);
  placement.SetAvailable(1, false);
  EXPECT_FALSE(placement.AnyAvailable());
  EXPECT_EQ(placement.Place(1), std::nullopt);
  EXPECT_EQ(placement.ServerOf(0), 1) << "it stays where it is";
}

TEST(LanePlacement, ALostServerLosesOnlyItsOwnLanes) {
  LanePlacement placement = PlacementOn(2);
  for (int lane = 0; lane < 5; ++lane) placement.Place(lane);
  EXPECT_THAT(placement.Lose(0), ElementsAre(0, 2, 4));
  EXPECT_EQ(placement.LanesOn(0), 0);
  EXPECT_EQ(placement.LanesOn(1), 2);
  EXPECT_EQ(placement.Place(0), 1) << "the lost server is not available";
}

TEST(LanePlacement, ServersKeepTheirLanesWhenRenumbered) {
  LanePlacement placement = PlacementOn(3);
  for (int lane = 0; lane < 6; ++lane) placement.Place(lane);
  EXPECT_THAT(placement.SetServers({"0", "c", "b"}), ElementsAre(0, 3));
  EXPECT_EQ(placement.ServerOf(2), 1);
  EXPECT_EQ(placement.ServerOf(1), 2);
  EXPECT_EQ(placement.LanesOn(0), 0);
  EXPECT_EQ(placement.Place(0), 1) << "a new server is not available";
}

TEST(LanePlacement, ExcessIsTheFewestLanesThatBalanceTheServers) {
  LanePlacement placement = PlacementOn(3);
  placement.SetAvailable(1, false);
  placement.SetAvailable(2, false);
  for (int lane = 0; lane < 6; ++lane) placement.Place(lane);
  EXPECT_THAT(placement.Excess(), IsEmpty()) << "no other server is available";
  placement.SetAvailable(1, true);
  EXPECT_THAT(placement.Excess(), ElementsAre(0, 1, 2));
  placement.SetAvailable(2, true);
  EXPECT_THAT(placement.Excess(), ElementsAre(0, 1, 2, 3));
}

// Random histories of servers that come, go and fail, checked against a model of the lanes' places.
class RandomHistory {
 public:
  explicit RandomHistory(uint64_t seed) : random_(seed), placement_(seed % 7) { ChangeServers(); }

  void Run(int events) {
    for (int i = 0; i < events; ++i) {
      switch (Draw(8)) {
        case 0:
          ChangeServers();
          break;
        case 1:
          if (!addresses_.empty()) SetAvailable(Draw(addresses_.size()), Draw(2) == 0);
          break;
        case 2:
          if (!addresses_.empty()) Lose(Draw(addresses_.size()));
          break;
        case 3:
          placement_.Remove(static_cast<int>(Draw(kLanes)));
          break;
        case 4:
          Level();
          break;
        default:
          PlaceOne(static_cast<int>(Draw(kLanes)));
      }
      ExpectConsistent();
    }
    placement_.Clear();
    for (int lane = 0; lane < kLanes; ++lane) EXPECT_EQ(placement_.ServerOf(lane), std::nullopt);
    EXPECT_FALSE(placement_.AnyAvailable());
  }

 private:
  static constexpr int kLanes = 40;

  size_t Draw(size_t n) { return std::uniform_int_distribution<size_t>(0, n - 1)(random_); }

  // The address of each placed lane.
  std::map<int, std::string> Where() const {
    std::map<int, std::string> where;
    for (int lane = 0; lane < kLanes; ++lane) {
      if (const auto server = placement_.ServerOf(lane); server.has_value()) where[lane] = addresses_[*server];
    }
    return where;
  }

  // Servers come and go; lanes of those that stay do not move.
  void ChangeServers() {
    std::map<int, std::string> wanted = Where();
    std::vector<std::string> now;
    for (int i = 0; i < 6; ++i) {
      if (Draw(2) == 0) now.push_back("server-" + std::to_string(i));
    }
    std::vector<int> gone;
    for (auto lane = wanted.begin(); lane != wanted.end();) {
      const bool stays = std::find(now.begin(), now.end(), lane->second) != now.end();
      if (!stays) gone.push_back(lane->first);
      lane = stays ? std::next(lane) : wanted.erase(lane);
    }
    for (auto available = available_.begin(); available != available_.end();) {
      const bool stays = std::find(now.begin(), now.end(), *available) != now.end();
      available = stays ? std::next(available) : available_.erase(available);
    }
    EXPECT_EQ(placement_.SetServers(now), gone);
    addresses_ = now;
    EXPECT_EQ(Where(), wanted);
  }

  void SetAvailable(size_t server, bool available) {
    const std::map<int, std::string> before = Where();
    placement_.SetAvailable(server, available);
    if (available) {
      available_.insert(addresses_[server]);
    } else {
      available_.erase(addresses_[server]);
    }
    EXPECT_EQ(Where(), before);
  }

  void Lose(size_t server) {
    std::map<int, std::string> wanted = Where();
    std::vector<int> lanes;
    for (const auto& [lane, address] : std::map<int, std::string>(wanted)) {
      if (address != addresses_[server]) continue;
      lanes.push_back(lane);
      wanted.erase(lane);
    }
    EXPECT_EQ(placement_.Lose(server), lanes);
    available_.erase(addresses_[server]);
    EXPECT_EQ(Where(), wanted);
  }

  // A lane goes to an available server with the fewest lanes.
  void PlaceOne(int lane) {
    placement_.Remove(lane);
    std::optional<size_t> except;
    if (!addresses_.empty() && Draw(3) == 0) except = Draw(addresses_.size());
    int fewest = kLanes + 1;
    for (size_t i = 0; i < addresses_.size(); ++i) {
      if (available_.count(addresses_[i]) > 0 && i != except) fewest = std::min(fewest, placement_.LanesOn(i));
    }
    std::map<int, std::string> wanted = Where();
    const std::optional<size_t> server = placement_.Place(lane, except);
    EXPECT_EQ(server.has_value(), fewest <= kLanes);
    if (server.has_value()) {
      EXPECT_NE(server, except);
      EXPECT_EQ(available_.count(addresses_[*server]), 1u);
      EXPECT_EQ(placement_.LanesOn(*server), fewest + 1);
      wanted[lane] = addresses_[*server];
    }
    EXPECT_EQ(Where(), wanted);
  }

  // Moving the excess balances the available servers, and no other lanes are moved.
  void Level() {
    const std::vector<int> excess = placement_.Excess();
    const std::map<int, std::string> before = Where();
    size_t total = 0;
    for (const auto& [lane, address] : before) total += available_.count(address);
    size_t above = 0;  // minimum number of lanes to move
    for (size_t i = 0; i < addresses_.size(); ++i) {
      if (available_.count(addresses_[i]) == 0) continue;
      const size_t share = (total + available_.size() - 1) / available_.size();
      above += std::max<size_t>(placement_.LanesOn(i), share) - share;
    }
    EXPECT_GE(excess.size(), above);
    EXPECT_LE(excess.size(), above + available_.size());
    for (const int lane : excess) {
      EXPECT_EQ(available_.count(before.at(lane)), 1u);
      placement_.Remove(lane);
    }
    for (const int lane : excess) EXPECT_TRUE(placement_.Place(lane).has_value());
    EXPECT_THAT(placement_.Excess(), IsEmpty());
    for (const auto& [lane, address] : before) {
      if (std::find(excess.begin(), excess.end(), lane) != excess.end()) continue;
      EXPECT_EQ(Where().at(lane), address) << lane;
    }
  }

  void ExpectConsistent() {
    const std::map<int, std::string> where = Where();
    std::vector<int> counts(addresses_.size());
    std::vector<int> placed;
    for (const auto& [lane, address] : where) {
      ++counts[*placement_.ServerOf(lane)];
      placed.push_back(lane);
    }
    for (size_t i = 0; i < counts.size(); ++i) ASSERT_EQ(placement_.LanesOn(i), counts[i]);
    ASSERT_EQ(placement_.AnyAvailable(), !available_.empty());
    std::shuffle(placed.begin(), placed.end(), random_);
    const std::vector<int> arranged = placement_.Arrange(placed);
    ASSERT_TRUE(std::is_sorted(arranged.begin(), arranged.end(),
                               [this](int a, int b) { return *placement_.ServerOf(a) < *placement_.ServerOf(b); }));
    std::vector<int> by_server;
    for (const std::vector<int>& lanes : placement_.ByServer(placed)) {
      by_server.insert(by_server.end(), lanes.begin(), lanes.end());
    }
    ASSERT_EQ(by_server, arranged);
  }

  std::mt19937_64 random_;
  LanePlacement placement_;
  std::vector<std::string> addresses_;
  std::set<std::string> available_;
};

TEST(LanePlacement, InvariantsHoldInRandomHistories) {
  for (uint64_t seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    RandomHistory(seed).Run(100);
    if (testing::Test::HasFailure()) return;
  }
}

}  // namespace
}  // namespace craftfleet
