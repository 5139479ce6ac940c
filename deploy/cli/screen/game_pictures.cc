#include "deploy/cli/screen/game_pictures.h"

#include <algorithm>
#include <utility>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kLargest = 1024;  // pixels

}  // namespace

absl::StatusOr<std::shared_ptr<const Renderer>> SquareRenderer(const Textures& textures, const EnvName& env, int length,
                                                               int size) {
  WorldOptions world = WorldOptions::FromEnvName(env);
  world.length = length;
  return Renderer::Create(textures, world, {size, size, env.inventory});
}

int PictureSize(const PictureRoom& room, int view) {
  const int size = std::min({room.width, room.height, kLargest});
  return std::max(2 * view, size / view * view);
}

absl::StatusOr<Moment> GamePictures::Take(const Game& game, const std::string& frame, int size) {
  if (renderer_ == nullptr || size != size_) {
    CRAFTFLEET_ASSIGN_OR_RETURN(renderer_, SquareRenderer(*textures_, env_, game.world().options().length, size));
    size_ = size;
  }
  return game.TakeMoment(absl::MakeConstSpan(reinterpret_cast<const uint8_t*>(frame.data()), frame.size()),
                         renderer_.get());
}

}  // namespace craftfleet
