// The cost of a step of the game, whole and by part, on one thread. Usage and results: tests/bench/README.md.

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>

#include "common/base/check.h"
#include "common/base/cpu_path.h"
#include "common/io/paths.h"
#include "envserver/game.h"
#include "envserver/world/balance.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

constexpr int kSeeds = 8;
constexpr int kNightStep = 200;  // daylight 0.02

Action RandomAction(RandomStream* random) { return static_cast<Action>(random->Below(kNumActions)); }

std::shared_ptr<const Renderer> MakeRenderer() {
  const auto folder = DefaultTextureDir();
  CRAFTFLEET_CHECK(folder.ok());
  const auto textures = Textures::Load(*folder);
  CRAFTFLEET_CHECK(textures.ok());
  return *Renderer::Create(**textures, WorldOptions(), RenderOptions());
}

// Worlds after `steps` random steps of an episode, with living players.
std::vector<World> PlayedWorlds(int steps) {
  std::vector<World> worlds;
  worlds.reserve(kSeeds);
  RandomStream actions(1);
  for (int seed = 0; seed < kSeeds; ++seed) {
    worlds.push_back(*World::Create(WorldOptions(), seed));
    for (int i = 0; i < steps; ++i) {
      WorldEditor::State(&worlds.back()).player.item(Item::kHealth) = kMaxItem;
      worlds.back().Step(RandomAction(&actions));
    }
  }
  return worlds;
}

// Forces the CPU path with the number of the benchmark's argument, or skips the benchmark where the CPU lacks it.
void ForcePath(benchmark::State* state, std::optional<ScopedCpuPath>* forced) {
  const CpuPath path = kCpuPaths[state->range(0)];
  state->SetLabel(CpuPathName(path));
  if (CpuHas(path)) {
    forced->emplace(path);
  } else {
    state->SkipWithError("this CPU has no such path");
  }
}

// Random actions, pictures and resets: items_per_second is steps a second.
void WholeGame(benchmark::State& state) {
  std::optional<ScopedCpuPath> forced;
  ForcePath(&state, &forced);
  const auto renderer = MakeRenderer();
  std::vector<uint8_t> frame(renderer->frame_bytes());
  std::string last_frames;
  std::vector<Game> games;
  games.reserve(kSeeds);
  for (int seed = 0; seed < kSeeds; ++seed) games.push_back(*Game::Create(renderer, seed, absl::MakeSpan(frame)));
  RandomStream actions(1);
  int64_t episodes = 0;
  while (state.KeepRunning()) {
    for (Game& game : games) {
      const auto played = game.StepAndAutoReset(RandomAction(&actions), absl::MakeSpan(frame), &last_frames);
      episodes += played.episode.has_value();
    }
    last_frames.clear();
    benchmark::DoNotOptimize(frame.data());
  }
  state.SetItemsProcessed(state.iterations() * kSeeds);
  state.counters["steps_per_episode"] = static_cast<double>(state.iterations()) * kSeeds / episodes;
}

// Steps without balancing.
void Rules(benchmark::State& state) {
  std::vector<World> worlds = PlayedWorlds(50);
  RandomStream actions(1);
  while (state.KeepRunning()) {
    for (World& world : worlds) {
      WorldState& world_state = WorldEditor::State(&world);
      world_state.player.item(Item::kHealth) = kMaxItem;
      world_state.step -= world_state.step % 10 == 9 ? 9 : 0;
      benchmark::DoNotOptimize(world.Step(RandomAction(&actions)));
    }
  }
  state.SetItemsProcessed(state.iterations() * kSeeds);
}

// Balancing alone, which is done in every tenth step.
void Balance(benchmark::State& state) {
  std::vector<World> worlds = PlayedWorlds(static_cast<int>(state.range(0)));
  while (state.KeepRunning()) {
    for (World& world : worlds) {
      BalanceChunks(&WorldEditor::State(&world));
      WorldEditor::State(&world).board.Compact();
    }
  }
  state.SetItemsProcessed(state.iterations() * kSeeds);
}

void Reset(benchmark::State& state) {
  std::optional<ScopedCpuPath> forced;
  ForcePath(&state, &forced);
  World world = *World::Create(WorldOptions(), 0);
  while (state.KeepRunning()) world.Reset();
  state.SetItemsProcessed(state.iterations());
}

void Picture(benchmark::State& state, int steps, bool sleeping) {
  const auto renderer = MakeRenderer();
  std::vector<uint8_t> frame(renderer->frame_bytes());
  std::vector<World> worlds = PlayedWorlds(steps);
  for (World& world : worlds) WorldEditor::State(&world).player.sleeping = sleeping;
  while (state.KeepRunning()) {
    for (World& world : worlds) {
      renderer->Render(world, &world.random(), absl::MakeSpan(frame));
      benchmark::DoNotOptimize(frame.data());
    }
  }
  state.SetItemsProcessed(state.iterations() * kSeeds);
}

BENCHMARK(WholeGame)->ArgName("cpu")->DenseRange(0, 2)->MinTime(5);
BENCHMARK(Rules);
BENCHMARK(Balance)->Arg(50)->Arg(kNightStep);
BENCHMARK(Reset)->ArgName("cpu")->DenseRange(0, 2);
BENCHMARK_CAPTURE(Picture, day, 50, false);
BENCHMARK_CAPTURE(Picture, night, kNightStep, false);
BENCHMARK_CAPTURE(Picture, asleep_by_day, 50, true);
BENCHMARK_CAPTURE(Picture, asleep_by_night, kNightStep, true);

}  // namespace
}  // namespace craftfleet
