// The games that a person plays with `craftfleet play`.

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "actor/recording/episode_recorder.h"
#include "common/base/crafter.h"
#include "common/config/env_name.h"
#include "deploy/cli/screen/game_pictures.h"
#include "deploy/cli/screen/game_text.h"
#include "deploy/cli/screen/screen.h"
#include "envserver/game.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// Episodes of one environment, one after the other. Thread-compatible.
class PlaySession {
 public:
  struct Options {
    EnvName env;
    int64_t seed = 0;     // of the environment, as for `craftfleet eval`
    int64_t episode = 1;  // the first one, from 1
    std::shared_ptr<const Textures> textures;
    std::string record_folder;  // for a video and a NumPy file of each episode; empty: none
    absl::Time start;           // in the names of these files
  };
  // InvalidArgument: an option; other codes as Renderer::Create and EpisodeRecorder::Create.
  static absl::StatusOr<std::unique_ptr<PlaySession>> Create(const Options& options);

  // Plays a step. Does nothing once the episode has ended.
  absl::Status Step(Action action);
  // Starts the next episode, also before the current one has ended.
  absl::Status StartNextEpisode();
  // Ends the recordings. Nothing may be played after it.
  absl::Status Finish();

  bool ended() const { return end_ != StepEnd::kNone; }
  const World& world() const { return game_.world(); }

  // The picture of the game, uint8[size,size,3]. `size` in pixels, 2 * view..2048.
  absl::StatusOr<std::string> Picture(int size);
  // The state of the game as text: step, reward, needs, inventory, what happened.
  std::vector<TextLine> Panel() const;
  // One line: how the current episode went.
  std::string Summary() const;

 private:
  PlaySession(const Options& options, Game game, std::string frame)
      : options_(options),
        game_(std::move(game)),
        frame_(std::move(frame)),
        shown_(options.textures, options.env),
        recorded_(options.textures, options.env) {}

  absl::Status StartRecording();
  // The state of the game for the recorder.
  absl::StatusOr<Moment> Record();

  const Options options_;
  Game game_;
  std::string frame_;  // uint8[64,64,3]: what an agent sees
  StepEnd end_ = StepEnd::kNone;
  RecentEvents events_{6};
  GamePictures shown_;
  GamePictures recorded_;
  std::unique_ptr<EpisodeRecorder> recorder_;  // null: nothing is recorded
};

}  // namespace craftfleet
