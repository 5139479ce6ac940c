// The options of a world: size, length and the CrafterOOD settings.
// Source: RULES.md, sections 3, 5 and 14.

#pragma once

#include <array>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/base/crafter.h"
#include "common/config/env_name.h"

namespace craftfleet {

inline constexpr int kNumVariants = 4;
// Letters of appearance: tree water cow zombie stone coal skeleton iron player.
inline constexpr absl::string_view kAppearanceLetters = "twczsukip";
// Letters with variant 0 only.
inline constexpr absl::string_view kLettersWithOneVariant = "wip";

// World generation places the thing where a uniform draw exceeds the threshold: the higher, the rarer. Each in 0..1.
struct NumberThresholds {
  double tree = 0.8;
  double coal = 0.85;
  double cow = 0.985;
  double zombie = 0.993;
  double skeleton = 0.95;
};

struct WorldOptions {
  int width = 64;       // cells; 4..250
  int height = 64;      // cells; 4..250
  int view_width = 9;   // cells across the picture, 1..63; objects within 2 * max(view) of the player are updated
  int view_height = 9;  // cells down the picture with the inventory's ceil(16 / view_width) rows, 1..63
  int length = kEpisodeLength;  // steps of an episode, 0..1,000,000,000; 0: no limit
  std::string appearance;       // letters with variants: any of t w c z s u k i p, each once; empty: none
  std::array<int, kNumVariants> percentages = {100, 0, 0, 0};  // of the variants, each 0..100, sum 100
  NumberThresholds numbers;
  std::string name = "crafter";  // the world's canonical name (EnvName::WorldName), stored in snapshots

  // The settings of the name, otherwise the defaults. Its inventory setting concerns the picture, not the world.
  static WorldOptions FromEnvName(const EnvName& name);
  // InvalidArgument names the field, its value and what was expected.
  absl::Status Validate() const;

  int inventory_rows() const { return (16 + view_width - 1) / view_width; }
  // Objects at this L1 distance from the player or farther are not updated.
  int update_distance() const { return 2 * (view_width > view_height ? view_width : view_height); }
};

}  // namespace craftfleet
