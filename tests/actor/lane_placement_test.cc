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

// Random histories of servers that come, go and fail, checked against a model: the address of each lane.
class RandomHistory {
 public:
  explicit RandomHistory(uint64_t seed) : random_(seed), placement_(seed % 7) { ChangeServers(); }

  void Run(int events) {
    for (int i = 0; i < events; ++i) {
      const size_t event = Draw(8);
      const size_t server = addresses_.empty() ? 0 : Draw(addresses_.size());
      if (event == 0) ChangeServers();
      if (event == 1 && !addresses_.empty()) SetAvailable(server, Draw(2) == 0);
      if (event == 2 && !addresses_.empty()) Lose(server);
      if (event == 3) Level();
      if (event > 3) PlaceOne(static_cast<int>(Draw(kLanes)));
      ExpectLikeTheModel();
    }
    placement_.Clear();
    model_.clear();
    available_.clear();
    addresses_.clear();
    ExpectLikeTheModel();
  }

 private:
  static constexpr int kLanes = 40;

  size_t Draw(size_t n) { return std::uniform_int_distribution<size_t>(0, n - 1)(random_); }

  // Removes the lanes on `server` from the model, and returns them.
  std::vector<int> Forget(const std::string& server) {
    std::vector<int> lanes;
    for (const auto& [lane, address] : model_) {
      if (address == server) lanes.push_back(lane);
    }
    for (const int lane : lanes) model_.erase(lane);
    available_.erase(server);
    return lanes;
  }

  // Lanes of servers that stay do not move.
  void ChangeServers() {
    std::vector<std::string> now;
    for (int i = 0; i < 6; ++i) {
      if (Draw(2) == 0) now.push_back("server-" + std::to_string(i));
    }
    std::vector<int> gone;
    for (const std::string& address : addresses_) {
      if (std::find(now.begin(), now.end(), address) != now.end()) continue;
      const std::vector<int> lanes = Forget(address);
      gone.insert(gone.end(), lanes.begin(), lanes.end());
    }
    std::sort(gone.begin(), gone.end());
    EXPECT_EQ(placement_.SetServers(now), gone);
    addresses_ = now;
  }
  void SetAvailable(size_t server, bool available) {
    placement_.SetAvailable(server, available);
    available_.erase(addresses_[server]);
    if (available) available_.insert(addresses_[server]);
  }
  void Lose(size_t server) { EXPECT_EQ(placement_.Lose(server), Forget(addresses_[server])); }

  // A lane goes to an available server with the fewest lanes.
  void PlaceOne(int lane) {
    placement_.Remove(lane);
    model_.erase(lane);
    std::optional<size_t> except;
    if (!addresses_.empty() && Draw(3) == 0) except = Draw(addresses_.size());
    int fewest = kLanes + 1;
    for (size_t i = 0; i < addresses_.size(); ++i) {
      if (available_.count(addresses_[i]) > 0 && i != except) fewest = std::min(fewest, placement_.LanesOn(i));
    }
    const std::optional<size_t> server = placement_.Place(lane, except);
    ASSERT_EQ(server.has_value(), fewest <= kLanes);
    if (!server.has_value()) return;
    EXPECT_NE(server, except);
    EXPECT_EQ(available_.count(addresses_[*server]), 1U);
    EXPECT_EQ(placement_.LanesOn(*server), fewest + 1);
    model_[lane] = addresses_[*server];
  }

  // Moving the excess balances the available servers.
  void Level() {
    const std::vector<int> excess = placement_.Excess();
    for (const int lane : excess) placement_.Remove(lane);
    for (const int lane : excess) {
      const std::optional<size_t> server = placement_.Place(lane);
      ASSERT_TRUE(server.has_value());
      model_[lane] = addresses_[*server];
    }
    EXPECT_THAT(placement_.Excess(), IsEmpty());
  }

  void ExpectLikeTheModel() {
    std::vector<int> placed;
    for (int lane = 0; lane < kLanes; ++lane) {
      const std::optional<size_t> server = placement_.ServerOf(lane);
      ASSERT_EQ(server.has_value(), model_.count(lane) > 0) << lane;
      if (!server.has_value()) continue;
      ASSERT_EQ(addresses_[*server], model_[lane]);
      placed.push_back(lane);
    }
    std::shuffle(placed.begin(), placed.end(), random_);
    std::vector<int> by_server;
    for (const std::vector<int>& lanes : placement_.ByServer(placed)) {
      by_server.insert(by_server.end(), lanes.begin(), lanes.end());
    }
    ASSERT_EQ(placement_.Arrange(placed), by_server);
  }

  std::mt19937_64 random_;
  LanePlacement placement_;
  std::vector<std::string> addresses_;
  std::set<std::string> available_;
  std::map<int, std::string> model_;
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
