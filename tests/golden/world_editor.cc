#include "tests/golden/world_editor.h"

#include <algorithm>
#include <cstdint>
#include <string>

#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "envserver/world/creatures.h"
#include "envserver/world/daylight.h"

namespace craftfleet {
namespace {

using nlohmann::json;

Position PositionOf(const json& values) { return {values.at(0).get<int>(), values.at(1).get<int>()}; }

absl::Status BadEdit(const std::string& key, const json& value) {
  return absl::InvalidArgumentError(absl::StrCat("set line: cannot apply ", key, " ", value.dump()));
}

absl::Status EditCells(const json& edit, Board* board) {
  for (const json& entry : edit.value("mat", json::array())) {
    const int material = entry.at(2).get<int>();
    if (!board->Inside(PositionOf(entry)) || material < 1 || material >= kNumMaterials) return BadEdit("mat", entry);
    board->SetMaterial(PositionOf(entry), static_cast<Material>(material), kNoVariant);
  }
  return absl::OkStatus();
}

absl::Status AddObject(const json& entry, Board* board) {
  const int type = entry.at(0).get<int>();
  const Position position = {entry.at(1).get<int>(), entry.at(2).get<int>()};
  const bool known = type >= static_cast<int>(ObjectType::kCow) && type <= static_cast<int>(ObjectType::kPlant);
  if (!known || !board->Inside(position) || board->ObjectAt(position) >= 0) return BadEdit("add", entry);
  Object object = MakeObject(static_cast<ObjectType>(type), position);
  if (object.type == ObjectType::kArrow) object.facing = {entry.at(3).get<int>(), entry.at(4).get<int>()};
  board->Add(object);
  return absl::OkStatus();
}

absl::Status EditObjects(const json& edit, Board* board) {
  for (const json& entry : edit.value("rm", json::array())) {
    const int index = board->ObjectAt(PositionOf(entry));
    if (index <= 0) return BadEdit("rm", entry);
    board->Remove(index);
    board->Compact();
  }
  for (const json& entry : edit.value("add", json::array())) CRAFTFLEET_RETURN_IF_ERROR(AddObject(entry, board));
  for (const json& entry : edit.value("hp", json::array())) {
    const int index = board->ObjectAt(PositionOf(entry));
    if (index <= 0) return BadEdit("hp", entry);
    board->object(index).health = entry.at(2).get<int16_t>();
  }
  for (const json& entry : edit.value("aux", json::array())) {
    const int index = board->ObjectAt(PositionOf(entry));
    if (index <= 0) return BadEdit("aux", entry);
    board->object(index).counter = entry.at(2).get<int32_t>();
  }
  return absl::OkStatus();
}

absl::Status EditPlayer(const json& edit, WorldState* state) {
  Board& board = state->board;
  if (edit.contains("pos")) {
    const Position target = PositionOf(edit["pos"]);
    const bool own = target == board.object(0).position;
    if (!board.Inside(target) || (!own && board.ObjectAt(target) >= 0)) return BadEdit("pos", edit["pos"]);
    if (!own) board.Move(0, target);
  }
  if (edit.contains("face")) board.object(0).facing = PositionOf(edit["face"]);
  Player& player = state->player;
  const json amounts = edit.value("inv", json::object());
  for (const auto& [name, amount] : amounts.items()) {
    const auto* item = std::find(kItemNames.begin(), kItemNames.end(), name);
    if (item == kItemNames.end()) return BadEdit("inv", name);
    player.inventory[item - kItemNames.begin()] = amount.get<int8_t>();
  }
  if (edit.contains("ctr")) {
    player.hunger = edit["ctr"].at(0).get<double>();
    player.thirst = edit["ctr"].at(1).get<double>();
    player.fatigue = edit["ctr"].at(2).get<double>();
    player.recover = edit["ctr"].at(3).get<double>();
  }
  if (edit.contains("sleep")) player.sleeping = edit["sleep"].get<int>() != 0;
  return absl::OkStatus();
}

}  // namespace

absl::Status WorldEditor::Apply(const json& edit, World* world) {
  WorldState& state = world->state_;
  CRAFTFLEET_RETURN_IF_ERROR(EditCells(edit, &state.board));
  CRAFTFLEET_RETURN_IF_ERROR(EditObjects(edit, &state.board));
  CRAFTFLEET_RETURN_IF_ERROR(EditPlayer(edit, &state));
  if (edit.contains("step")) {
    state.step = edit["step"].get<int64_t>();
    state.daylight = Daylight(state.step);
  }
  return absl::OkStatus();
}

void WorldEditor::FillWithPlants(World* world) {
  Board& board = State(world).board;
  for (int x = 0; x < board.width(); ++x) {
    for (int y = 0; y < board.height(); ++y) {
      Object plant;
      plant.type = ObjectType::kPlant;
      plant.position = {x, y};
      if (board.ObjectAt(plant.position) < 0) board.Add(plant);
    }
  }
}

}  // namespace craftfleet
