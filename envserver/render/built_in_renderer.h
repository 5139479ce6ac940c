// Renderers for programs that draw what they receive as scene records. They have the textures that are compiled in.

#pragma once

#include <memory>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "envserver/render/renderer.h"

namespace craftfleet {

// For the environment `env` and frames of `frame_size` pixels a side. All callers of a process share one as long as any
// of them holds it. Thread-safe.
//   InvalidArgument: no such environment, or no such size; names it.
absl::StatusOr<std::shared_ptr<const Renderer>> BuiltInRenderer(absl::string_view env, int frame_size);

}  // namespace craftfleet
