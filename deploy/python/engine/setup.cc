#include "engine/setup.h"

#include <utility>

#include "common/base/status_macros.h"
#include "common/config/env_name.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxOtherSizes = 8;

}  // namespace

absl::StatusOr<std::shared_ptr<Setup>> Setup::Create(const Options& options) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(options.env));
  WorldOptions world = WorldOptions::FromEnvName(name);
  world.width = options.area[0];
  world.height = options.area[1];
  world.view_width = options.view[0];
  world.view_height = options.view[1];
  world.length = options.length;
  CRAFTFLEET_RETURN_IF_ERROR(world.Validate());
  std::shared_ptr<const Textures> textures = Textures::BuiltIn();
  if (!options.textures.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(textures, Textures::Load(options.textures));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Renderer> renderer,
                              Renderer::Create(*textures, world, {options.size[0], options.size[1], name.inventory}));
  return std::shared_ptr<Setup>(new Setup(options, name.inventory, std::move(textures), std::move(renderer)));
}

absl::StatusOr<std::shared_ptr<const Renderer>> Setup::RendererOf(Pair size) const {
  if (size == options_.size) return renderer_;
  MutexLock lock(&mu_);
  const auto found = others_.find(size);
  if (found != others_.end()) return found->second;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Renderer> renderer,
                              Renderer::Create(*textures_, world(), {size[0], size[1], inventory_}));
  if (others_.size() == kMaxOtherSizes) others_.clear();
  others_[size] = renderer;
  return renderer;
}

}  // namespace craftfleet
