#include "common/wire/packed_frames.h"

#include <random>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace wire {
namespace {

using testing::HasSubstr;

std::string Noise(size_t size) {
  std::mt19937 random(7);
  std::string bytes(size, '\0');
  for (char& byte : bytes) byte = static_cast<char>(random());
  return bytes;
}

// Pixels that a game might draw: runs of one colour, and some noise.
std::string Picture(size_t size) {
  std::string picture(size, 'g');
  return picture.replace(size / 2, size / 8, Noise(size / 8));
}

TEST(PackedFrames, ComeBack) {
  for (const size_t size : {0, 1, 2, 3, 12, 13, 100, 12288, 1 << 20}) {
    for (const std::string& frames : {Picture(size), Noise(size), std::string(size, '\0')}) {
      std::string packed = frames;
      PackFrames(&packed);
      EXPECT_LE(packed.size(), size);
      ASSERT_THAT(UnpackFrames(size, &packed), IsOk()) << size;
      EXPECT_TRUE(packed == frames) << size;
    }
  }
}

TEST(PackedFrames, AreShorterThanPictures) {
  std::string packed = Picture(12288);
  PackFrames(&packed);
  EXPECT_LT(packed.size(), 3000u);
}

TEST(PackedFrames, OfAnotherSizeAreRefused) {
  const std::string frames = Picture(12288);
  std::string packed = frames;
  PackFrames(&packed);
  for (const size_t size : {size_t{0}, size_t{100}, packed.size() - 1, frames.size() - 1, frames.size() + 1,
                            2 * frames.size(), size_t{1} << 40}) {
    std::string copy = packed;
    EXPECT_THAT(UnpackFrames(size, &copy), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("LZ4"))) << size;
  }
}

// Whatever arrives, memory is not read or written beyond its bounds (checked by the sanitizers).
TEST(PackedFrames, DamagedOnesGiveAnErrorOrOtherPixels) {
  const std::string frames = Picture(4096);
  std::string packed = frames;
  PackFrames(&packed);
  std::mt19937 random(1);
  int refused = 0;
  for (int i = 0; i < 2000; ++i) {
    std::string copy = packed;
    copy[random() % copy.size()] ^= static_cast<char>(1 + random() % 255);
    if (i % 2 == 0) copy.resize(random() % copy.size());
    const absl::Status status = UnpackFrames(frames.size(), &copy);
    refused += status.ok() ? 0 : 1;
    EXPECT_TRUE(!status.ok() || copy.size() == frames.size());
  }
  EXPECT_GT(refused, 0);
}

}  // namespace
}  // namespace wire
}  // namespace craftfleet
