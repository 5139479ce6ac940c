#include "actor/recording/npz.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

// The bytes that numpy 1.24's save() writes for numpy.arange(3, dtype="<i8") and numpy.array([[1, 2]], dtype="|u1").
TEST(EncodeNpy, MatchesTheBytesOfNumpy) {
  const std::string data("\0\0\0\0\0\0\0\0\1\0\0\0\0\0\0\0\2\0\0\0\0\0\0\0", 24);
  const std::string vector = EncodeNpy({"any", "<i8", {3}, data});
  std::string header = "{'descr': '<i8', 'fortran_order': False, 'shape': (3,), }";
  header.resize(117, ' ');
  EXPECT_EQ(vector, absl::StrCat(std::string("\x93NUMPY\1\0\x76\0", 10), header, "\n", data));
  EXPECT_THAT(EncodeNpy({"any", "|u1", {1, 2}, "\1\2"}),
              HasSubstr("{'descr': '|u1', 'fortran_order': False, 'shape': (1, 2), }"));
  EXPECT_THAT(EncodeNpy({"any", "<f8", {0}, ""}), HasSubstr("'shape': (0,), }"));
}

TEST(EncodeNpy, DataBeginsAtAMultipleOf64) {
  for (int64_t rows = 1; rows < 1'000'000'000'000'000'000; rows *= 10) {
    const std::string bytes = EncodeNpy({"any", "|u1", {rows, rows, rows}, ""});
    EXPECT_EQ(bytes.size() % 64, 0) << rows;
    EXPECT_EQ(bytes.back(), '\n');
  }
}

TEST(WriteNpz, ReplacesAFile) {
  const TempFolder folder;
  const std::string path = folder / "a.npz";
  ASSERT_THAT(WriteFileSynced(path, "no zip at all"), IsOk());
  ASSERT_THAT(WriteNpz(path, {{"one", "|u1", {4}, "abcd"}}), IsOk());
  EXPECT_THAT(*ReadFile(path), StartsWith("PK"));
}

TEST(WriteNpz, NamesTheFileThatCannotBeWritten) {
  const TempFolder folder;
  EXPECT_THAT(WriteNpz(folder / "none/a.npz", {{"one", "|u1", {4}, "abcd"}}),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("none/a.npz: No such file or directory")));
}

}  // namespace
}  // namespace craftfleet
