#include "envserver/game.h"

#include <algorithm>
#include <optional>
#include <utility>

#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

// A game begins anew as soon as it ends, so none is saved at its end. Another step would make a longer episode than the
// options allow.
absl::Status CheckGoesOn(const World& world) {
  if (world.end() == StepEnd::kNone) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("snapshot: of a game that has ended, with health ", world.player().health(),
                                          " at step ", world.step()));
}

}  // namespace

absl::StatusOr<Game> Game::Create(std::shared_ptr<const Renderer> renderer, int64_t seed, absl::Span<uint8_t> frame,
                                  int64_t episode) {
  CRAFTFLEET_ASSIGN_OR_RETURN(World world, World::Create(renderer->world_options(), seed, episode));
  Game game(std::move(renderer), std::move(world));
  game.Draw(frame);
  return game;
}

void Game::Reset(absl::Span<uint8_t> frame) {
  world_.Reset();
  Draw(frame);
}

StepOutcome Game::Step(Action action, absl::Span<uint8_t> frame) {
  const StepOutcome outcome = world_.Step(action);
  Draw(frame);
  return outcome;
}

Game::PlayedStep Game::StepAndAutoReset(Action action, absl::Span<uint8_t> frame, std::string* last_frames,
                                        const std::function<void()>& on_step) {
  PlayedStep played{world_.Step(action), std::nullopt};
  const StepEnd end = played.outcome.end;
  if (end != StepEnd::kTerminated || on_step != nullptr) Draw(frame);
  if (on_step != nullptr) on_step();
  if (end == StepEnd::kTruncated) last_frames->append(reinterpret_cast<const char*>(frame.data()), frame.size());
  if (end != StepEnd::kNone) {
    played.episode = EndedEpisode();
    Reset(frame);
  }
  return played;
}

Game::PlayedStep Game::StepAndRecord(Action action, bool anew, std::string* frames, std::string* last_frames) {
  PlayedStep played{world_.Step(action), std::nullopt};
  const StepEnd end = played.outcome.end;
  if (anew) scene_writer_.Restart();
  if (end != StepEnd::kTerminated) {
    PassPicture();
    AppendRecord(end == StepEnd::kTruncated ? last_frames : frames);
  }
  if (end != StepEnd::kNone) {
    played.episode = EndedEpisode();
    world_.Reset();
    PassPicture();
    Record(frames);
  }
  return played;
}

void Game::Record(std::string* frames) {
  scene_writer_.Restart();
  AppendRecord(frames);
}

void Game::AppendRecord(std::string* frames) {
  Scene scene;
  renderer_->Capture(world_, &scene);
  scene_writer_.Append(*renderer_, scene, before_picture(), frames);
}

Episode Game::EndedEpisode() const {
  Episode episode;
  episode.length = world_.step();
  episode.reward = world_.episode_reward();
  episode.achievements = world_.player().achievements;
  return episode;
}

std::string Game::Save() const { return SealSnapshot(env_digest(), world_.Save(before_picture())); }

absl::Status Game::Restore(absl::string_view snapshot, absl::Span<uint8_t> frame) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::string_view game, OpenSnapshot(env_digest(), snapshot));
  World restored = world_;
  CRAFTFLEET_RETURN_IF_ERROR(restored.Restore(game));
  CRAFTFLEET_RETURN_IF_ERROR(CheckGoesOn(restored));
  world_ = std::move(restored);
  Draw(frame);
  return absl::OkStatus();
}

Moment Game::TakeMoment(absl::Span<const uint8_t> frame, const Renderer* larger) const {
  Moment moment;
  moment.frame.assign(reinterpret_cast<const char*>(frame.data()), frame.size());
  if (larger != nullptr) {
    moment.picture.resize(larger->frame_bytes());
    RandomStream random = before_picture();
    larger->Render(world_, &random, FrameBytes(&moment.picture));
  }
  moment.semantic.resize(world_.options().width * world_.options().height);
  world_.SemanticView(FrameBytes(&moment.semantic));
  moment.player_x = world_.player_position().x;
  moment.player_y = world_.player_position().y;
  const Player& player = world_.player();
  std::copy(player.inventory.begin(), player.inventory.end(), moment.inventory.begin());
  moment.achievements = player.achievements;
  return moment;
}

void Game::Draw(absl::Span<uint8_t> frame) {
  if (Renderer::DrawsNoise(world_)) before_picture_ = world_.random();
  renderer_->Render(world_, &world_.random(), frame);
}

void Game::PassPicture() {
  if (!Renderer::DrawsNoise(world_)) return;
  before_picture_ = world_.random();
  world_.random().Skip(renderer_->noise_words());
}

}  // namespace craftfleet
