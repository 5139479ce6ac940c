// A client that plays games on an environment server.

#ifndef CRAFTFLEET_TESTS_BENCH_WIRE_GAME_PLAYER_H_
#define CRAFTFLEET_TESTS_BENCH_WIRE_GAME_PLAYER_H_

#include <cstdint>
#include <string>
#include <vector>

#include "actor/env_client.h"
#include "common/base/types.h"
#include "craftfleet/v1/learner.pb.h"
#include "tests/bench/wire/measure.h"

namespace craftfleet {

constexpr int kFrameBytes = 64 * 64 * 3;
constexpr size_t kSnapshotBytes = 8000;  // as in the row about steps with snapshots

// Plays `lanes` games with a fixed sequence of actions. `server` must be up. Thread-compatible.
class GamePlayer {
 public:
  GamePlayer(const std::string& server, int number, int lanes, FrameFormat frames);

  // One step of each game. Counts the bytes of frames or scene records.
  Turn Step(bool snapshot = false);
  // The same with snapshots. Counts only the bytes of snapshots.
  Turn StepAndSave();

  // The observations before the next step: pixels uint8[lanes,64,64,3], or the scene record of each lane.
  const std::string& frames() const { return frames_; }
  const std::vector<std::string>& records() { return client_.records(); }

 private:
  EnvClient client_;
  std::vector<int> lanes_;
  StepBatch batch_;
  std::string frames_;
  int64_t steps_ = 0;
};

// A fragment of `steps` steps of a game, which it plays on an environment server of its own in this process. The frames
// are raw or scene records; the snapshot has kSnapshotBytes. No actor is named.
v1::FragmentMessage PlayFragment(int steps, FrameFormat frames);

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_BENCH_WIRE_GAME_PLAYER_H_
