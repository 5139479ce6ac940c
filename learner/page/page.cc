#include "learner/page/page.h"

#include <zlib.h>

#include <cmath>

#include "common/base/check.h"
#include "common/base/crafter.h"

namespace craftfleet {
namespace {

// Three decimals are more than a chart shows.
double Rounded(double value) { return std::round(value * 1000) / 1000; }

}  // namespace

nlohmann::json JsonOfCurve(const std::vector<CurvePoint>& curve) {
  nlohmann::json steps = nlohmann::json::array();
  nlohmann::json reward = nlohmann::json::array();
  nlohmann::json score = nlohmann::json::array();
  for (const CurvePoint& point : curve) {
    steps.push_back(point.steps);
    reward.push_back(Rounded(point.reward));
    score.push_back(Rounded(point.score));
  }
  return {{"steps", std::move(steps)}, {"reward", std::move(reward)}, {"score", std::move(score)}};
}

nlohmann::json JsonOfRates(const AchievementPercentages& rates) {
  nlohmann::json json;
  for (int i = 0; i < kNumAchievements; ++i) json[std::string(kAchievementNames[i])] = Rounded(rates[i]);
  return json;
}

std::vector<absl::string_view> ScriptsOf(absl::string_view page) {
  constexpr absl::string_view kBegin = "<script>";
  constexpr absl::string_view kEnd = "</script>";
  std::vector<absl::string_view> scripts;
  for (size_t at = page.find(kBegin); at != absl::string_view::npos; at = page.find(kBegin, at)) {
    at += kBegin.size();
    scripts.push_back(page.substr(at, page.find(kEnd, at) - at));
  }
  return scripts;
}

std::string Gzip(absl::string_view text) {
  constexpr int kGzipWindow = 15 + 16;
  z_stream stream = {};
  CRAFTFLEET_CHECK(deflateInit2(&stream, Z_BEST_COMPRESSION, Z_DEFLATED, kGzipWindow, 9, Z_DEFAULT_STRATEGY) == Z_OK);
  std::string packed(deflateBound(&stream, text.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
  stream.avail_in = static_cast<uInt>(text.size());
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  CRAFTFLEET_CHECK(deflate(&stream, Z_FINISH) == Z_STREAM_END);
  packed.resize(stream.total_out);
  deflateEnd(&stream);
  return packed;
}

}  // namespace craftfleet
