#include "actor/recording/picture.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <opencv2/imgproc.hpp>

#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"
#include "common/io/png_encoder.h"

namespace craftfleet {
namespace {

// Brightness factor of pixels without attention; colour and opacity of the highlight on those with attention.
constexpr float kDim = 0.7F;
constexpr float kLight[3] = {255, 190, 60};
constexpr float kLightShare = 0.4F;

constexpr uint8_t kBarGrey = 128;  // the pixels that the colour bar lights

uint8_t ToByte(float value) { return static_cast<uint8_t>(std::lround(std::min(std::max(value, 0.0F), 255.0F))); }

// Lights uint8[3], an RGB pixel.
void Light(float light, uint8_t* pixel) {
  const float grey = 0.3F * pixel[0] + 0.59F * pixel[1] + 0.11F * pixel[2];
  for (int c = 0; c < 3; ++c) {
    const float lit = (1 - kLightShare) * pixel[c] + kLightShare * kLight[c];
    pixel[c] = ToByte((1 - light) * kDim * grey + light * lit);
  }
}

// Draws text on a strip, vertically centred, with its left end, centre or right end at `x`.
enum class Align { kLeft, kCenter, kRight };
void DrawLabel(const std::string& text, int x, Align align, cv::Mat* strip) {
  const double scale = strip->rows / 56.0;
  int below = 0;
  const int width = cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, scale, 1, &below).width;
  const int left = align == Align::kLeft ? x : align == Align::kCenter ? x - width / 2 : x - width;
  cv::putText(*strip, text, {left, strip->rows - strip->rows / 8}, cv::FONT_HERSHEY_SIMPLEX, scale,
              cv::Scalar::all(230), 1, cv::LINE_AA);
}

// A strip uint8[ScaleHeight(S),2*S,3] that shows the scale of `light` as a colour bar below the overlay, in percent.
cv::Mat DrawScale(int picture_size, const AttentionLight& light) {
  const int height = ScaleHeight(picture_size);
  const int margin = height / 4;
  cv::Mat strip = cv::Mat::zeros(height, 2 * picture_size, CV_8UC3);
  const int left = picture_size + margin;
  const int right = 2 * picture_size - margin;
  for (int x = left; x < right; ++x) {
    cv::Vec3b color(kBarGrey, kBarGrey, kBarGrey);
    Light(static_cast<float>(x - left) / static_cast<float>(right - 1 - left), color.val);
    strip(cv::Rect(x, height / 8, 1, height * 3 / 8)) = cv::Scalar(color);
  }
  DrawLabel("attention", picture_size - margin, Align::kRight, &strip);
  DrawLabel("0%", left, Align::kLeft, &strip);
  if (picture_size >= 160) DrawLabel(PercentText(light.middle), (left + right) / 2, Align::kCenter, &strip);
  DrawLabel(PercentText(light.highest), right, Align::kRight, &strip);
  return strip;
}

}  // namespace

std::string PercentText(double part) {
  if (part >= 0.1) return absl::StrFormat("%.0f%%", 100 * part);
  return absl::StrFormat("%.2g%%", 100 * part);
}

AttentionLight LightToHighest(const PatchGrid& grid, absl::Span<const float> weights) {
  AttentionLight light = {SpreadOverPixels(grid, weights), 0, 0};
  light.highest = LightToHighest(&light.brightness);
  light.middle = light.highest / 4;
  return light;
}

std::string OverlayAttention(absl::string_view picture, int picture_size, absl::Span<const float> brightness,
                             int frame_size) {
  CRAFTFLEET_CHECK(picture.size() == size_t{3} * picture_size * picture_size);
  CRAFTFLEET_CHECK(brightness.size() == static_cast<size_t>(frame_size) * frame_size);
  std::string overlay(picture);
  for (int y = 0; y < picture_size; ++y) {
    for (int x = 0; x < picture_size; ++x) {
      Light(brightness[y * frame_size / picture_size * frame_size + x * frame_size / picture_size],
            reinterpret_cast<uint8_t*>(&overlay[3 * (y * picture_size + x)]));
    }
  }
  return overlay;
}

int ScaleHeight(int picture_size) { return 2 * std::max(12, picture_size / 36); }

std::string BesideOverlay(const std::string& picture, const std::string& overlay, int picture_size,
                          const AttentionLight& light) {
  const size_t bytes = size_t{3} * picture_size * picture_size;
  CRAFTFLEET_CHECK(picture.size() == bytes && overlay.size() == bytes);
  const auto as_mat = [&](const std::string& pixels) {
    return cv::Mat(picture_size, picture_size, CV_8UC3, const_cast<char*>(pixels.data()));
  };
  cv::Mat whole;
  cv::hconcat(as_mat(picture), as_mat(overlay), whole);
  whole.push_back(DrawScale(picture_size, light));
  return {reinterpret_cast<const char*>(whole.data), whole.total() * whole.elemSize()};
}

cv::Mat ToBgr(absl::string_view picture, int width, int height) {
  CRAFTFLEET_CHECK(picture.size() == size_t{3} * width * height);
  const cv::Mat rgb(height, width, CV_8UC3, const_cast<char*>(picture.data()));
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  return bgr;
}

absl::Status WritePng(const std::string& path, absl::string_view picture, int width, int height) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string png, WithPrefix(path, EncodePng(picture, width, height)));
  return ReplaceFile(path, png);
}

}  // namespace craftfleet
