#include "deploy/cli/doctor_checks.h"

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"
#include "common/wire/certificates.h"

namespace craftfleet {
namespace {

constexpr int64_t kMiB = int64_t{1} << 20;
constexpr int64_t kGiB = int64_t{1} << 30;

std::string Size(int64_t bytes) {
  if (bytes < kGiB) return absl::StrFormat("%d MiB", bytes / kMiB);
  return absl::StrFormat("%.1f GiB", static_cast<double>(bytes) / kGiB);
}

// By two limits: below `fail` it fails, below `warn` it warns.
template <typename T>
Verdict JudgeLeast(T value, T warn, T fail) {
  if (value < fail) return Verdict::kFail;
  return value < warn ? Verdict::kWarn : Verdict::kOk;
}

Finding Ok(std::string check, std::string found) { return {std::move(check), Verdict::kOk, std::move(found), ""}; }

// The finding, without the remedy where nothing is to be done.
Finding Judged(std::string check, Verdict verdict, std::string found, std::string remedy) {
  if (verdict == Verdict::kOk) remedy.clear();
  return {std::move(check), verdict, std::move(found), std::move(remedy)};
}

}  // namespace

Finding CheckCpuFeatures(const std::string& description, bool avx2, bool avx512, int threads) {
  const std::string found = absl::StrFormat("%s; %d threads", description, threads);
  if (!avx2) {
    return {"CPU", Verdict::kWarn, absl::StrCat(found, "; no AVX2"),
            "networks run several times slower than with AVX2, and --cpu=avx2 is refused: use a newer CPU, or a "
            "virtual machine that exposes the features of its host"};
  }
  return Ok("CPU", absl::StrCat(found, avx512 ? "; AVX2 and AVX-512" : "; AVX2, no AVX-512"));
}

Finding CheckBlas(const std::string& library, const std::string& slow_warning) {
  const std::string found = library.empty() ? "built into LibTorch" : library;
  if (!slow_warning.empty()) return {"BLAS", Verdict::kFail, found, slow_warning};
  return Ok("BLAS", found);
}

Finding CheckMemory(int64_t available) {
  return Judged(
      "memory", JudgeLeast(available, 2 * kGiB, 512 * kMiB), absl::StrCat(Size(available), " available"),
      "a learner of ppo_cnn needs about 0.5 GiB, large agents several times that: end other programs, or raise "
      "the container's limit");
}

Finding CheckOpenFiles(uint64_t limit) {
  return Judged("open files", JudgeLeast<uint64_t>(limit, 4096, 256), absl::StrFormat("at most %d", limit),
                "each connection is an open file: raise the hard limit (ulimit -Hn, LimitNOFILE of systemd, --ulimit "
                "nofile of Docker)");
}

Finding CheckDiskSpace(const std::string& folder, const absl::StatusOr<int64_t>& free) {
  if (!free.ok()) {
    return {"disk space", Verdict::kFail, std::string(free.status().message()), "give another --logdir"};
  }
  return Judged("disk space", JudgeLeast(*free, 2 * kGiB, 256 * kMiB),
                absl::StrFormat("%s free in %s", Size(*free), folder),
                "a run keeps four checkpoints: free some space, lower --keep_checkpoints, or give another --logdir");
}

Finding CheckDiskSync(const std::string& folder, const absl::StatusOr<absl::Duration>& sync) {
  if (!sync.ok()) {
    return {"disk speed", Verdict::kFail, std::string(sync.status().message()),
            "give a --logdir that this user can write to"};
  }
  const double seconds = absl::ToDoubleSeconds(*sync);
  const Verdict verdict = seconds >= 5 ? Verdict::kFail : seconds >= 0.1 ? Verdict::kWarn : Verdict::kOk;
  return Judged("disk speed", verdict,
                absl::StrFormat("1 MiB written and synced in %.1f ms in %s", 1000 * seconds, folder),
                "every checkpoint waits for this disk: give a --logdir on a local one, or raise --checkpoint_every");
}

Finding CheckClock(const ClockFacts& clock) {
  const std::string now = absl::FormatTime("%Y-%m-%d %H:%M:%S UTC", clock.now, absl::UTCTimeZone());
  const char* remedy =
      "set the clock and synchronise it with systemd-timesyncd or chrony: certificates and logs depend on it";
  if (clock.now < clock.program_built - absl::Hours(24)) {
    return {"clock", Verdict::kFail, absl::StrCat(now, " is before this program was installed"), remedy};
  }
  if (!clock.synchronized.has_value()) return Ok("clock", now);
  if (!*clock.synchronized) return {"clock", Verdict::kWarn, absl::StrCat(now, "; not synchronised"), remedy};
  return Ok("clock", absl::StrCat(now, "; synchronised"));
}

std::string DescribeGpu(int number, const GpuUsage& usage) {
  std::string text = absl::StrCat("GPU ", number, ": ", usage.name, ", ", Size(usage.memory_total_bytes));
  if (usage.capability > 0) absl::StrAppend(&text, ", compute capability ", CapabilityText(usage.capability));
  return text;
}

Finding CheckGpu(const GpuFacts& gpu) {
  const std::string devices = absl::StrJoin(gpu.devices, "; ");
  if (gpu.usable > 0) {
    const std::string listed = devices.empty() ? "" : absl::StrCat(" (", devices, ")");
    return Ok("GPU", absl::StrCat(gpu.usable, " usable by LibTorch", listed));
  }
  if (devices.empty()) {
    return Ok("GPU", gpu.libtorch_has_cuda ? "none; LibTorch has CUDA" : "none; LibTorch has no CUDA");
  }
  if (!gpu.libtorch_has_cuda) {
    return {"GPU", Verdict::kWarn, absl::StrCat(devices, ", but this LibTorch has no CUDA"),
            "updates run on the CPU: build with -DCRAFTFLEET_LIBTORCH=DIR, a LibTorch that has CUDA"};
  }
  return {"GPU", Verdict::kFail, absl::StrCat(devices, ", but LibTorch sees no GPU"),
          "look at nvidia-smi: the driver must be as new as LibTorch's CUDA, and this user must be allowed to use the "
          "device"};
}

Finding CheckPort(const std::string& address, const absl::Status& bound) {
  const std::string check = absl::StrCat("port ", address);
  if (bound.ok()) return Ok(check, "free");
  return {check, Verdict::kFail, std::string(bound.message()),
          "end the program that has the port (ss -ltnp names it), or give another address with --listen"};
}

Finding CheckTls(const wire::TlsFiles& tls, absl::Time now) {
  constexpr absl::Duration kSoon = absl::Hours(24 * 30);
  const char* remedy = "deploy/make-certs.sh makes an authority and certificates; give all of them to every process";
  const auto read = [&]() -> absl::Status {
    if (tls.certificate.empty() != tls.key.empty()) {
      return absl::InvalidArgumentError("--tls_cert and --tls_key: want both or neither");
    }
    if (!tls.authorities.empty()) CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAuthorities(tls.authorities));
    return tls.certificate.empty() ? absl::OkStatus() : wire::CheckKeyPair(tls.certificate, tls.key);
  };
  if (const absl::Status status = read(); !status.ok()) {
    return {"TLS files", Verdict::kFail, std::string(status.message()), remedy};
  }
  if (tls.certificate.empty()) return Ok("TLS files", absl::StrCat(tls.authorities, ": readable"));
  const std::string problem = wire::CertificateProblem(tls.certificate, tls.authorities, now);
  if (!problem.empty()) return {"TLS files", Verdict::kFail, problem, remedy};
  if (!wire::CertificateProblem(tls.certificate, tls.authorities, now + kSoon).empty()) {
    return {"TLS files", Verdict::kWarn, absl::StrCat(tls.certificate, " expires within 30 days"),
            "replace it: running processes read the new file within seconds"};
  }
  return Ok("TLS files", absl::StrCat(tls.certificate, ": fits its key, valid for 30 days and more"));
}

}  // namespace craftfleet
