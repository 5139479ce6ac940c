#include "envserver/moment_taker.h"

#include <algorithm>
#include <string>

namespace craftfleet {
Moment MomentTaker::Take(const Game& game, absl::Span<const uint8_t> frame) const {
  const World& world = game.world();
  Moment moment;
  moment.frame.assign(reinterpret_cast<const char*>(frame.data()), frame.size());
  if (pictures_ != nullptr) {
    moment.picture.resize(pictures_->frame_bytes());
    RandomStream random = game.before_picture();
    pictures_->Render(world, &random, FrameBytes(&moment.picture));
  }
  moment.semantic.resize(world.options().width * world.options().height);
  world.SemanticView(FrameBytes(&moment.semantic));
  moment.player_x = world.player_position().x;
  moment.player_y = world.player_position().y;
  const Player& player = world.player();
  std::copy(player.inventory.begin(), player.inventory.end(), moment.inventory.begin());
  moment.achievements = player.achievements;
  return moment;
}

}  // namespace craftfleet
