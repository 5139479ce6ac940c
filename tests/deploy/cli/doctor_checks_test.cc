#include "deploy/cli/doctor_checks.h"

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"

namespace craftfleet {
namespace doctor_checks_test {

using testing::AllOf;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr int64_t kMiB = int64_t{1} << 20;
constexpr int64_t kGiB = int64_t{1} << 30;
const absl::Time kNow = absl::FromUnixSeconds(1'800'000'000);

testing::Matcher<Finding> IsOk(const std::string& found) {
  return AllOf(Field("verdict", &Finding::verdict, Verdict::kOk), Field("found", &Finding::found, HasSubstr(found)),
               Field("remedy", &Finding::remedy, IsEmpty()));
}

testing::Matcher<Finding> Is(Verdict verdict, const std::string& found, const std::string& remedy) {
  return AllOf(Field("verdict", &Finding::verdict, verdict), Field("found", &Finding::found, HasSubstr(found)),
               Field("remedy", &Finding::remedy, HasSubstr(remedy)));
}

testing::Matcher<Finding> Warns(const std::string& found, const std::string& remedy) {
  return Is(Verdict::kWarn, found, remedy);
}

testing::Matcher<Finding> Fails(const std::string& found, const std::string& remedy) {
  return Is(Verdict::kFail, found, remedy);
}

TEST(DoctorChecks, ACpuWithoutAvx2IsSlow) {
  EXPECT_THAT(CheckCpuFeatures("AMD EPYC, AVX512", true, true, 8),
              IsOk("AMD EPYC, AVX512; 8 threads; AVX2 and AVX-512"));
  EXPECT_THAT(CheckCpuFeatures("AMD EPYC, AVX2", true, false, 8), IsOk("AVX2, no AVX-512"));
  EXPECT_THAT(CheckCpuFeatures("QEMU, plain", false, false, 1), Warns("no AVX2", "virtual machine"));
}

TEST(DoctorChecks, TheReferenceBlasFails) {
  EXPECT_THAT(CheckBlas("/usr/lib/libopenblas.so.0", ""), IsOk("/usr/lib/libopenblas.so.0"));
  EXPECT_THAT(CheckBlas("", ""), IsOk("built into LibTorch"));
  EXPECT_THAT(CheckBlas("/usr/lib/libblas.so.3", "install libopenblas0-pthread"),
              Fails("/usr/lib/libblas.so.3", "install libopenblas0-pthread"));
}

TEST(DoctorChecks, MemoryHasTwoLimits) {
  EXPECT_THAT(CheckMemory(2 * kGiB), IsOk("2.0 GiB available"));
  EXPECT_THAT(CheckMemory(2 * kGiB - 1), Warns("2.0 GiB", "0.5 GiB"));
  EXPECT_THAT(CheckMemory(512 * kMiB), Warns("512 MiB", "0.5 GiB"));
  EXPECT_THAT(CheckMemory(511 * kMiB), Fails("511 MiB", "0.5 GiB"));
}

TEST(DoctorChecks, OpenFilesHaveTwoLimits) {
  EXPECT_THAT(CheckOpenFiles(4096), IsOk("at most 4096"));
  EXPECT_THAT(CheckOpenFiles(4095), Warns("4095", "LimitNOFILE"));
  EXPECT_THAT(CheckOpenFiles(256), Warns("256", "LimitNOFILE"));
  EXPECT_THAT(CheckOpenFiles(255), Fails("255", "ulimit -Hn"));
}

TEST(DoctorChecks, AFullDiskFails) {
  EXPECT_THAT(CheckDiskSpace("/runs", 2 * kGiB), IsOk("2.0 GiB free in /runs"));
  EXPECT_THAT(CheckDiskSpace("/runs", kGiB), Warns("1.0 GiB", "--keep_checkpoints"));
  EXPECT_THAT(CheckDiskSpace("/runs", 255 * kMiB), Fails("255 MiB", "--logdir"));
  EXPECT_THAT(CheckDiskSpace("/runs", absl::NotFoundError("look at /runs: gone")),
              Fails("look at /runs: gone", "--logdir"));
}

TEST(DoctorChecks, ASlowDiskWarnsOrFails) {
  EXPECT_THAT(CheckDiskSync("/runs", absl::Milliseconds(99)), IsOk("99.0 ms in /runs"));
  EXPECT_THAT(CheckDiskSync("/runs", absl::Milliseconds(100)), Warns("100.0 ms", "--checkpoint_every"));
  EXPECT_THAT(CheckDiskSync("/runs", absl::Seconds(5)), Fails("5000.0 ms", "local one"));
  EXPECT_THAT(CheckDiskSync("/runs", absl::PermissionDeniedError("write /runs/x: no")),
              Fails("write /runs/x: no", "can write"));
}

TEST(DoctorChecks, AClockBeforeTheProgramFails) {
  EXPECT_THAT(CheckClock({kNow, kNow - absl::Hours(1), true}), IsOk("2027-01-15 08:00:00 UTC; synchronised"));
  EXPECT_THAT(CheckClock({kNow, kNow + absl::Hours(23), std::nullopt}), IsOk("2027-01-15 08:00:00 UTC"));
  EXPECT_THAT(CheckClock({kNow, kNow, false}), Warns("not synchronised", "chrony"));
  EXPECT_THAT(CheckClock({kNow, kNow + absl::Hours(25), true}), Fails("before this program", "set the clock"));
}

TEST(DoctorChecks, AGpuNeedsALibtorchWithCuda) {
  EXPECT_THAT(CheckGpu({{}, false, 0}), IsOk("none; LibTorch has no CUDA"));
  EXPECT_THAT(CheckGpu({{}, true, 0}), IsOk("none; LibTorch has CUDA"));
  EXPECT_THAT(CheckGpu({{"/dev/nvidia0", "/dev/nvidia1"}, true, 2}),
              IsOk("2 usable by LibTorch (/dev/nvidia0; /dev/nvidia1)"));
  EXPECT_THAT(CheckGpu({{}, true, 1}), IsOk("1 usable by LibTorch"));
  EXPECT_THAT(CheckGpu({{"/dev/nvidia0"}, false, 0}), Warns("has no CUDA", "-DCRAFTFLEET_LIBTORCH=DIR"));
  EXPECT_THAT(CheckGpu({{"/dev/nvidia0"}, true, 0}), Fails("sees no GPU", "nvidia-smi"));
}

TEST(DoctorChecks, AGpuIsDescribedAsFarAsTheDriverKnowsIt) {
  GpuUsage usage = {"NVIDIA H100", 0, int64_t{80} << 30, 0, 90};
  EXPECT_EQ(DescribeGpu(0, usage), "GPU 0: NVIDIA H100, 80.0 GiB, compute capability 9.0");
  usage.capability = 0;
  EXPECT_EQ(DescribeGpu(1, usage), "GPU 1: NVIDIA H100, 80.0 GiB");
}

TEST(DoctorChecks, APortInUseFails) {
  EXPECT_THAT(CheckPort("127.0.0.1:50051", absl::OkStatus()), IsOk("free"));
  EXPECT_THAT(CheckPort("127.0.0.1:50051", absl::UnavailableError("127.0.0.1:50051: Address already in use")),
              AllOf(Fails("already in use", "--listen"), Field("check", &Finding::check, "port 127.0.0.1:50051")));
}

class DoctorTlsTest : public testing::Test {
 protected:
  wire::TlsFiles Files(const std::string& name) const {
    return {folder_ / (name + ".pem"), folder_ / (name + ".key"), folder_ / "ca.pem"};
  }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
};

TEST_F(DoctorTlsTest, DatesAreChecked) {
  constexpr int64_t kDay = 24 * 3600;
  ca_.Issue("long", {"learner", 1, true, -3600, 365 * kDay});
  ca_.Issue("short", {"learner", 2, true, -3600, 29 * kDay});
  ca_.Issue("past", {"learner", 3, true, -7200, -3600});
  EXPECT_THAT(CheckTls(Files("long"), absl::Now()), IsOk("valid for 30 days and more"));
  EXPECT_THAT(CheckTls(Files("short"), absl::Now()), Warns("expires within 30 days", "replace it"));
  EXPECT_THAT(CheckTls(Files("past"), absl::Now()), Fails("expired on", "make-certs.sh"));
}

TEST_F(DoctorTlsTest, FilesMustMatch) {
  ca_.Issue("a", {"a"});
  ca_.Issue("b", {"b"});
  TestAuthority other(folder_, "other");
  other.Issue("stranger", {"stranger", 1, true, -3600, 365 * 24 * 3600});
  wire::TlsFiles files = Files("a");
  files.key = Files("b").key;
  EXPECT_THAT(CheckTls(files, absl::Now()), Fails("is not the key of", "make-certs.sh"));
  files.key.clear();
  EXPECT_THAT(CheckTls(files, absl::Now()), Fails("want both or neither", "make-certs.sh"));
  EXPECT_THAT(CheckTls(Files("away"), absl::Now()), Fails("away.pem", "make-certs.sh"));
  EXPECT_THAT(CheckTls(Files("stranger"), absl::Now()), Fails("is not from an authority", "make-certs.sh"));
  EXPECT_THAT(CheckTls({"", "", folder_ / "ca.pem"}, absl::Now()), IsOk("readable"));
  EXPECT_THAT(CheckTls({"", "", folder_ / "a.key"}, absl::Now()), Fails("no certificate in it", "make-certs.sh"));
}

}  // namespace doctor_checks_test
}  // namespace craftfleet
