// What the games of an environment have in common: the options of their worlds, the textures, and their pictures' size.

#pragma once

#include <array>
#include <map>
#include <memory>
#include <string>

#include <absl/status/statusor.h>

#include "common/base/mutex.h"
#include "envserver/render/renderer.h"
#include "envserver/render/textures.h"
#include "envserver/world/options.h"

namespace craftfleet {

// Thread-safe.
class Setup {
 public:
  using Pair = std::array<int, 2>;  // width, height

  struct Options {
    std::string env;       // the name of an environment (common/config/env_name.h)
    Pair area;             // cells of a world
    Pair view;             // cells of a picture, with the inventory's rows
    Pair size;             // pixels of an observation
    int length;            // steps of an episode; 0: no limit
    std::string textures;  // a folder of PNG files; empty: those that are compiled in
  };

  //   InvalidArgument: an option out of its range, or a bad texture; NotFound: a texture is missing. Both name it.
  static absl::StatusOr<std::shared_ptr<Setup>> Create(const Options& options);

  const Options& options() const { return options_; }
  const WorldOptions& world() const { return renderer_->world_options(); }
  // Of observations.
  const Renderer& renderer() const { return *renderer_; }

  // For pictures of `size` pixels; up to eight are kept.
  //   InvalidArgument: a size out of its range.
  absl::StatusOr<std::shared_ptr<const Renderer>> RendererOf(Pair size) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  Setup(Options options, bool inventory, std::shared_ptr<const Textures> textures,
        std::shared_ptr<const Renderer> renderer)
      : options_(std::move(options)),
        inventory_(inventory),
        textures_(std::move(textures)),
        renderer_(std::move(renderer)) {}

  const Options options_;
  const bool inventory_;  // whether pictures show the inventory
  const std::shared_ptr<const Textures> textures_;
  const std::shared_ptr<const Renderer> renderer_;
  mutable Mutex mu_;
  mutable std::map<Pair, std::shared_ptr<const Renderer>> others_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet
