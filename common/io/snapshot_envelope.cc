#include "common/io/snapshot_envelope.h"

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/crc32c.h"
#include "common/base/fnv1a.h"
#include "common/base/little_endian.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kMagic = "CFSNAP";
constexpr uint16_t kVersion = 1;
constexpr size_t kHeadBytes = 6 + 2 + 8 + 4 + 4;

// Removes a number from the front of `rest`, which is long enough.
template <typename T>
T Take(absl::string_view* rest) {
  const T value = FromLittleEndian<T>(rest->substr(0, sizeof(T)));
  rest->remove_prefix(sizeof(T));
  return value;
}

template <typename... Args>
absl::Status Wrong(const absl::FormatSpec<Args...>& format, const Args&... args) {
  return absl::InvalidArgumentError(absl::StrFormat(format, args...));
}

}  // namespace

uint64_t EnvDigest(absl::string_view world_name, int64_t length) {
  return Fnv1a(kFnv1aBasis, absl::StrCat(world_name, " length=", length));
}

std::string SealSnapshot(uint64_t env_digest, absl::string_view game) {
  std::string sealed(kMagic);
  AppendLittleEndian(kVersion, &sealed);
  AppendLittleEndian(env_digest, &sealed);
  AppendLittleEndian(static_cast<uint32_t>(game.size()), &sealed);
  AppendLittleEndian(Crc32c(game), &sealed);
  sealed.append(game.data(), game.size());
  return sealed;
}

absl::StatusOr<absl::string_view> OpenSnapshot(uint64_t env_digest, absl::string_view sealed) {
  if (sealed.size() > kMaxSnapshotBytes) {
    return Wrong("snapshot: %d bytes, want at most %d", sealed.size(), kMaxSnapshotBytes);
  }
  if (!absl::StartsWith(sealed, kMagic) || sealed.size() < kHeadBytes) {
    return Wrong("snapshot: %d bytes without an envelope, want one of %d bytes that begins with \"%s\"", sealed.size(),
                 kHeadBytes, kMagic);
  }
  absl::string_view rest = sealed.substr(kMagic.size());
  const auto version = Take<uint16_t>(&rest);
  const auto digest = Take<uint64_t>(&rest);
  const auto size = Take<uint32_t>(&rest);
  const auto checksum = Take<uint32_t>(&rest);
  if (version != kVersion) return Wrong("snapshot: envelope of version %d, want %d", version, kVersion);
  if (digest != env_digest) {
    return Wrong("snapshot: of a world with other options, digest %016x, want %016x", digest, env_digest);
  }
  if (size != rest.size()) return Wrong("snapshot: a game of %d bytes, its envelope says %d", rest.size(), size);
  if (checksum != Crc32c(rest)) {
    return Wrong("snapshot: a game with checksum %08x, its envelope says %08x", Crc32c(rest), checksum);
  }
  return rest;
}

absl::Status CheckSnapshot(uint64_t env_digest, absl::string_view sealed) {
  return sealed.empty() ? absl::OkStatus() : OpenSnapshot(env_digest, sealed).status();
}

}  // namespace craftfleet
