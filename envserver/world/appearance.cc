#include "envserver/world/appearance.h"

#include <absl/strings/match.h>

namespace craftfleet {
namespace {

// ' ' for materials without variants.
char LetterOf(Material material) {
  switch (material) {
    case Material::kTree:
      return 't';
    case Material::kWater:
      return 'w';
    case Material::kStone:
      return 's';
    case Material::kCoal:
      return 'u';
    case Material::kIron:
      return 'i';
    default:
      return ' ';
  }
}

char LetterOf(ObjectType type) {
  switch (type) {
    case ObjectType::kPlayer:
      return 'p';
    case ObjectType::kCow:
      return 'c';
    case ObjectType::kZombie:
      return 'z';
    case ObjectType::kSkeleton:
      return 'k';
    default:
      return ' ';
  }
}

Variant DrawForLetter(const WorldOptions& options, char letter, RandomStream* random) {
  if (!absl::StrContains(options.appearance, letter)) return kNoVariant;
  const double sample = random->Uniform() * 100;
  int variant = 0;
  int cumulative = options.percentages[0];
  // Terminates: the percentages sum to 100 and the sample is smaller.
  while (sample > cumulative) cumulative += options.percentages[++variant];
  return static_cast<Variant>(variant);
}

bool IsPossibleForLetter(const WorldOptions& options, char letter, Variant variant) {
  if (variant == kNoVariant) return true;
  return absl::StrContains(options.appearance, letter) && variant >= 0 && variant < kNumVariants &&
         (variant == 0 || !absl::StrContains(kLettersWithOneVariant, letter));
}

}  // namespace

Variant DrawVariant(const WorldOptions& options, Material material, RandomStream* random) {
  return options.appearance.empty() ? kNoVariant : DrawForLetter(options, LetterOf(material), random);
}

Variant DrawVariant(const WorldOptions& options, ObjectType type, RandomStream* random) {
  return options.appearance.empty() ? kNoVariant : DrawForLetter(options, LetterOf(type), random);
}

bool IsPossibleVariant(const WorldOptions& options, Material material, Variant variant) {
  return IsPossibleForLetter(options, LetterOf(material), variant);
}

bool IsPossibleVariant(const WorldOptions& options, ObjectType type, Variant variant) {
  return IsPossibleForLetter(options, LetterOf(type), variant);
}

}  // namespace craftfleet
