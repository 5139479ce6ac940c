#include "deploy/cli/doctor/machine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "common/wire/listen_socket.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

constexpr char kMaps[] =
    "55d0-55d1 r-xp 00000000 fe:01 12 /opt/libblas/bin/craftfleet-doctor\n"
    "7f00-7f01 rw-p 00000000 00:00 0\n"
    "7f02-7f03 r-xp 00000000 fe:01 13 /usr/lib/x86_64-linux-gnu/openblas-pthread/libopenblas.so.0\n"
    "7f04-7f05 r-xp 00000000 fe:01 14 /usr/lib/libtorch_cpu.so\n";

TEST(DoctorMachine, ALoadedLibraryIsFoundByItsOwnName) {
  EXPECT_EQ(MappedFile(kMaps, {"libblas", "libopenblas"}),
            "/usr/lib/x86_64-linux-gnu/openblas-pthread/libopenblas.so.0");
  EXPECT_EQ(MappedFile(kMaps, {"libtorch_cuda"}), "");
}

TEST(DoctorMachine, MemoryIsThatWhichTheKernelCallsAvailable) {
  EXPECT_EQ(AvailableMemory("MemTotal:       16000000 kB\nMemAvailable:    8000000 kB\n"), 8000000LL * 1024);
  EXPECT_EQ(AvailableMemory(""), 0);
}

TEST(DoctorMachine, AMissingFolderIsMeasuredAtItsNearestParent) {
  const TempFolder folder;
  const DiskFacts disk = MeasureDisk(folder / "runs/first");
  EXPECT_EQ(disk.folder, folder.path());
  ASSERT_THAT(disk.free.status(), IsOk());
  EXPECT_GT(*disk.free, 0);
  ASSERT_THAT(disk.sync.status(), IsOk());
  EXPECT_GT(*disk.sync, absl::ZeroDuration());
  EXPECT_THAT(ListFolder(folder.path()).value(), IsEmpty());
}

TEST(DoctorMachine, AFolderThatCantBeWrittenIsAnError) {
  const DiskFacts disk = MeasureDisk("/proc");
  EXPECT_THAT(disk.sync.status().message(), HasSubstr("/proc/.craftfleet-doctor-"));
}

TEST(DoctorMachine, APortInUseIsNotFree) {
  const auto socket = wire::ListenSocket::Create("127.0.0.1:0");
  ASSERT_THAT(socket.status(), IsOk());
  const std::string address = (*socket)->address();
  EXPECT_THAT(TryPort(address), StatusIs(absl::StatusCode::kUnavailable, HasSubstr(address)));
  EXPECT_THAT(TryPort("127.0.0.1:0"), IsOk());
}

TEST(DoctorMachine, ThisMachineHasALimitOfOpenFilesAndVersions) {
  EXPECT_GT(ReadOpenFilesLimit(), 0u);
  EXPECT_GT(ReadAvailableMemory(), 0);
  EXPECT_GE(ReadCpu().threads, 1);
  for (const auto& [name, version] : ReadVersions()) EXPECT_FALSE(version.empty()) << name;
}

}  // namespace
}  // namespace craftfleet
