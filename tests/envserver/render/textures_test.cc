#include "envserver/render/textures.h"

#include <zlib.h>

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "common/io/files.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// A copy of the project's textures, in which a test changes files.
class SpoiledTextures : public testing::Test {
 protected:
  void SetUp() override {
    const auto folder = DefaultTextureDir();
    ASSERT_THAT(folder, IsOk());
    std::filesystem::copy(*folder, folder_.path(), std::filesystem::copy_options::recursive);
    ASSERT_THAT(Textures::Load(folder_.path()), IsOk());
  }

  void WritePicture(const std::string& name, int width, int height, int type) {
    ASSERT_TRUE(cv::imwrite(folder_ / name, cv::Mat(height, width, type, cv::Scalar(10, 20, 30, 40))));
  }
  void Write(const std::string& name, absl::string_view bytes) {
    ASSERT_THAT(WriteFileSynced(folder_ / name, bytes), IsOk());
  }

  TempFolder folder_;
};

TEST_F(SpoiledTextures, AMissingFileOrFolderIsNamed) {
  EXPECT_THAT(Textures::Load(folder_ / "nowhere"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("nowhere")));
  std::filesystem::remove(folder_ / "furnace.png");
  EXPECT_THAT(Textures::Load(folder_.path()), StatusIs(absl::StatusCode::kNotFound, HasSubstr("furnace.png")));
}

TEST_F(SpoiledTextures, AnUnreadableOrCutFileIsNamed) {
  const std::string whole = ReadFile(folder_ / "cow.png").value();
  for (const std::string& bytes : {std::string(), std::string("not a picture"), std::string("\x89PNG\r\n\x1a\n"),
                                   whole.substr(0, whole.size() / 2), whole.substr(0, whole.size() - 20)}) {
    Write("cow.png", bytes);
    EXPECT_THAT(Textures::Load(folder_.path()),
                StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr("cow.png"), HasSubstr("unreadable"))));
  }
}

TEST_F(SpoiledTextures, AFileOfAnotherSizeOrDepthIsNamed) {
  struct Picture {
    int height;
    int type;
    const char* error;
  };
  for (const Picture& picture : {Picture{17, CV_8UC4, "16x17"},
                                 {16, CV_16UC3, "3 channels of 16 bits"},
                                 {16, CV_8UC1, "1 channels of 8 bits"}}) {
    WritePicture("9.png", 16, picture.height, picture.type);
    EXPECT_THAT(Textures::Load(folder_.path()),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr("9.png"), HasSubstr(picture.error), HasSubstr("want a PNG of 16x16"))));
  }
}

TEST_F(SpoiledTextures, OnlyVariantsMayBeMissing) {
  std::filesystem::remove(folder_ / "tree3.png");
  const auto textures = Textures::Load(folder_.path());
  ASSERT_THAT(textures, IsOk());
  EXPECT_EQ((*textures)->Find("tree3"), nullptr);
  EXPECT_NE((*textures)->Find("tree2"), nullptr);
  EXPECT_EQ((*textures)->PathOf("tree3"), folder_ / "tree3.png");
}

TEST_F(SpoiledTextures, ReadsColoursInOrder) {
  WritePicture("sand.png", 16, 16, CV_8UC4);  // blue 10, green 20, red 30, alpha 40
  WritePicture("path.png", 16, 16, CV_8UC3);
  const auto textures = Textures::Load(folder_.path());
  ASSERT_THAT(textures, IsOk());
  EXPECT_EQ((*textures)->Find("sand")->pixels[5], 30u | 20u << 8 | 10u << 16 | 40u << 24);
  EXPECT_EQ((*textures)->Find("path")->pixels[5], 30u | 20u << 8 | 10u << 16 | 255u << 24);
}

// As Python's image readers do.
TEST_F(SpoiledTextures, GammaChunksAreIgnored) {
  WritePicture("sand.png", 16, 16, CV_8UC4);
  const std::string plain = ReadFile(folder_ / "sand.png").value();
  std::string chunk("gAMA\x00\x01\x86\xa0", 8);  // linear light
  const uLong crc = crc32(0, reinterpret_cast<const Bytef*>(chunk.data()), 8);
  for (const int shift : {24, 16, 8, 0}) chunk.push_back(static_cast<char>(crc >> shift & 0xff));
  constexpr size_t kAfterHeader = 33;
  Write("sand.png", plain.substr(0, kAfterHeader) + std::string("\0\0\0\4", 4) + chunk + plain.substr(kAfterHeader));
  const auto textures = Textures::Load(folder_.path());
  ASSERT_THAT(textures, IsOk());
  EXPECT_EQ((*textures)->Find("sand")->pixels[0], 30u | 20u << 8 | 10u << 16 | 40u << 24);
}

TEST_F(SpoiledTextures, ReadsPixelsRowByRow) {
  cv::Mat picture(16, 16, CV_8UC3, cv::Scalar(0, 0, 0));
  picture.at<cv::Vec3b>(3, 14) = {0, 0, 200};  // row 3, column 14
  ASSERT_TRUE(cv::imwrite(folder_ / "sand.png", picture));
  const auto textures = Textures::Load(folder_.path());
  ASSERT_THAT(textures, IsOk());
  EXPECT_EQ((*textures)->Find("sand")->pixels[3 * 16 + 14] & 0xffffff, 200u);
  EXPECT_EQ((*textures)->Find("sand")->pixels[14 * 16 + 3] & 0xffffff, 0u);
}

// A palette is expanded, as other image readers do.
TEST(DecodeTexture, ExpandsAPalette) {
  const std::string file = ReadFile(SourcePath("tests/fuzz/regressions/texture/palette.png")).value();
  const absl::StatusOr<Texture> texture = DecodeTexture(file, "palette.png");
  ASSERT_THAT(texture, IsOk());
  EXPECT_EQ(texture->pixels[0], 30u | 20u << 8 | 10u << 16 | 40u << 24);
  EXPECT_EQ(texture->pixels[1], 0u | 200u << 8 | 100u << 16 | 255u << 24);
}

TEST(DecodeTexture, IgnoresBytesAfterTheImage) {
  std::string file = ReadFile(JoinPath(*DefaultTextureDir(), "cow.png")).value();
  const absl::StatusOr<Texture> texture = DecodeTexture(file, "cow.png");
  ASSERT_THAT(texture, IsOk());
  const absl::StatusOr<Texture> longer = DecodeTexture(file + "!", "cow.png");
  ASSERT_THAT(longer, IsOk());
  EXPECT_EQ(longer->pixels, texture->pixels);
}

TEST(BuiltInTextures, MatchTheFolder) {
  const std::string folder = SourcePath("envserver/textures");
  EXPECT_EQ(TextureDigest(BuiltInTextures()), TextureDigest(folder).value());
  const std::shared_ptr<const Textures> built_in = Textures::BuiltIn();
  const auto loaded = Textures::Load(folder);
  ASSERT_THAT(loaded, IsOk());
  for (const TextureFile& file : BuiltInTextures()) {
    const absl::string_view name = file.name.substr(0, file.name.size() - 4);
    const Texture* texture = built_in->Find(name);
    ASSERT_EQ(texture == nullptr, (*loaded)->Find(name) == nullptr) << name;
    if (texture == nullptr) continue;
    EXPECT_EQ(texture->pixels, (*loaded)->Find(name)->pixels) << name;
  }
  EXPECT_EQ(built_in->Find("nothing"), nullptr);
}

}  // namespace
}  // namespace craftfleet
