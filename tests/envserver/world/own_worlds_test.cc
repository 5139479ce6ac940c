// Worlds that the plain Python model generated: they need nothing from outside the checkout.

#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "envserver/world/world.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/trace_fields.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using nlohmann::json;

WorldOptions OptionsOf(const json& row) {
  WorldOptions options =
      WorldOptions::FromEnvName(*EnvName::Parse("crafter:numbers=" + row["numbers"].get<std::string>()));
  options.width = row["area"][0].get<int>();
  options.height = row["area"][1].get<int>();
  options.view_width = row["view"][0].get<int>();
  options.view_height = row["view"][1].get<int>();
  options.appearance = row["letters"].get<std::string>();
  for (int i = 0; i < kNumVariants; ++i) options.percentages[i] = row["percentages"][i].get<int>();
  return options;
}

TEST(OwnWorlds, AreGeneratedAsByThePythonModel) {
  std::ifstream file(CRAFTFLEET_SOURCE_DIR "/tests/data/own/worlds.jsonl");
  std::string line;
  int count = 0;
  while (std::getline(file, line)) {
    SCOPED_TRACE(line);
    ++count;
    const json row = json::parse(line);
    absl::StatusOr<World> world = World::Create(OptionsOf(row), row["seed"].get<int64_t>());
    ASSERT_THAT(world, IsOk());
    WorldEditor::State(&*world).episode = row["ep"].get<int64_t>() - 1;
    world->Reset();
    const json fields = TraceFields(*world);
    for (const char* key : {"eseed", "nobj", "mat", "obj", "mvar", "ovar", "rng", "mtp"}) {
      EXPECT_EQ(fields[key], row[key]) << key;
    }
  }
  EXPECT_GE(count, 50);
}

}  // namespace
}  // namespace craftfleet
