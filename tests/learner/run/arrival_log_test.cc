#include "learner/run/arrival_log.h"

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr ArrivalReader::Run kRun = {/*lanes=*/2, /*max_staleness=*/1, /*fragments=*/2};
constexpr char kFirst[] =
    "{\"policy_version\": 0, \"fragments\": [[1, 0, 0, \"00000000000000ff\"], [1, 1, 0, \"fedcba9876543210\"]]}\n";
constexpr char kSecond[] =
    "{\"policy_version\": 1, \"fragments\": [[0, 0, 0, \"0000000000000001\"], [1, 2, 1, \"0000000000000002\"]]}\n";

class ArrivalLogTest : public testing::Test {
 protected:
  absl::StatusOr<ArrivalReader> Open(const std::string& text) {
    EXPECT_THAT(WriteFileSynced(folder_ / kArrivalsFile, text), IsOk());
    return ArrivalReader::Open(folder_ / kArrivalsFile, kRun);
  }

  const TempFolder folder_;
};

TEST_F(ArrivalLogTest, ALineHasTheFragmentsInTheOrderOfArrival) {
  EXPECT_EQ(FormatArrivals({0, {{{1, 0, 0}, 255}, {{1, 1, 0}, 0xfedcba9876543210}}}), kFirst);
}

TEST_F(ArrivalLogTest, ReadsUpdateByUpdate) {
  absl::StatusOr<ArrivalReader> reader = Open(absl::StrCat(kFirst, kSecond));
  ASSERT_THAT(reader, IsOk());
  const absl::StatusOr<UpdateArrivals> first = reader->Next();
  ASSERT_THAT(first, IsOk());
  EXPECT_EQ(first->policy_version, 0);
  EXPECT_THAT(first->fragments, ElementsAre(Arrival{{1, 0, 0}, 255}, Arrival{{1, 1, 0}, 0xfedcba9876543210}));
  EXPECT_FALSE(reader->at_end());
  EXPECT_THAT(reader->Next(), IsOk());
  EXPECT_TRUE(reader->at_end());
}

TEST_F(ArrivalLogTest, ALineThatAKilledLearnerDidNotFinishDoesNotCount) {
  for (size_t length = 0; length < std::string(kSecond).size(); ++length) {
    absl::StatusOr<ArrivalReader> reader = Open(kFirst + std::string(kSecond).substr(0, length));
    ASSERT_THAT(reader, IsOk());
    EXPECT_THAT(reader->Next(), IsOk());
    EXPECT_TRUE(reader->at_end()) << length;
  }
  EXPECT_TRUE(Open("")->at_end());
}

TEST_F(ArrivalLogTest, NamesTheLineThatIsDamagedOrCannotFollow) {
  const auto update = [](const std::string& version, const std::string& fragments) {
    return absl::StrCat("{\"policy_version\": ", version, ", \"fragments\": [", fragments, "]}\n");
  };
  const std::string good = R"([0, 0, 1, "0000000000000001"])";
  const auto with = [&](const std::string& other) { return update("1", absl::StrCat(good, ", ", other)); };
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"x\n", "not an object"},
      {"{}\n", "not an object"},
      {"{\"policy_version\": -1, \"fragments\": []}\n", "not an object"},
      {update("2", good), "policy_version 2, want 1"},
      {update("1", good), "1 fragments, want 2"},
      {with(R"([2, 0, 1, "0000000000000001"])"), "want [lane 0..1, fragment, policy_version"},
      {with(R"([1, 2, 1, 7])"), "want [lane 0..1, fragment, policy_version"},
      {with(R"([1, 2, 1, "1"])"), "want [lane 0..1, fragment, policy_version"},
      {with(R"([1, 2.5, 1, "0000000000000001"])"), "want [lane 0..1, fragment, policy_version"},
      {with(R"([1, 3, 1, "0000000000000001"])"), "fragment 3 of lane 1, want 2"},
      {with(good), "fragment 0 of lane 0, want 1"},
      {with(R"([1, 2, 2, "0000000000000001"])"), "fragment 2 of lane 1 was played with weights 2, want 0..1"},
  };
  for (const auto& [line, error] : cases) {
    absl::StatusOr<ArrivalReader> reader = Open(kFirst + line);
    ASSERT_THAT(reader, IsOk());
    ASSERT_THAT(reader->Next(), IsOk());
    EXPECT_THAT(reader->Next(),
                StatusIs(absl::StatusCode::kDataLoss, AllOf(HasSubstr("arrivals.jsonl:2: "), HasSubstr(error))))
        << line;
  }
}

TEST_F(ArrivalLogTest, AMissingRecordIsAnError) {
  EXPECT_THAT(ArrivalReader::Open(folder_ / "none", kRun), StatusIs(absl::StatusCode::kNotFound, HasSubstr("none")));
}

}  // namespace
}  // namespace craftfleet
