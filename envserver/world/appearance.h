// Draws the appearance variant of a new cell or creature. Source: RULES.md, section 14.

#pragma once

#include <absl/functional/function_ref.h>

#include "envserver/world/options.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/types.h"

namespace craftfleet {

// One draw where the setting's letters name the thing, else none and kNoVariant.
Variant DrawVariant(const WorldOptions& options, Material material, absl::FunctionRef<double()> uniform);
Variant DrawVariant(const WorldOptions& options, ObjectType type, absl::FunctionRef<double()> uniform);
template <typename Thing>
Variant DrawVariant(const WorldOptions& options, Thing thing, RandomStream* random) {
  return DrawVariant(options, thing, [random] { return random->Uniform(); });
}

// Whether the thing can have this variant (none included) under these settings.
bool IsPossibleVariant(const WorldOptions& options, Material material, Variant variant);
bool IsPossibleVariant(const WorldOptions& options, ObjectType type, Variant variant);

}  // namespace craftfleet
