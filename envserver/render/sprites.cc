#include "envserver/render/sprites.h"

#include <array>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/check.h"

namespace craftfleet {
namespace {

// The numbers of the kinds that follow the materials.
enum Kind : int {
  kPlayer = kNumMaterials - 1,  // left, right, up, down
  kSleeper = kPlayer + 4,
  kCow,
  kZombie,
  kSkeleton,
  kArrow,  // left, right, up, down
  kPlant = kArrow + 4,
  kRipePlant,
};
static_assert(kRipePlant + 1 == kNumSpriteKinds);

struct KindInfo {
  absl::string_view name;
  char letter;  // under which the appearance setting names it; ' ' for kinds without variants
};

constexpr std::array<KindInfo, kNumSpriteKinds> kKinds = {{
    {"water", 'w'},       {"grass", ' '},        {"stone", 's'},       {"path", ' '},         {"sand", ' '},
    {"tree", 't'},        {"lava", ' '},         {"coal", 'u'},        {"iron", 'i'},         {"diamond", ' '},
    {"table", ' '},       {"furnace", ' '},      {"player-left", 'p'}, {"player-right", 'p'}, {"player-up", 'p'},
    {"player-down", 'p'}, {"player-sleep", 'p'}, {"cow", 'c'},         {"zombie", 'z'},       {"skeleton", 'k'},
    {"arrow-left", ' '},  {"arrow-right", ' '},  {"arrow-up", ' '},    {"arrow-down", ' '},   {"plant", ' '},
    {"plant-ripe", ' '},
}};

Sprite Look(int kind, Variant variant) { return kind * kLooksPerKind + variant + 1; }

// Order of the textures that face somewhere: left, right, up, down.
int FacingIndex(Position facing) {
  if (facing.x != 0) return facing.x < 0 ? 0 : 1;
  return facing.y < 0 ? 2 : 3;
}

}  // namespace

Sprite SpriteOf(Material material, Variant variant) { return Look(static_cast<int>(material) - 1, variant); }

Sprite SpriteOf(const Object& object, bool sleeping) {
  switch (object.type) {
    case ObjectType::kPlayer:
      return Look(sleeping ? kSleeper : kPlayer + FacingIndex(object.facing), object.variant);
    case ObjectType::kCow:
      return Look(kCow, object.variant);
    case ObjectType::kZombie:
      return Look(kZombie, object.variant);
    case ObjectType::kSkeleton:
      return Look(kSkeleton, object.variant);
    case ObjectType::kArrow:
      return Look(kArrow + FacingIndex(object.facing), object.variant);
    case ObjectType::kPlant:
      return Look(object.counter > kRipeAfter ? kRipePlant : kPlant, object.variant);
    case ObjectType::kNone:
      break;
  }
  CRAFTFLEET_CHECK(false);
}

std::string SpriteName(Sprite sprite) {
  const absl::string_view name = kKinds[sprite / kLooksPerKind].name;
  return IsVariant(sprite) ? absl::StrCat(name, sprite % kLooksPerKind - 1) : std::string(name);
}

bool IsVariant(Sprite sprite) { return sprite % kLooksPerKind != 0; }

std::vector<Sprite> SpritesInUse(const WorldOptions& options) {
  std::vector<Sprite> sprites;
  for (int kind = 0; kind < kNumSpriteKinds; ++kind) {
    // Also where the thing has variants: one staged or placed without a draw has none.
    sprites.push_back(Look(kind, kNoVariant));
    if (options.appearance.find(kKinds[kind].letter) == std::string::npos) continue;
    for (Variant variant = 0; variant < kNumVariants; ++variant) {
      // A draw of exactly 0 gives the first variant, whatever its percentage.
      if (variant == 0 || options.percentages[variant] > 0) sprites.push_back(Look(kind, variant));
    }
  }
  return sprites;
}

}  // namespace craftfleet
