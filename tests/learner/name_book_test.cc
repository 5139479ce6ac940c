#include "learner/name_book.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr absl::Duration kLapse = absl::Seconds(10);

class NameBookTest : public testing::Test {
 protected:
  FakeClock clock_;
  NameBook book_{kLapse, &clock_};
};

TEST_F(NameBookTest, TheFirstOwnsTheName) {
  EXPECT_THAT(book_.Use("actor", "a", "one"), IsOk());
  EXPECT_THAT(book_.Use("actor", "a", "one"), IsOk());
  EXPECT_THAT(book_.Use("actor", "a", "two"),
              StatusIs(absl::StatusCode::kPermissionDenied, AllOf(HasSubstr("actor \"a\""), HasSubstr("10s"))));
  EXPECT_THAT(book_.Use("actor", "a", ""), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  EXPECT_THAT(book_.Use("environment server", "a", "two"), IsOk()) << "a name of another kind";
  EXPECT_THAT(book_.Use("actor", "b", "two"), IsOk());
}

TEST_F(NameBookTest, ANameIsFreeAfterItsOwnerLeftOrFellSilent) {
  EXPECT_THAT(book_.Use("actor", "a", "one"), IsOk());
  book_.Leave("actor", "a");
  EXPECT_THAT(book_.Use("actor", "a", "two"), IsOk());
  clock_.Advance(kLapse - absl::Milliseconds(1));
  EXPECT_THAT(book_.Use("actor", "a", "one"), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  EXPECT_THAT(book_.Use("actor", "a", "two"), IsOk()) << "a stranger's tries don't count, its own do";
  clock_.Advance(kLapse - absl::Milliseconds(1));
  EXPECT_THAT(book_.Use("actor", "a", "one"), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("\"")));
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_THAT(book_.Use("actor", "a", "one"), IsOk());
  book_.Leave("actor", "nobody");
}

TEST_F(NameBookTest, WithoutCertificatesAllAreOne) {
  EXPECT_THAT(book_.Use("actor", "a", ""), IsOk());
  EXPECT_THAT(book_.Use("actor", "a", ""), IsOk());
}

TEST_F(NameBookTest, NobodyFillsTheBook) {
  for (size_t i = 0; i < NameBook::kMaxNames; ++i) ASSERT_THAT(book_.Use("actor", absl::StrCat(i), "one"), IsOk());
  EXPECT_THAT(book_.Use("actor", "more", "one"),
              StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr("\"more\""), HasSubstr("16384"))));
  EXPECT_THAT(book_.Use("actor", "0", "one"), IsOk());
  EXPECT_THAT(book_.Use("actor", "more", "two"), IsOk());
  clock_.Advance(kLapse);
  EXPECT_THAT(book_.Use("actor", "another", "one"), IsOk());
}

}  // namespace
}  // namespace craftfleet
