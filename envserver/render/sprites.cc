#include "envserver/render/sprites.h"

#include <array>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/check.h"
#include "envserver/world/appearance.h"

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

struct ObjectKind {
  absl::string_view name;
  ObjectType type;
};

constexpr std::array<ObjectKind, kNumSpriteKinds - kPlayer> kObjectKinds = {{
    {"player-left", ObjectType::kPlayer},
    {"player-right", ObjectType::kPlayer},
    {"player-up", ObjectType::kPlayer},
    {"player-down", ObjectType::kPlayer},
    {"player-sleep", ObjectType::kPlayer},
    {"cow", ObjectType::kCow},
    {"zombie", ObjectType::kZombie},
    {"skeleton", ObjectType::kSkeleton},
    {"arrow-left", ObjectType::kArrow},
    {"arrow-right", ObjectType::kArrow},
    {"arrow-up", ObjectType::kArrow},
    {"arrow-down", ObjectType::kArrow},
    {"plant", ObjectType::kPlant},
    {"plant-ripe", ObjectType::kPlant},
}};

Sprite Look(int kind, Variant variant) { return kind * kLooksPerKind + variant + 1; }

// Order of the textures that face somewhere: left, right, up, down.
int FacingIndex(Position facing) {
  if (facing.x != 0) return facing.x < 0 ? 0 : 1;
  return facing.y < 0 ? 2 : 3;
}

}  // namespace

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

bool IsMaterial(Sprite sprite) { return sprite / kLooksPerKind < kPlayer; }

std::string SpriteName(Sprite sprite) {
  const int kind = sprite / kLooksPerKind;
  std::string name(kind < kPlayer ? kMaterialNames[kind + 1] : kObjectKinds[kind - kPlayer].name);
  if (IsVariant(sprite)) absl::StrAppend(&name, sprite % kLooksPerKind - 1);
  return name;
}

bool IsVariant(Sprite sprite) { return sprite % kLooksPerKind != 0; }

bool IsPossible(const WorldOptions& options, Sprite sprite) {
  const int kind = sprite / kLooksPerKind;
  const auto variant = static_cast<Variant>(sprite % kLooksPerKind - 1);
  if (!IsMaterial(sprite)) return IsPossibleVariant(options, kObjectKinds[kind - kPlayer].type, variant);
  return IsPossibleVariant(options, static_cast<Material>(kind + 1), variant);
}

}  // namespace craftfleet
