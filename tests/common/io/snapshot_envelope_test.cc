#include "common/io/snapshot_envelope.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/env_name.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

const uint64_t kDigest = EnvDigest("crafter", 10000);

absl::Status Open(const std::string& sealed) { return OpenSnapshot(kDigest, sealed).status(); }

TEST(SnapshotEnvelope, OpenReturnsTheSealedGame) {
  for (const std::string& game : {std::string(), std::string("g"), std::string("\0ame", 4), std::string(20000, 'x')}) {
    EXPECT_EQ(OpenSnapshot(kDigest, SealSnapshot(kDigest, game)).value(), game);
  }
}

// Checkpoints contain snapshots: the layout must not change.
TEST(SnapshotEnvelope, LayoutIsFixed) {
  EXPECT_EQ(SealSnapshot(0x0102030405060708, "123456789"),
            std::string("CFSNAP\x01\0\x08\x07\x06\x05\x04\x03\x02\x01\x09\0\0\0\x83\x92\x06\xe3", 24) + "123456789");
  EXPECT_EQ(kDigest, 0x602e3b879825f52cU);
}

TEST(SnapshotEnvelope, AcceptsSizesUpToTheLimit) {
  const size_t head = SealSnapshot(kDigest, "").size();
  EXPECT_THAT(Open(SealSnapshot(kDigest, std::string(kMaxSnapshotBytes - head, 'x'))), IsOk());
  EXPECT_THAT(Open(SealSnapshot(kDigest, std::string(kMaxSnapshotBytes - head + 1, 'x'))),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("114689 bytes, want at most 114688")));
}

TEST(SnapshotEnvelope, SnapshotOfAnotherEnvironmentIsRefused) {
  for (const uint64_t other : {EnvDigest("crafter", 9999), EnvDigest("crafter:numbers=easy-x2", 10000)}) {
    EXPECT_THAT(Open(SealSnapshot(other, "game")),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a world with other options")));
  }
}

TEST(SnapshotEnvelope, WorldNameLeavesOutPictureOptions) {
  const EnvName bare = EnvName::Parse("crafter:inventory=off,numbers=easy-x2").value();
  EXPECT_EQ(bare.WorldName(), EnvName::Parse("crafter:numbers=easy-x2").value().ToString());
}

TEST(SnapshotEnvelope, EveryChangedByteAndTruncationIsRefused) {
  const std::string sealed = SealSnapshot(kDigest, "a game of some length");
  for (size_t at = 0; at < sealed.size(); ++at) {
    for (int bit = 0; bit < 8; ++bit) {
      std::string wrong = sealed;
      wrong[at] = static_cast<char>(wrong[at] ^ (1 << bit));
      EXPECT_THAT(Open(wrong), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("snapshot: "))) << at;
    }
    EXPECT_THAT(Open(sealed.substr(0, at)), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("snapshot: ")));
  }
  EXPECT_THAT(Open(sealed + "x"), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("its envelope says 21")));
}

TEST(SnapshotEnvelope, AnEmptySnapshotIsValid) {
  EXPECT_THAT(CheckSnapshot(kDigest, ""), IsOk());
  EXPECT_THAT(CheckSnapshot(kDigest, "CFWORLD"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("7 bytes without an envelope")));
}

}  // namespace
}  // namespace craftfleet
