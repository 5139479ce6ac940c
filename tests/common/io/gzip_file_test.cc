#include "common/io/gzip_file.h"

#include <zlib.h>

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Large enough for several reads of the buffer.
std::string SampleText() {
  std::string text;
  for (int i = 0; i < 50'000; ++i) text += std::to_string(i * 7919 % 50'021);
  return text;
}

void WriteGzip(const std::string& path, const std::string& text) {
  const gzFile file = gzopen(path.c_str(), "wb");
  ASSERT_EQ(gzwrite(file, text.data(), text.size()), static_cast<int>(text.size()));
  ASSERT_EQ(gzclose(file), Z_OK);
}

TEST(ReadGzipFile, UnpacksGzipAndReadsPlainFilesUnchanged) {
  const TempFolder folder;
  const std::string text = SampleText();
  WriteGzip(folder / "a.gz", text);
  EXPECT_EQ(ReadGzipFile(folder / "a.gz").value(), text);
  ASSERT_THAT(WriteFileSynced(folder / "a", text), IsOk());
  EXPECT_EQ(ReadGzipFile(folder / "a").value(), text);
  ASSERT_THAT(WriteFileSynced(folder / "empty", ""), IsOk());
  EXPECT_EQ(ReadGzipFile(folder / "empty").value(), "");
}

TEST(ReadGzipFile, ReportsTruncatedAndDamagedFilesByName) {
  const TempFolder folder;
  WriteGzip(folder / "a.gz", SampleText());
  const std::string whole = ReadFile(folder / "a.gz").value();
  const auto data_loss = StatusIs(absl::StatusCode::kDataLoss, HasSubstr("a.gz: cut or damaged"));
  ASSERT_THAT(WriteFileSynced(folder / "a.gz", whole.substr(0, whole.size() / 2)), IsOk());
  EXPECT_THAT(ReadGzipFile(folder / "a.gz"), data_loss);
  std::string damaged = whole;
  damaged[whole.size() / 2] ^= 0x55;
  ASSERT_THAT(WriteFileSynced(folder / "a.gz", damaged), IsOk());
  EXPECT_THAT(ReadGzipFile(folder / "a.gz"), data_loss);
}

TEST(ReadGzipFile, ReportsAMissingFile) {
  const TempFolder folder;
  EXPECT_THAT(ReadGzipFile(folder / "none.gz"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("/none.gz")));
}

}  // namespace
}  // namespace craftfleet
