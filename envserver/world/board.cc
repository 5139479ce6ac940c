#include "envserver/world/board.h"

#include <algorithm>

#include "common/base/check.h"

namespace craftfleet {
namespace {

constexpr int kReservedObjects = 128;  // a step allocates no memory until there are more

}  // namespace

Board::Board(int width, int height)
    : width_(width),
      height_(height),
      chunks_down_((height + kChunkSize - 1) / kChunkSize),
      cells_(static_cast<size_t>(width) * height) {
  for (int x = 0; x < width; x += kChunkSize) {
    for (int y = 0; y < height; y += kChunkSize) {
      Chunk chunk;
      chunk.min = {x, y};
      chunk.max = {std::min(x + kChunkSize, width), std::min(y + kChunkSize, height)};
      chunks_.push_back(chunk);
    }
  }
  objects_.reserve(kReservedObjects);
  known_chunks_.reserve(chunks_.size());
  Clear();
}

void Board::Clear() {
  std::fill(cells_.begin(), cells_.end(), BoardCell());
  objects_.clear();
  for (Chunk& chunk : chunks_) {
    chunk.known = false;
    chunk.objects.fill(0);
    chunk.materials.fill(0);
    chunk.materials[0] = (chunk.max.x - chunk.min.x) * (chunk.max.y - chunk.min.y);
  }
  known_chunks_.clear();
  entries_ = 0;
  any_removed_ = false;
}

int Board::Add(Object object) {
  BoardCell& cell = cells_[Index(object.position)];
  CRAFTFLEET_CHECK(cell.object == 0);
  Enter(&object);
  objects_.push_back(object);
  cell.object = static_cast<uint16_t>(objects_.size());
  return static_cast<int>(objects_.size()) - 1;
}

void Board::Remove(int index) {
  Object& object = objects_[index];
  if (object.removed) return;
  object.removed = true;
  any_removed_ = true;
  cells_[Index(object.position)].object = 0;
  --chunks_[ChunkIndex(object.position)].objects[static_cast<int>(object.type)];
}

void Board::Move(int index, Position target) {
  Object& object = objects_[index];
  if (object.removed) return;
  const int from = ChunkIndex(object.position);
  cells_[Index(object.position)].object = 0;
  cells_[Index(target)].object = static_cast<uint16_t>(index + 1);
  object.position = target;
  if (ChunkIndex(target) != from) {
    --chunks_[from].objects[static_cast<int>(object.type)];
    Enter(&object);
  }
}

void Board::Compact() {
  if (!any_removed_) return;
  any_removed_ = false;
  objects_.erase(std::remove_if(objects_.begin(), objects_.end(), [](const Object& object) { return object.removed; }),
                 objects_.end());
  for (size_t i = 0; i < objects_.size(); ++i) {
    cells_[Index(objects_[i].position)].object = static_cast<uint16_t>(i + 1);
  }
}

void Board::CountMaterials() {
  for (Chunk& chunk : chunks_) {
    chunk.materials.fill(0);
    for (int x = chunk.min.x; x < chunk.max.x; ++x) {
      for (int y = chunk.min.y; y < chunk.max.y; ++y) ++chunk.materials[static_cast<int>(cell({x, y}).material)];
    }
  }
}

void Board::LearnChunk(int index) {
  if (chunks_[index].known) return;
  chunks_[index].known = true;
  known_chunks_.push_back(static_cast<int16_t>(index));
}

void Board::Enter(Object* object) {
  const int index = ChunkIndex(object->position);
  LearnChunk(index);
  ++chunks_[index].objects[static_cast<int>(object->type)];
  object->entered = entries_++;
}

}  // namespace craftfleet
