#include "envserver/render/textures.h"

#include <utility>

#include <absl/strings/str_cat.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "common/crafter.h"
#include "common/files.h"
#include "common/status_macros.h"
#include "envserver/render/sprites.h"
#include "envserver/world/state.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kWanted = "want a PNG of 16x16 pixels, 8-bit RGB or RGBA";

absl::Status Refused(absl::string_view path, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("texture ", path, ": ", what, ", ", kWanted));
}

// Empty when the bytes are no picture.
cv::Mat Decode(std::string& bytes) {
  try {
    return cv::imdecode(cv::Mat(1, static_cast<int>(bytes.size()), CV_8UC1, bytes.data()), cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    return {};
  }
}

}  // namespace

absl::StatusOr<Texture> DecodeTexture(std::string bytes, absl::string_view path) {
  const cv::Mat image = bytes.empty() ? cv::Mat() : Decode(bytes);
  if (image.empty()) return Refused(path, "unreadable");
  if (image.depth() != CV_8U || (image.channels() != 3 && image.channels() != 4)) {
    return Refused(path, absl::StrCat(image.channels(), " channels of ", 8 * image.elemSize1(), " bits"));
  }
  if (image.cols != kTextureSize || image.rows != kTextureSize) {
    return Refused(path, absl::StrCat(image.cols, "x", image.rows, " pixels"));
  }
  Texture texture;
  for (int y = 0; y < kTextureSize; ++y) {
    const uint8_t* bgr = image.ptr(y);
    for (int x = 0; x < kTextureSize; ++x, bgr += image.channels()) {
      const Pixel alpha = image.channels() == 4 ? bgr[3] : 255;
      texture.pixels[y * kTextureSize + x] = bgr[2] | bgr[1] << 8 | bgr[0] << 16 | alpha << 24;
    }
  }
  return texture;
}

absl::StatusOr<std::shared_ptr<const Textures>> Textures::Load(const std::string& folder) {
  auto textures = std::make_shared<Textures>();
  textures->folder_ = folder;
  const auto load = [&](const std::string& name) -> absl::Status {
    const std::string path = textures->PathOf(name);
    CRAFTFLEET_ASSIGN_OR_RETURN(std::string bytes, ReadFile(path));
    CRAFTFLEET_ASSIGN_OR_RETURN(textures->textures_[name], DecodeTexture(std::move(bytes), path));
    return absl::OkStatus();
  };
  for (Sprite sprite = 0; sprite < kNumSprites; ++sprite) {
    const std::string name = SpriteName(sprite);
    if (IsVariant(sprite) && !PathExists(textures->PathOf(name))) continue;
    CRAFTFLEET_RETURN_IF_ERROR(load(name));
  }
  for (const absl::string_view item : kItemNames) CRAFTFLEET_RETURN_IF_ERROR(load(std::string(item)));
  for (int digit = 1; digit <= kMaxItem; ++digit) CRAFTFLEET_RETURN_IF_ERROR(load(absl::StrCat(digit)));
  return textures;
}

const Texture* Textures::Find(absl::string_view name) const {
  const auto found = textures_.find(name);
  return found == textures_.end() ? nullptr : &found->second;
}

std::string Textures::PathOf(absl::string_view name) const { return JoinPath(folder_, absl::StrCat(name, ".png")); }

}  // namespace craftfleet
