#include "envserver/game_budget.h"

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr int64_t kMiB = 1 << 20;

auto Refused(const std::string& asked, const std::string& limit) {
  return StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr(asked), HasSubstr(limit)));
}

GameBudget::Options SomeLimits() { return {10, 15, 100 * kMiB, 150 * kMiB}; }

TEST(GameBudget, CountsGamesOfASessionAndOfAll) {
  GameBudget budget(SomeLimits());
  auto first = std::make_unique<GameBudget::Share>(&budget, "a");
  GameBudget::Share second(&budget, "a");
  EXPECT_THAT(first->Set(10, 0), IsOk());
  EXPECT_THAT(first->Set(11, 0), Refused("games of one session: 11 requested", "at most 10 (--max_session_games)"));
  EXPECT_THAT(second.Set(6, 0), Refused("games of all sessions: 16 requested", "at most 15 (--max_games)"));
  EXPECT_THAT(second.Set(5, 0), IsOk());
  GameBudget::Share third(&budget, "a");
  EXPECT_THAT(third.Set(1, 0), Refused("games of all sessions: 16 requested", "at most 15"));
  first.reset();
  EXPECT_THAT(third.Set(10, 0), IsOk());
  EXPECT_THAT(second.Set(6, 0), Refused("games of all sessions: 16 requested", "at most 15"));
}

TEST(GameBudget, CountsMemoryOfASessionAndOfAll) {
  GameBudget budget(SomeLimits());
  GameBudget::Share first(&budget, "a");
  GameBudget::Share second(&budget, "a");
  EXPECT_THAT(first.Set(1, 100 * kMiB + 1),
              Refused("MiB for one session's games: 101 requested", "(--max_session_mb)"));
  EXPECT_THAT(first.Set(1, 100 * kMiB), IsOk());
  EXPECT_THAT(second.Set(1, 51 * kMiB), Refused("MiB for all games: 151 requested", "at most 150 (--max_games_mb)"));
  EXPECT_EQ(budget.bytes(), 100 * kMiB);
}

// One client could take everything, and all others were refused.
TEST(GameBudget, OneClientLeavesRoomForOthers) {
  GameBudget::Options options = {10, 40, 100 * kMiB, 400 * kMiB};
  options.client_percent = 50;
  std::vector<std::string> full;
  GameBudget budget(options, [&](const std::string* client) { full.push_back(client == nullptr ? "all" : *client); });
  GameBudget::Share first(&budget, "a");
  GameBudget::Share second(&budget, "a");
  GameBudget::Share third(&budget, "a");
  ASSERT_THAT(first.Set(10, 0), IsOk());
  ASSERT_THAT(second.Set(10, 0), IsOk());
  EXPECT_THAT(third.Set(1, 0), Refused("games of one client: 21 requested", "at most 20 (--max_client_percent)"));
  ASSERT_THAT(first.Set(1, 100 * kMiB), IsOk());
  ASSERT_THAT(second.Set(1, 100 * kMiB), IsOk());
  EXPECT_THAT(third.Set(0, 1), Refused("MiB for one client's games: 201 requested", "at most 200"));
  EXPECT_THAT(full, ElementsAre("a", "a"));
  GameBudget::Share other(&budget, "b");
  EXPECT_THAT(other.Set(10, 100 * kMiB), IsOk());
  ASSERT_THAT(second.Set(0, 0), IsOk());
  EXPECT_THAT(third.Set(1, 100 * kMiB), IsOk());
}

TEST(GameBudget, OneClientMayHaveAsMuchAsOneSession) {
  GameBudget::Options options = SomeLimits();  // of which the half is less
  options.client_percent = 50;
  GameBudget budget(options);
  GameBudget::Share first(&budget, "a");
  EXPECT_THAT(first.Set(10, 100 * kMiB), IsOk());
  GameBudget::Share second(&budget, "a");
  EXPECT_THAT(second.Set(1, 0), Refused("11 requested", "at most 10 (--max_client_percent)"));
}

// A session may always reduce its share, even if the limits are exceeded.
TEST(GameBudget, ReleasingIsNeverRefused) {
  GameBudget budget(SomeLimits());
  GameBudget::Share first(&budget, "a");
  GameBudget::Share second(&budget, "a");
  ASSERT_THAT(first.Set(10, kMiB), IsOk());
  ASSERT_THAT(second.Set(5, kMiB), IsOk());
  EXPECT_THAT(first.Set(9, kMiB), IsOk());
  EXPECT_THAT(first.Set(9, kMiB), IsOk());
  GameBudget::Share third(&budget, "a");
  EXPECT_THAT(third.Set(2, 0), Refused("16 requested", "at most 15"));
  EXPECT_THAT(third.Set(1, 0), IsOk());
}

TEST(GameBudget, ConcurrentRequestsStayWithinTheLimit) {
  GameBudget budget({1, 8, kMiB, 8 * kMiB});
  std::vector<std::unique_ptr<GameBudget::Share>> shares;
  for (int i = 0; i < 32; ++i) shares.push_back(std::make_unique<GameBudget::Share>(&budget, "a"));
  std::vector<std::thread> threads;
  std::atomic<int> admitted{0};
  for (auto& share : shares) threads.emplace_back([&] { admitted += share->Set(1, kMiB).ok() ? 1 : 0; });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(admitted, 8);
  shares.clear();
  EXPECT_EQ(budget.bytes(), 0);
  for (int i = 0; i < 8; ++i) {
    shares.push_back(std::make_unique<GameBudget::Share>(&budget, "a"));
    EXPECT_THAT(shares.back()->Set(1, 0), IsOk());
  }
}

TEST(GameBudget, EstimatesMoreForLargerPicturesAndForRecordings) {
  const int64_t small = SessionBytes(16, 0, 64 * 64 * 3, false, 0);
  EXPECT_LT(small, 3 * kMiB);
  EXPECT_GT(SessionBytes(16, 0, 64 * 64 * 3, true, 256 * 256 * 3), small + 16 * 2 * 256 * 256 * 3);
  EXPECT_GT(SessionBytes(120, 0, 2048 * 2048 * 3, false, 0), int64_t{3} << 30);  // once possible without a limit
  EXPECT_LT(SessionBytes(4096, 0, 64 * 64 * 3, false, 0), 512 * kMiB);           // allowed by default
}

TEST(GameBudget, InvalidLimitsNameTheFlag) {
  EXPECT_THAT(GameBudget::Options().Validate(), IsOk());
  EXPECT_THAT(SomeLimits().Validate(), IsOk());
  const auto wrong = [](const GameBudget::Options& options, const char* flag) {
    EXPECT_THAT(options.Validate(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(flag)));
  };
  wrong({0, 15, 100 * kMiB, 150 * kMiB}, "--max_session_games=0, want at least 1");
  wrong({10, 9, 100 * kMiB, 150 * kMiB}, "--max_games=9, want at least 10");
  wrong({10, 15, 0, 150 * kMiB}, "--max_session_mb=0, want at least 1");
  wrong({10, 15, 100 * kMiB, 99 * kMiB}, "--max_games_mb=99, want at least 100");
  wrong({10, 15, 100 * kMiB, 150 * kMiB, 0}, "--max_client_percent=0, want 1..100");
  wrong({10, 15, 100 * kMiB, 150 * kMiB, 101}, "--max_client_percent=101, want 1..100");
}

}  // namespace
}  // namespace craftfleet
