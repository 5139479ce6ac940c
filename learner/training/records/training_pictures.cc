#include "learner/training/records/training_pictures.h"

#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "common/agent/attention_map.h"
#include "common/agent/policy.h"
#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/io/png_encoder.h"

namespace craftfleet {
namespace {

constexpr int kScale = 4;          // pixels for each of a frame
constexpr float kDarkest = 0.15F;  // brightness without attention

absl::StatusOr<EventPicture> Enlarge(const char* tag, absl::string_view frame, int size) {
  const int side = size * kScale;
  std::string pixels(size_t{3} * side * side, '\0');
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      frame.copy(&pixels[size_t{3} * (y * side + x)], 3, size_t{3} * (y / kScale * size + x / kScale));
    }
  }
  EventPicture picture = {tag, side, side, ""};
  CRAFTFLEET_ASSIGN_OR_RETURN(picture.png, EncodePng(pixels, side, side));
  return picture;
}

// `frame` as bright as the square root of its attention, relative to the highest.
std::string LightByAttention(absl::string_view frame, const PatchGrid& patches, const std::vector<float>& weights) {
  std::vector<float> attention = SpreadOverPixels(patches, weights);
  LightToHighest(&attention);
  std::string lit(frame);
  for (size_t i = 0; i < lit.size(); ++i) {
    const float light = kDarkest + (1 - kDarkest) * attention[i / 3];
    lit[i] = static_cast<char>(static_cast<uint8_t>(std::lround(light * static_cast<uint8_t>(lit[i]))));
  }
  return lit;
}

}  // namespace

absl::StatusOr<std::vector<EventPicture>> TrainingPictures(const AgentSpec& spec,
                                                           std::shared_ptr<const std::string> weights,
                                                           const Fragment& fragment) {
  const auto frame_bytes = static_cast<size_t>(spec.frame_bytes());
  CRAFTFLEET_CHECK(fragment.frames.size() >= frame_bytes);
  const absl::string_view frame = absl::string_view(fragment.frames).substr(fragment.frames.size() - frame_bytes);
  std::vector<EventPicture> pictures;
  CRAFTFLEET_ASSIGN_OR_RETURN(EventPicture plain, Enlarge("rollout/frame", frame, spec.frame_size));
  pictures.push_back(std::move(plain));
  if (spec.network.objects() == v1::NetworkConfig::NO_OBJECTS) return pictures;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<const Policy> policy,
                              Policy::Create(spec, std::move(weights), /*tile=*/1));
  CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionMap map, policy->Attention(frame));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> mean, Choose(map, AttentionChoice()));
  CRAFTFLEET_ASSIGN_OR_RETURN(
      EventPicture lit, Enlarge("rollout/attention", LightByAttention(frame, map.patches, mean), spec.frame_size));
  pictures.push_back(std::move(lit));
  return pictures;
}

}  // namespace craftfleet
