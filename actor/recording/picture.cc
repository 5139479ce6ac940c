#include "actor/recording/picture.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <vector>

#include <absl/strings/str_cat.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "common/check.h"
#include "common/files.h"

namespace craftfleet {
namespace {

// How much of a picture is left where nobody looks, and the light that falls where somebody does.
constexpr float kDim = 0.5F;
constexpr float kLight[3] = {255, 190, 60};
constexpr float kLightShare = 0.4F;

uint8_t ToByte(float value) { return static_cast<uint8_t>(std::lround(std::min(std::max(value, 0.0F), 255.0F))); }

}  // namespace

std::string OverlayAttention(absl::string_view picture, int picture_size, absl::Span<const float> brightness,
                             int frame_size) {
  CRAFTFLEET_CHECK(picture.size() == size_t{3} * picture_size * picture_size);
  CRAFTFLEET_CHECK(brightness.size() == static_cast<size_t>(frame_size) * frame_size);
  std::string overlay(picture);
  for (int y = 0; y < picture_size; ++y) {
    for (int x = 0; x < picture_size; ++x) {
      const float light = brightness[y * frame_size / picture_size * frame_size + x * frame_size / picture_size];
      auto* pixel = reinterpret_cast<uint8_t*>(&overlay[3 * (y * picture_size + x)]);
      const float grey = 0.3F * pixel[0] + 0.59F * pixel[1] + 0.11F * pixel[2];
      for (int c = 0; c < 3; ++c) {
        const float lit = (1 - kLightShare) * pixel[c] + kLightShare * kLight[c];
        pixel[c] = ToByte((1 - light) * kDim * grey + light * lit);
      }
    }
  }
  return overlay;
}

std::string SideBySide(absl::string_view left, absl::string_view right, int picture_size) {
  const size_t row = size_t{3} * picture_size;
  CRAFTFLEET_CHECK(left.size() == row * picture_size && right.size() == left.size());
  std::string both;
  for (size_t at = 0; at < left.size(); at += row) {
    absl::StrAppend(&both, left.substr(at, row), right.substr(at, row));
  }
  return both;
}

cv::Mat ToBgr(absl::string_view picture, int width, int height) {
  CRAFTFLEET_CHECK(picture.size() == size_t{3} * width * height);
  const cv::Mat rgb(height, width, CV_8UC3, const_cast<char*>(picture.data()));
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  return bgr;
}

absl::Status WritePng(const std::string& path, absl::string_view picture, int width, int height) {
  std::vector<uint8_t> png;
  try {
    cv::imencode(".png", ToBgr(picture, width, height), png);
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat(path, ": ", error.what()));
  }
  return WriteFileSynced(path, {reinterpret_cast<const char*>(png.data()), png.size()});
}

}  // namespace craftfleet
