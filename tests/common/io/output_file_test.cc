#include "common/io/output_file.h"

#include <fcntl.h>
#include <sys/mount.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <string>
#include <thread>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/plain_user.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

// Opens `path` and writes `bytes` to it.
absl::Status WriteTo(const std::string& path, absl::string_view bytes) {
  absl::StatusOr<OutputFile> file = OutputFile::Open("--out", path);
  return file.ok() ? file->Write(bytes) : file.status();
}

// The standard output, redirected to the file `output`, of a program that prints "text\n" and then writes `bytes` to
// `path`.
std::string Printed(const std::string& output, const std::string& path, absl::string_view bytes) {
  std::fflush(stdout);
  const int before = dup(STDOUT_FILENO);
  const int file = open(output.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  dup2(file, STDOUT_FILENO);
  close(file);
  absl::StatusOr<OutputFile> out = OutputFile::Open("--out", path);
  std::puts("text");
  const absl::Status status = out.ok() ? out->Write(bytes) : out.status();
  const bool standard = out.ok() && out->is_standard_output();
  std::fflush(stdout);
  dup2(before, STDOUT_FILENO);
  close(before);
  EXPECT_THAT(status, IsOk());
  EXPECT_TRUE(standard);
  return ReadFile(output).value();
}

TEST(OutputFile, AFileBesideItIsNotTouched) {
  const TempFolder folder;
  const std::string long_name(255, 'a');  // as long as a name may be
  for (const std::string& name : {std::string("a.png"), long_name}) {
    ASSERT_THAT(WriteFileSynced(folder / "a.png.tmp", "mine"), IsOk());
    EXPECT_THAT(WriteTo(folder / name, "bytes"), IsOk());
    EXPECT_EQ(ReadFile(folder / name).value(), "bytes");
    EXPECT_EQ(ReadFile(folder / "a.png.tmp").value(), "mine");
  }
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("a.png", "a.png.tmp", long_name));
}

TEST(OutputFile, CreatesAFileOrReplacesIt) {
  const TempFolder folder;
  const std::string path = folder / "a.png";
  auto file = OutputFile::Open("--out", path);
  ASSERT_THAT(file, IsOk());
  EXPECT_FALSE(PathExists(path)) << "not created before the first write";
  EXPECT_FALSE(file->is_standard_output());
  ASSERT_THAT(file->Write("a long first text"), IsOk());
  EXPECT_EQ(ReadFile(path).value(), "a long first text");
  ASSERT_THAT(WriteTo(path, "second"), IsOk());
  EXPECT_EQ(ReadFile(path).value(), "second");
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("a.png"));
}

TEST(OutputFile, KeepsTheOldFileUntilWrite) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "a", "old"), IsOk());
  { ASSERT_THAT(OutputFile::Open("--out", folder / "a"), IsOk()); }
  EXPECT_EQ(ReadFile(folder / "a").value(), "old");
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("a"));
}

// A file of root in a folder like /tmp.
TEST(OutputFile, OverwritesAFileThatMayNotBeReplaced) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can make a file of another user";
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "a", "a long old text"), IsOk());
  ASSERT_EQ(chmod((folder / "a").c_str(), 0666), 0);
  ASSERT_EQ(chmod(folder.path().c_str(), 01777), 0);
  {
    const PlainUser user;
    EXPECT_THAT(ReplaceFile(folder / "a", "new"), StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("rename")));
    EXPECT_THAT(WriteTo(folder / "a", "new"), IsOk());
  }
  EXPECT_EQ(ReadFile(folder / "a").value(), "new");
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("a"));
}

TEST(OutputFile, OverwritesAMountedFile) {
  const TempFolder folder;
  for (const char* name : {"a", "mounted"}) ASSERT_THAT(WriteFileSynced(folder / name, "a long old text"), IsOk());
  if (mount((folder / "mounted").c_str(), (folder / "a").c_str(), nullptr, MS_BIND, nullptr) != 0) {
    GTEST_SKIP() << "only root can mount";
  }
  EXPECT_THAT(WriteTo(folder / "a", "new"), IsOk());
  EXPECT_EQ(umount((folder / "a").c_str()), 0);
  EXPECT_EQ(ReadFile(folder / "mounted").value(), "new");
  EXPECT_EQ(ReadFile(folder / "a").value(), "a long old text");
  EXPECT_THAT(ListFolder(folder.path()).value(), ElementsAre("a", "mounted"));
}

TEST(OutputFile, FollowsLinks) {
  const TempFolder folder;
  ASSERT_THAT(CreateFolders(folder / "real"), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "real/a", "old"), IsOk());
  fs::create_symlink("real/a", folder / "relative");
  fs::create_symlink(folder / "relative", folder / "twice");
  fs::create_symlink("real/none_yet", folder / "dangling");
  ASSERT_THAT(WriteTo(folder / "twice", "new"), IsOk());
  EXPECT_EQ(ReadFile(folder / "real/a").value(), "new");
  ASSERT_THAT(WriteTo(folder / "dangling", "made"), IsOk());
  EXPECT_EQ(ReadFile(folder / "real/none_yet").value(), "made");
  for (const char* link : {"relative", "twice", "dangling"}) EXPECT_TRUE(fs::is_symlink(folder / link)) << link;

  fs::create_symlink("round", folder / "round");
  EXPECT_THAT(WriteTo(folder / "round", "x"), StatusIs(absl::StatusCode::kUnknown, HasSubstr("symbolic links")));
}

TEST(OutputFile, WritesToAFifo) {
  const TempFolder folder;
  const std::string path = folder / "fifo";
  ASSERT_EQ(mkfifo(path.c_str(), 0644), 0);
  std::string read;
  std::thread reader([&] { read = ReadFile(path).value(); });
  EXPECT_THAT(WriteTo(path, "bytes"), IsOk());
  reader.join();
  EXPECT_EQ(read, "bytes");
  EXPECT_TRUE(fs::is_fifo(path));
}

TEST(OutputFile, WritesToDevices) {
  EXPECT_THAT(WriteTo("/dev/null", "x"), IsOk());
  EXPECT_TRUE(fs::is_character_file("/dev/null"));
  EXPECT_THAT(WriteTo("/dev/full", "x"),
              StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr("--out: "), HasSubstr("/dev/full"))));
  EXPECT_TRUE(fs::is_character_file("/dev/full"));
}

TEST(OutputFile, BytesFollowPrintedTextOnStandardOutput) {
  const TempFolder folder;
  const std::string output = folder / "output";
  for (const std::string& path : {std::string("-"), std::string("/dev/stdout"), std::string("/dev/fd/1"), output}) {
    EXPECT_EQ(Printed(output, path, "bytes"), "text\nbytes") << path;
  }
}

TEST(OutputFile, WritesToAnOpenDescriptor) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  ASSERT_THAT(WriteTo("/dev/fd/" + std::to_string(ends[1]), "bytes"), IsOk());
  char read_back[5];
  EXPECT_EQ(read(ends[0], read_back, sizeof read_back), 5);
  EXPECT_EQ(std::string(read_back, 5), "bytes");
  close(ends[0]);
  close(ends[1]);
}

TEST(OutputFile, OpenRefusesTargetsThatCannotBeWritten) {
  const TempFolder folder;
  EXPECT_THAT(OutputFile::Open("--json", folder.path()),
              StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("--json: "), HasSubstr("is a folder"))));
  EXPECT_THAT(OutputFile::Open("--out", folder / "none/a"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr(folder / "none/a")));
  ASSERT_THAT(WriteFileSynced(folder / "file", ""), IsOk());
  EXPECT_THAT(OutputFile::Open("--out", folder / "file/a"), testing::Not(IsOk()));
  EXPECT_THAT(OutputFile::Open("--out", "/proc/none"), testing::Not(IsOk()));
  EXPECT_THAT(OutputFile::Open("--out", "/dev/fd/999"), testing::Not(IsOk()));

  const int server = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  const std::string path = folder / "socket";
  ASSERT_LT(path.size(), sizeof address.sun_path);
  path.copy(address.sun_path, path.size());
  ASSERT_EQ(bind(server, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  EXPECT_THAT(OutputFile::Open("--out", path), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a socket")));
  close(server);
}

TEST(OutputFile, OpenRefusesTargetsWithoutPermission) {
  if (geteuid() == 0) GTEST_SKIP() << "root may do everything";
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "a", "kept"), IsOk());
  chmod((folder / "a").c_str(), 0444);
  EXPECT_THAT(OutputFile::Open("--out", folder / "a"),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("--out")));
  chmod(folder.path().c_str(), 0555);
  EXPECT_THAT(OutputFile::Open("--out", folder / "b"),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("--out")));
  chmod(folder.path().c_str(), 0755);
}

}  // namespace
}  // namespace craftfleet
