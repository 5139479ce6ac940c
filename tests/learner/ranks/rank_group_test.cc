#include "learner/ranks/rank_group.h"

#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/test_paths.h"
#include "tests/learner/ranks/local_ranks.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr size_t kSize = (size_t{3} << 18) + 17;  // of a sum: some parts, the last of them short

// A term whose sum with others depends on their order.
float Term(int shard, size_t i) { return static_cast<float>((i * 37 + shard * 1009) % 9973) * 1e-3F + shard * 1e5F; }

std::vector<float> Terms(int shard) {
  std::vector<float> term(kSize);
  for (size_t i = 0; i < kSize; ++i) term[i] = Term(shard, i);
  return term;
}

struct SumCase {
  int ranks;
  bool shares_memory;
};
class SumTest : public testing::TestWithParam<SumCase> {};

TEST_P(SumTest, AddsInTheOrderOfShardsAndGivesAllTheSameBits) {
  constexpr int kShards = 6;
  std::vector<float> expected = Terms(0);
  for (int shard = 1; shard < kShards; ++shard) {
    for (size_t i = 0; i < kSize; ++i) expected[i] += Term(shard, i);
  }
  const int ranks = GetParam().ranks;
  InGroup(ranks, [&](RankGroup* group) {
    std::vector<std::vector<float>> own;
    for (int i = 0; i < kShards / ranks; ++i) own.push_back(Terms(group->rank() * kShards / ranks + i));
    std::vector<SumTerm> terms;  // in pieces
    for (const auto& term : own) {
      const absl::Span<const float> all = term;
      terms.push_back({all.subspan(0, 5), all.subspan(5)});
    }
    if (GetParam().shares_memory) {
      ASSERT_TRUE(group->ShareMemory(kShards / ranks, kSize).ok());
    }
    std::vector<float> total(kSize);
    for (int round = 0; round < 3; ++round) {
      const absl::Status status = group->Sum(terms, absl::MakeSpan(total));
      ASSERT_TRUE(status.ok()) << status;
      EXPECT_TRUE(total == expected);
    }
    ASSERT_TRUE(group->Sum(terms, absl::MakeSpan(own[0])).ok());
    EXPECT_TRUE(own[0] == expected) << "in place";
  });
}

INSTANTIATE_TEST_SUITE_P(Ranks, SumTest,
                         testing::Values(SumCase{2, false}, SumCase{2, true}, SumCase{3, false}, SumCase{3, true}));

// More numbers, or more memory, than there is room for: along the chain.
TEST(RankGroup, SumsThatDoNotFitIntoSharedMemoryAreRightToo) {
  for (const size_t floats : {size_t{1}, size_t{1} << 44}) {
    InGroup(2, [&](RankGroup* group) {
      ASSERT_TRUE(group->ShareMemory(1, floats).ok());
      std::vector<float> values = {1.5, 2};
      ASSERT_TRUE(group->Sum({{absl::MakeConstSpan(values)}}, absl::MakeSpan(values)).ok());
      EXPECT_EQ(values, (std::vector<float>{3, 4}));
      ASSERT_TRUE(group->Sum({{absl::MakeConstSpan(values).subspan(0, 1)}}, absl::MakeSpan(values).subspan(1)).ok());
      EXPECT_EQ(values, (std::vector<float>{3, 6}));
    });
  }
}

// Tests of what is the same along the chain and through memory.
class SharedOrNotTest : public testing::TestWithParam<bool> {
 protected:
  static void InGroup(int world_size, const std::function<void(RankGroup*)>& run) {
    craftfleet::InGroup(world_size, [&](RankGroup* group) {
      if (GetParam()) {
        ASSERT_TRUE(group->ShareMemory(2, kSize).ok());
      }
      run(group);
    });
  }
};
INSTANTIATE_TEST_SUITE_P(Memory, SharedOrNotTest, testing::Bool());

TEST_P(SharedOrNotTest, RankWithoutATermPassesTheSumOn) {
  InGroup(3, [](RankGroup* group) {
    const std::vector<float> own = {1.5, 2};
    std::vector<SumTerm> terms;
    if (group->rank() != 1) terms.push_back({own});
    std::vector<float> total(2);
    ASSERT_TRUE(group->Sum(terms, absl::MakeSpan(total)).ok());
    EXPECT_EQ(total, (std::vector<float>{3, 4}));
  });
}

TEST(RankGroup, BytesAndFlagsOfRank0ReachAll) {
  const std::string sent(size_t{5} << 20, 'x');
  InGroup(3, [&](RankGroup* group) {
    std::string bytes = group->rank() == 0 ? sent : "own";
    ASSERT_TRUE(group->Broadcast(&bytes).ok());
    EXPECT_TRUE(bytes == sent);
    bytes = group->rank() == 0 ? "" : "own";
    ASSERT_TRUE(group->Broadcast(&bytes).ok());
    EXPECT_EQ(bytes, "");
    EXPECT_TRUE(*group->Share(group->rank() == 0));
    EXPECT_FALSE(*group->Share(group->rank() == 1));
  });
}

TEST(RankGroup, AllGetTheErrorOfTheFirstRankThatHasOne) {
  InGroup(3, [](RankGroup* group) {
    const bool fails = group->rank() > 0;
    const absl::Status own = fails ? absl::InternalError(absl::StrCat("of rank ", group->rank())) : absl::OkStatus();
    EXPECT_EQ(group->Agree(own), absl::InternalError("of rank 1"));
    EXPECT_TRUE(group->Agree(absl::OkStatus(), 7).ok());
    const absl::Status other = group->Agree(absl::OkStatus(), group->rank() == 2 ? 8 : 7);
    EXPECT_EQ(other.code(), absl::StatusCode::kDataLoss);
    EXPECT_THAT(std::string(other.message()), HasSubstr("rank 2 has other weights"));
    EXPECT_TRUE(group->ended().ok());
  });
}

TEST_P(SharedOrNotTest, AnErrorWithASumReachesAllAndTheNextSumIsRight) {
  InGroup(3, [](RankGroup* group) {
    const std::vector<float> own(kSize, static_cast<float>(group->rank()));
    const std::vector<Few> few = {{0.5, 1e9}, {0.25, 1}};
    std::vector<float> total(kSize);
    Few few_total{};
    const absl::Status error =
        group->rank() == 0 ? absl::OkStatus() : absl::InternalError(absl::StrCat("of rank ", group->rank()));
    EXPECT_EQ(group->AgreeAndSum(error, few, &few_total, {{own}}, absl::MakeSpan(total)),
              absl::InternalError("of rank 1"));
    ASSERT_TRUE(group->AgreeAndSum(absl::OkStatus(), few, &few_total, {{own}}, absl::MakeSpan(total)).ok());
    EXPECT_TRUE(total == std::vector<float>(kSize, 3));
    EXPECT_EQ(few_total, (Few{2.25, 3e9 + 3}));
  });
}

TEST_P(SharedOrNotTest, RanksOutOfStepEndTheGroup) {
  InGroup(2, [](RankGroup* group) {
    if (group->rank() == 0) {
      EXPECT_FALSE(group->Agree(absl::OkStatus()).ok());
    } else {
      EXPECT_EQ(group->Share(false).status().code(), absl::StatusCode::kInternal);
    }
    EXPECT_FALSE(group->ended().ok());
  });
  InGroup(3, [](RankGroup* group) {
    std::vector<float> values(kSize);
    EXPECT_FALSE((group->rank() == 1 ? group->Agree(absl::OkStatus())
                                     : group->Sum({{absl::MakeConstSpan(values)}}, absl::MakeSpan(values)))
                     .ok());
    EXPECT_FALSE(group->ended().ok());
  });
}

TEST(RankGroup, LeavingEndsAWaitingCall) {
  InGroup(2, [](RankGroup* group) {
    if (group->rank() == 0) {
      group->Leave(absl::CancelledError("asked to"));
      EXPECT_EQ(group->ended(), absl::CancelledError("asked to"));
    } else {
      std::string bytes;
      const absl::Status status = group->Broadcast(&bytes);
      EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
      EXPECT_THAT(std::string(status.message()), HasSubstr("rank 0 is lost"));
    }
  });
}

// A rank in a process of its own, which waits for rank 0's bytes.
class OtherProcess {
 public:
  explicit OtherProcess(int port) : pid_(fork()) {
    if (pid_ != 0) return;
    const std::string program = BuiltProgram("other_rank");
    execl(program.c_str(), program.c_str(), absl::StrCat(port).c_str(), nullptr);
    _exit(127);
  }
  ~OtherProcess() {
    Signal(SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  void Signal(int signal) const { kill(pid_, signal); }

 private:
  const pid_t pid_;
};

class LostRankTest : public testing::TestWithParam<int> {
 protected:
  // As programs do: Gloo may write to a rank that has just been killed.
  static void SetUpTestSuite() { std::signal(SIGPIPE, SIG_IGN); }
};

// Killed ones are noticed at once, suspended ones by their silence.
TEST_P(LostRankTest, EndsTheCallsThatWaitForIt) {
  const int port = FreePort();
  const OtherProcess other(port);
  const auto meeting = RankMeeting::Open(LocalRank(0, 2, port), "");
  ASSERT_TRUE(meeting.ok()) << meeting.status();
  auto links = (*meeting)->Connect({"canary", "build"});
  ASSERT_TRUE(links.ok()) << links.status();
  RankGroup group(*std::move(links));
  other.Signal(GetParam());
  // Agree would wait for ever for a rank that waits for bytes.
  const absl::Status status = group.Agree(absl::OkStatus());
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr("rank 1 is lost"));
  EXPECT_EQ(group.ended(), status);
}

INSTANTIATE_TEST_SUITE_P(Signals, LostRankTest, testing::Values(SIGKILL, SIGSTOP));

TEST(RankMeeting, RanksThatDoNotComeAreNamedToAllThatCame) {
  const int port = FreePort();
  OnRanks(2, [port](int rank) {
    RankOptions options = LocalRank(rank, 4, port);
    options.timeout = absl::Seconds(3);
    const auto meeting = RankMeeting::Open(options, "");
    ASSERT_TRUE(meeting.ok()) << meeting.status();
    const absl::Status status = (*meeting)->Connect({"canary", "build"}).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr("ranks 2, 3 of 4 have not come to 127.0.0.1:"));
    EXPECT_THAT(std::string(status.message()), HasSubstr("within 3s (--rank_timeout)"));
  });
}

TEST(RankMeeting, RankWithAnotherCanaryIsRefusedByNameEverywhere) {
  const int port = FreePort();
  OnRanks(3, [port](int rank) {
    const auto meeting = RankMeeting::Open(LocalRank(rank, 3, port), "");
    ASSERT_TRUE(meeting.ok()) << meeting.status();
    const absl::Status status = (*meeting)->Connect({rank == 2 ? "odd" : "canary", "build"}).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition) << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr("rank 2 computes other numbers than rank 0 (canary odd"));
  });
}

TEST(RankMeeting, RankThatObjectsToTheOfferIsNamedEverywhere) {
  const int port = FreePort();
  OnRanks(3, [port](int rank) {
    const auto meeting = RankMeeting::Open(LocalRank(rank, 3, port), "seed: 1");
    ASSERT_TRUE(meeting.ok()) << meeting.status();
    RankBuild build = {"canary", "build"};
    if (rank == 1) build.objection = absl::InvalidArgumentError("--seed=2, but rank 0 has 1\n");
    const absl::Status status = (*meeting)->Connect(build).status();
    EXPECT_EQ(status, absl::FailedPreconditionError("rank 1: --seed=2, but rank 0 has 1\n"));
  });
}

TEST(RankMeeting, OfferReachesAllAndAnotherWorldSizeIsRefused) {
  const int port = FreePort();
  const auto first = RankMeeting::Open(LocalRank(0, 2, port), "what rank 0 offers");
  ASSERT_TRUE(first.ok()) << first.status();
  const auto second = RankMeeting::Open(LocalRank(1, 2, port), "");
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ((*second)->offer(), "what rank 0 offers");
  const auto other = RankMeeting::Open(LocalRank(1, 3, port), "");
  EXPECT_EQ(other.status().code(), absl::StatusCode::kFailedPrecondition) << other.status();
  EXPECT_THAT(std::string(other.status().message()), HasSubstr("--world_size=3, but rank 0 at 127.0.0.1:"));
}

TEST(RankMeeting, MissingRank0IsAnErrorAfterTheTimeout) {
  const int port = FreePort();
  RankOptions options = LocalRank(1, 2, port);
  options.timeout = absl::Seconds(1);
  const auto meeting = RankMeeting::Open(options, "");
  EXPECT_EQ(meeting.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(meeting.status().message()),
              HasSubstr(absl::StrCat("rank 0 has not come to 127.0.0.1:", port, " within 1s")));
}

// Rank 0's meeting at `master_addr`; `other` gets the options of rank 1.
std::unique_ptr<RankMeeting> OpenAt(const std::string& master_addr, RankOptions* other) {
  *other = LocalRank(0, 2, FreePort());
  other->master_addr = master_addr;
  auto meeting = RankMeeting::Open(*other, "offer");
  EXPECT_TRUE(meeting.ok()) << meeting.status();
  other->rank = 1;
  return meeting.ok() ? *std::move(meeting) : nullptr;
}

TEST(RankMeeting, Rank0ListensOnTheGivenAddressOnly) {
  RankOptions options;
  const auto first = OpenAt("127.0.0.2", &options);
  ASSERT_NE(first, nullptr);
  EXPECT_TRUE(RankMeeting::Open(options, "").ok());
  options.master_addr = "127.0.0.1";
  options.timeout = absl::Seconds(1);
  EXPECT_EQ(RankMeeting::Open(options, "").status().code(), absl::StatusCode::kUnavailable);
}

TEST(RankMeeting, AnAddressOfAnotherHostIsAnErrorOfRank0) {
  RankOptions options = LocalRank(0, 2, FreePort());
  options.master_addr = "192.0.2.1";  // for documentation: nobody's
  const absl::Status status = RankMeeting::Open(options, "").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr("--master_addr=192.0.2.1 --master_port="));
  EXPECT_THAT(std::string(status.message()), HasSubstr("the host is not this machine"));
}

// Whether this host has ::1.
bool HasIPv6() {
  sockaddr_in6 name = {};
  name.sin6_family = AF_INET6;
  name.sin6_addr = in6addr_loopback;
  const int tried = socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const bool has = bind(tried, reinterpret_cast<const sockaddr*>(&name), sizeof(name)) == 0;
  close(tried);
  return has;
}

TEST(RankMeeting, AnAddressOfIPv6NeedsNoBrackets) {
  if (!HasIPv6()) GTEST_SKIP() << "this host has no ::1";
  RankOptions options;
  const auto first = OpenAt("::1", &options);
  ASSERT_NE(first, nullptr);
  const auto second = RankMeeting::Open(options, "");
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ((*second)->offer(), "offer");
}

TEST(RankMeeting, SecondProcessOfARankIsRefused) {
  const int port = FreePort();
  std::vector<std::unique_ptr<RankLinks>> group(2);  // stays while the second process comes
  OnRanks(2, [&](int rank) {
    const auto meeting = RankMeeting::Open(LocalRank(rank, 2, port), "");
    ASSERT_TRUE(meeting.ok()) << meeting.status();
    auto links = (*meeting)->Connect({"canary", "build"});
    ASSERT_TRUE(links.ok()) << links.status();
    group[rank] = *std::move(links);
  });
  const auto second = RankMeeting::Open(LocalRank(1, 2, port), "");
  ASSERT_TRUE(second.ok()) << second.status();
  const absl::Status status = (*second)->Connect({"canary", "build"}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kAlreadyExists) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr("rank 1 is already in the group at 127.0.0.1:"));
}

}  // namespace
}  // namespace craftfleet
