#include "learner/ranks/rank_store.h"

#include <memory>
#include <string>
#include <thread>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/learner/ranks/local_ranks.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

class RankStoreTest : public testing::Test {
 protected:
  void SetUp() override {
    auto rank0 = RankStore::Serve(address_);
    ASSERT_TRUE(rank0.ok()) << rank0.status();
    rank0_ = *rank0;
    auto other = RankStore::Join(address_, absl::Seconds(10));
    ASSERT_TRUE(other.ok()) << other.status();
    other_ = *other;
  }

  const std::string address_ = absl::StrCat("127.0.0.2:", FreePort());
  std::shared_ptr<RankStore> rank0_;
  std::shared_ptr<RankStore> other_;
};

TEST_F(RankStoreTest, ValuesReachTheOthersAndStay) {
  const std::string bytes("\0\xff\n", 3);
  EXPECT_EQ(other_->Get("key").status().code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(rank0_->Put("key", bytes).ok());
  EXPECT_EQ(*other_->Get("key"), bytes);
  EXPECT_EQ(other_->Put("key", "other").code(), absl::StatusCode::kAlreadyExists);
  EXPECT_EQ(*rank0_->Get("key"), bytes);
}

TEST_F(RankStoreTest, AwaitsAValueForSomeTime) {
  EXPECT_EQ(other_->Await("key", absl::Milliseconds(20)).status().code(), absl::StatusCode::kNotFound);
  std::thread later([this] { EXPECT_TRUE(rank0_->Put("key", "value").ok()); });
  EXPECT_EQ(*other_->Await("key", absl::Seconds(30)), "value");
  later.join();
}

TEST(RankStore, WaitsForRank0) {
  const std::string address = absl::StrCat("127.0.0.1:", FreePort());
  std::shared_ptr<RankStore> rank0;
  std::thread later([&] {
    absl::SleepFor(absl::Seconds(1));
    rank0 = RankStore::Serve(address).value();
  });
  EXPECT_TRUE(RankStore::Join(address, absl::Seconds(4)).ok());
  later.join();
}

TEST_F(RankStoreTest, IsBounded) {
  EXPECT_EQ(other_->Put("key", std::string(65 << 10, 'x')).code(), absl::StatusCode::kResourceExhausted);
  const std::string large(63 << 10, 'x');
  absl::Status status;
  int written = 0;
  for (; status.ok() && written < 2000; ++written) status = other_->Put(absl::StrCat(written), large);
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted) << status;
  EXPECT_GT(written, 1000);
}

TEST_F(RankStoreTest, ListensOnTheGivenAddressOnly) {
  const std::string port = address_.substr(address_.rfind(':'));
  const auto elsewhere = RankStore::Join(absl::StrCat("127.0.0.1", port), absl::Seconds(1));
  EXPECT_EQ(elsewhere.status().code(), absl::StatusCode::kUnavailable) << elsewhere.status();
  const auto taken = RankStore::Serve(address_);
  EXPECT_EQ(taken.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(taken.status().message()), HasSubstr("the port is in use"));
}

TEST_F(RankStoreTest, SaysWhenRank0HasLeft) {
  rank0_.reset();
  EXPECT_EQ(other_->Await("key", absl::Seconds(30)).status().code(), absl::StatusCode::kUnavailable);
}

}  // namespace
}  // namespace craftfleet
