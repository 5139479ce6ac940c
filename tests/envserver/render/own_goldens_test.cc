// Generated worlds, and pictures of these and of staged situations, against the plain Python model with our own
// textures. Source: tests/data/own; format: tests/model/make_goldens.py.

#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/io/files.h"
#include "common/io/paths.h"
#include "envserver/render/renderer.h"
#include "envserver/world/daylight.h"
#include "tests/fakes/cpu_paths.h"
#include "tests/fakes/gzip_file.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/test_paths.h"
#include "tests/golden/trace_fields.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using nlohmann::json;

std::string DataPath(const std::string& name) { return SourcePath("tests/data/own/" + name); }

std::vector<json> Rows(const std::string& name) {
  const auto text = ReadFile(DataPath(name));
  EXPECT_THAT(text, IsOk());
  std::istringstream lines(*text);
  std::vector<json> rows;
  for (std::string line; std::getline(lines, line);) rows.push_back(json::parse(line));
  return rows;
}

const Textures& OwnTextures() {
  static const auto& textures = *new std::shared_ptr<const Textures>(*Textures::Load(*DefaultTextureDir()));
  return *textures;
}

// The options of a row of worlds.jsonl.
WorldOptions OptionsOf(const json& row) {
  EnvName name;
  name.numbers = row.at("numbers");
  WorldOptions options = WorldOptions::FromEnvName(name);
  options.appearance = row.at("letters");
  options.percentages = row.at("percentages");
  options.width = row.at("area")[0];
  options.height = row.at("area")[1];
  return options;
}

void SetView(const json& view, WorldOptions* options) {
  options->view_width = view[0];
  options->view_height = view[1];
}

World WorldOf(const json& row, const WorldOptions& options) {
  absl::StatusOr<World> world = World::Create(options, row.at("seed"));
  EXPECT_THAT(world, IsOk());
  WorldEditor::State(&*world).episode = row.at("ep").get<int64_t>() - 1;
  world->Reset();
  return *std::move(world);
}

void PutObjects(const json& objects, Board* board) {
  for (int i = static_cast<int>(board->objects().size()) - 1; i >= 0; --i) board->Remove(i);
  board->Compact();
  for (const json& row : objects) {
    Object object;
    object.type = static_cast<ObjectType>(row[0].get<int>());
    object.position = {row[1], row[2]};
    object.facing = {row[3], row[4]};
    object.variant = row[5].get<Variant>();
    object.health = row[6];
    object.counter = row[7];
    board->Add(object);
  }
}

// The situation of a row of frames.jsonl, in a world made from its row of worlds.jsonl.
void Stage(const json& row, World* world) {
  WorldState& state = WorldEditor::State(world);
  for (const json& cell : row.at("mat")) {
    state.board.SetMaterial({cell[0], cell[1]}, static_cast<Material>(cell[2].get<int>()), cell[3].get<Variant>());
  }
  PutObjects(row.at("objs"), &state.board);
  state.step = row.at("step");
  state.daylight = Daylight(state.step);
  state.player.sleeping = row.at("sleeping") == 1;
  state.player.inventory = row.at("inv");
  state.random = RandomStream(row.at("stream")[0].get<uint32_t>());
  for (int word = 0; word < row.at("stream")[1]; ++word) state.random.Below(2);
}

std::string NextDraws(RandomStream stream) {
  double draws[8];
  for (double& draw : draws) draw = stream.Uniform();
  return CrcText(absl::string_view(reinterpret_cast<const char*>(draws), sizeof(draws)));
}

std::vector<uint8_t> Draw(World* world, const RenderOptions& options) {
  const auto renderer = Renderer::Create(OwnTextures(), world->options(), options);
  EXPECT_THAT(renderer, IsOk());
  std::vector<uint8_t> frame((*renderer)->frame_bytes(), 77);
  (*renderer)->Render(*world, &world->random(), absl::MakeSpan(frame));
  return frame;
}

RenderOptions SizeOf(const json& row) {
  RenderOptions options;
  options.width = row.at("size")[0];
  options.height = row.at("size")[1];
  return options;
}

class OwnGoldens : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(OwnGoldens);

TEST_P(OwnGoldens, GeneratedWorldsAndTheirFirstPicturesAgree) {
  const std::vector<json> rows = Rows("worlds.jsonl");
  ASSERT_GE(rows.size(), 70u);
  for (const json& row : rows) {
    WorldOptions options = OptionsOf(row);
    SetView(row.at("view"), &options);
    World world = WorldOf(row, options);
    const json fields = TraceFields(world);
    for (const char* key : {"eseed", "nobj", "mat", "obj", "mvar", "ovar", "rng", "mtp"}) {
      EXPECT_EQ(fields[key], row[key]) << key << " of " << row.dump();
    }
    EXPECT_EQ(CrcText(Draw(&world, SizeOf(row))), row.at("img")) << row.dump();
  }
}

TEST_P(OwnGoldens, PicturesOfStagedSituationsAgree) {
  const std::vector<json> worlds = Rows("worlds.jsonl");
  const std::vector<json> rows = Rows("frames.jsonl");
  const auto pixels = ReadGzipFile(DataPath("frames.bin.gz"));
  ASSERT_THAT(pixels, IsOk());
  ASSERT_GE(rows.size(), 89u);
  for (const json& row : rows) {
    SCOPED_TRACE(row.at("name").get<std::string>());
    const json& world_row = worlds.at(row.at("world"));
    WorldOptions options = OptionsOf(world_row);
    SetView(row.at("view"), &options);
    World world = WorldOf(world_row, options);
    Stage(row, &world);
    EXPECT_EQ(world.daylight(), row.at("day"));

    RenderOptions picture = SizeOf(row);
    picture.inventory = row.at("inventory") == 1;
    const std::vector<uint8_t> frame = Draw(&world, picture);
    EXPECT_EQ(CrcText(frame), row.at("crc"));
    EXPECT_EQ(world.random().position(), row.at("mtp"));
    EXPECT_EQ(NextDraws(world.random()), row.at("rng"));
    if (row.at("off").is_null()) continue;
    const absl::string_view golden = absl::string_view(*pixels).substr(row.at("off").get<size_t>(), frame.size());
    for (size_t i = 0; i < frame.size(); ++i) {
      ASSERT_EQ(frame[i], static_cast<uint8_t>(golden[i]))
          << "x " << i / 3 % picture.width << ", y " << i / 3 / picture.width << ", channel " << i % 3;
    }
  }
}

}  // namespace
}  // namespace craftfleet
