#include "learner/training/fragments/fragment_journal.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class FragmentJournalTest : public testing::Test {
 protected:
  FragmentJournal Open(const std::string& run_id = "run-a") const { return FragmentJournal(path_, run_id); }
  // Appends fragments of lanes 0, 1, ...
  void Keep(int fragments) const {
    FragmentJournal journal = Open();
    for (int lane = 0; lane < fragments; ++lane) ASSERT_THAT(journal.Append(SampleFragment(lane, 4, 7)), IsOk());
  }
  // Expects the first of the appended fragments, complete.
  static void ExpectFirst(const std::vector<Fragment>& fragments) {
    for (size_t i = 0; i < fragments.size(); ++i) {
      ExpectSameFragments(fragments[i], SampleFragment(static_cast<int>(i), 4, 7));
    }
  }

  const TempFolder folder_;
  const std::string path_ = folder_ / "fragments.journal";
};

TEST_F(FragmentJournalTest, AnotherProcessReadsTheFragments) {
  Keep(3);
  const std::vector<Fragment> fragments = Open().Read(kSampleShape);
  ASSERT_THAT(fragments, SizeIs(3));
  ExpectFirst(fragments);
}

TEST_F(FragmentJournalTest, AppendsAfterExistingFragments) {
  Keep(1);
  FragmentJournal journal = Open();
  ASSERT_THAT(journal.Read(kSampleShape), SizeIs(1));
  ASSERT_THAT(journal.Append(SampleFragment(1, 4, 7)), IsOk());
  const std::vector<Fragment> fragments = Open().Read(kSampleShape);
  ASSERT_THAT(fragments, SizeIs(2));
  ExpectFirst(fragments);
}

TEST_F(FragmentJournalTest, ClearRemovesAllFragments) {
  Keep(3);
  FragmentJournal journal = Open();
  ASSERT_THAT(journal.Clear(), IsOk());
  EXPECT_THAT(Open().Read(kSampleShape), IsEmpty());
  ASSERT_THAT(journal.Append(SampleFragment(0, 4, 7)), IsOk());
  EXPECT_THAT(Open().Read(kSampleShape), SizeIs(1));
}

TEST_F(FragmentJournalTest, FragmentsOfAnotherRunAreIgnored) {
  Keep(3);
  FragmentJournal journal = Open("run-b");
  EXPECT_THAT(journal.Read(kSampleShape), IsEmpty());
  ASSERT_THAT(journal.Append(SampleFragment(0, 4, 7)), IsOk());
  EXPECT_THAT(Open("run-b").Read(kSampleShape), SizeIs(1));
}

TEST_F(FragmentJournalTest, ReadingEndsAtAFragmentOfAnotherShape) {
  Keep(3);
  wire::FragmentShape narrower = kSampleShape;
  narrower.lanes = 2;
  EXPECT_THAT(Open().Read(narrower), SizeIs(2));
}

// Such fragments would end the learner at each start.
TEST_F(FragmentJournalTest, ReadingEndsAtAFragmentWithImpossibleValues) {
  Keep(1);
  Fragment wild = SampleFragment(1, 4, 7);
  wild.log_probs[0] = 40;
  ASSERT_THAT(Open().Append(wild), IsOk());
  EXPECT_THAT(Open().Read(kSampleShape), SizeIs(1));
}

// The process or the host crashed during a write.
TEST_F(FragmentJournalTest, ATornEndLosesOneFragment) {
  Keep(2);
  const size_t two = ReadFile(path_)->size();
  ASSERT_THAT(Open().Append(SampleFragment(2, 4, 7)), IsOk());
  const std::string whole = *ReadFile(path_);
  for (size_t size = two; size < whole.size(); ++size) {
    ASSERT_THAT(ReplaceFile(path_, whole.substr(0, size)), IsOk());
    FragmentJournal journal = Open();
    ASSERT_THAT(journal.Read(kSampleShape), SizeIs(2)) << size;
    ASSERT_THAT(journal.Append(SampleFragment(2, 4, 7)), IsOk());
    ASSERT_EQ(*ReadFile(path_), whole);
  }
}

TEST_F(FragmentJournalTest, ACorruptByteIsDetected) {
  Keep(3);
  const std::string whole = *ReadFile(path_);
  for (size_t at = 0; at < whole.size(); ++at) {
    std::string wrong = whole;
    wrong[at] = static_cast<char>(wrong[at] ^ (1 << at % 8));
    ASSERT_THAT(ReplaceFile(path_, wrong), IsOk());
    const std::vector<Fragment> fragments = Open().Read(kSampleShape);
    ASSERT_LT(fragments.size(), 3) << at;
    ExpectFirst(fragments);
  }
}

TEST_F(FragmentJournalTest, AfterAFullDiskNothingIsStoredUntilClear) {
  FragmentJournal journal = Open();
  ASSERT_THAT(journal.Append(SampleFragment(0, 4, 7)), IsOk());
  const size_t one = ReadFile(path_)->size();
  {
    const FileSizeLimit full(one + 10);
    EXPECT_THAT(journal.Append(SampleFragment(1, 4, 7)),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr(path_)));
    EXPECT_THAT(journal.Append(SampleFragment(2, 4, 7)), IsOk()) << "the error is reported once";
  }
  ASSERT_THAT(journal.Append(SampleFragment(2, 4, 7)), IsOk());
  EXPECT_EQ(ReadFile(path_)->size(), one);
  EXPECT_THAT(Open().Read(kSampleShape), SizeIs(1));
  ASSERT_THAT(journal.Clear(), IsOk());
  ASSERT_THAT(journal.Append(SampleFragment(0, 4, 7)), IsOk());
  EXPECT_EQ(ReadFile(path_)->size(), one);
}

}  // namespace
}  // namespace craftfleet
