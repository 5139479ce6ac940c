// Draws the appearance variant of a new cell or creature. Source: RULES.md, section 14.

#pragma once

#include "envserver/world/options.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/types.h"

namespace craftfleet {

// One draw where the setting's letters name the thing, else none and kNoVariant.
Variant DrawVariant(const WorldOptions& options, Material material, RandomStream* random);
Variant DrawVariant(const WorldOptions& options, ObjectType type, RandomStream* random);

// Whether the thing can have this variant (none included) under these settings.
bool IsPossibleVariant(const WorldOptions& options, Material material, Variant variant);
bool IsPossibleVariant(const WorldOptions& options, ObjectType type, Variant variant);

}  // namespace craftfleet
