#include "deploy/cli/report/report_target.h"

#include <sys/stat.h>

#include <filesystem>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

const Report kReport = {{{"report.md", "# Report\n"}, {"runs.csv", "folder\n"}, {"curve.png", "picture"}}, 0};

// Opens and writes.
absl::StatusOr<int> WriteTo(const std::string& out) {
  absl::StatusOr<ReportTarget> target = ReportTarget::Open(out);
  return target.ok() ? target->Write(kReport) : target.status();
}

TEST(ReportTarget, CreatesAFolderWhenThereIsAReport) {
  const TempFolder folder;
  auto target = ReportTarget::Open(folder / "out/report");
  ASSERT_THAT(target, IsOk());
  EXPECT_FALSE(target->is_standard_output());
  EXPECT_THAT(ListFolder(folder.path()).value(), IsEmpty()) << "not before there is something to write";
  EXPECT_EQ(target->Write(kReport).value(), 3);
  EXPECT_THAT(ListFolder(folder / "out/report").value(), ElementsAre("curve.png", "report.md", "runs.csv"));
  for (const auto& [name, content] : kReport.files) {
    EXPECT_EQ(ReadFile(folder / ("out/report/" + name)).value(), content) << name;
  }
}

TEST(ReportTarget, ReplacesFilesAndKeepsLinksAndOthers) {
  const TempFolder folder;
  ASSERT_THAT(CreateFolders(folder / "report"), IsOk());
  for (const char* name : {"report/runs.csv", "report/notes.md", "kept.md"}) {
    ASSERT_THAT(WriteFileSynced(folder / name, "old"), IsOk());
  }
  fs::create_symlink("../kept.md", folder / "report/report.md");
  fs::create_directory_symlink("report", folder / "link");
  EXPECT_EQ(WriteTo(folder / "link").value(), 3);
  EXPECT_TRUE(fs::is_symlink(folder / "report/report.md"));
  EXPECT_EQ(ReadFile(folder / "kept.md").value(), "# Report\n");
  EXPECT_EQ(ReadFile(folder / "report/runs.csv").value(), "folder\n");
  EXPECT_EQ(ReadFile(folder / "report/notes.md").value(), "old");
}

TEST(ReportTarget, AStreamTakesThePageAlone) {
  const TempFolder folder;
  const std::string path = folder / "fifo";
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  std::string read;
  std::thread reader([&] { read = ReadFile(path).value(); });
  EXPECT_EQ(WriteTo(path).value(), 1);
  reader.join();
  EXPECT_EQ(read, "# Report\n");
  EXPECT_TRUE(fs::is_fifo(path));
}

TEST(ReportTarget, DashIsStandardOutput) {
  testing::internal::CaptureStdout();
  auto target = ReportTarget::Open("-");
  ASSERT_THAT(target, IsOk());
  EXPECT_TRUE(target->is_standard_output());
  EXPECT_EQ(target->Write(kReport).value(), 1);
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "# Report\n");
}

TEST(ReportTarget, WhatCanNotBeWrittenIsRefusedBeforeTheWork) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "file", "kept"), IsOk());
  ASSERT_THAT(CreateFolders(folder / "report/report.md"), IsOk());
  fs::create_symlink("nowhere", folder / "dangling");
  const auto want_folder = HasSubstr("is not a folder; want a folder, or - for standard output");
  for (const char* out : {"file", "file/report", "dangling", "dangling/report"}) {
    EXPECT_THAT(ReportTarget::Open(folder / out).status(),
                StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("--out: "), want_folder)))
        << out;
  }
  EXPECT_THAT(
      ReportTarget::Open(folder / "report").status(),
      StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("--out: "), HasSubstr("is a folder, want a file"))));
  EXPECT_EQ(ReadFile(folder / "file").value(), "kept");
}

TEST(ReportTarget, ReplacesNothingWhereAFileCanNotBeWritten) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "curve.png", "old"), IsOk());
  ASSERT_THAT(CreateFolders(folder / "runs.csv"), IsOk());
  EXPECT_THAT(WriteTo(folder.path()).status(),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("runs.csv is a folder")));
  EXPECT_EQ(ReadFile(folder / "curve.png").value(), "old");
}

}  // namespace
}  // namespace craftfleet
