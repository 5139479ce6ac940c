// The cells of a world, the objects on them, and the chunks in which creatures are counted.
// Source: RULES.md, section 4.

#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include <absl/types/span.h>

#include "envserver/world/types.h"

namespace craftfleet {

inline constexpr int kChunkSize = 12;      // cells a side; the last chunks of a row or column may be smaller
inline constexpr int kNumObjectTypes = 7;  // with kNone

// A plant gives food once it has grown (Object::counter) for more steps than this.
inline constexpr int kRipeAfter = 300;

struct Object {
  ObjectType type = ObjectType::kNone;
  Variant variant = kNoVariant;
  bool removed = false;  // off the board, but its update may still run; true only inside a step
  int16_t health = 0;    // 0 or more; the player's is in its inventory, not here
  Position position;
  Position facing;      // player and arrow; a unit direction
  int32_t counter = 0;  // zombie: cooldown, skeleton: reload, plant: grown; in steps
  int64_t entered = 0;  // rank of its entry into its chunk among all entries so far
};

struct BoardCell {
  Material material = Material::kNone;
  Variant variant = kNoVariant;
  uint16_t object = 0;  // index in objects() + 1; 0: none
};

// Counts that balancing needs, kept up to date with every change.
struct Chunk {
  bool known = false;                              // whether it ever held an object
  Position min;                                    // its upper left cell
  Position max;                                    // one past its lower right cell
  std::array<int32_t, kNumMaterials> materials{};  // cells of each
  std::array<int32_t, kNumObjectTypes> objects{};  // of each type
};

// Keeps cells, objects and chunks consistent: one object a cell, each counted in its chunk. Positions must be inside
// the world unless stated otherwise. Thread-compatible: one thread at a time.
class Board {
 public:
  Board(int width, int height);

  // All cells kNone, no objects, no chunk known.
  void Clear();

  int width() const { return width_; }
  int height() const { return height_; }
  bool Inside(Position p) const {
    return static_cast<unsigned>(p.x) < static_cast<unsigned>(width_) &&
           static_cast<unsigned>(p.y) < static_cast<unsigned>(height_);
  }
  const BoardCell& cell(Position p) const { return cells_[Index(p)]; }
  // [x][y], y fastest.
  absl::Span<const BoardCell> cells() const { return cells_; }
  // kNone outside.
  Material material(Position p) const { return Inside(p) ? cell(p).material : Material::kNone; }
  // Index of the object at `p`, or -1; `p` may be outside.
  int ObjectAt(Position p) const { return Inside(p) ? cell(p).object - 1 : -1; }

  // In order of creation. After Compact() all are live.
  absl::Span<const Object> objects() const { return objects_; }
  // The objects that memory is allocated for. Never decreases.
  size_t object_room() const { return objects_.capacity(); }
  Object& object(int index) { return objects_[index]; }
  const Object& object(int index) const { return objects_[index]; }

  void SetMaterial(Position p, Material material, Variant variant) {
    BoardCell& cell = cells_[Index(p)];
    Chunk& chunk = chunks_[ChunkIndex(p)];
    --chunk.materials[static_cast<int>(cell.material)];
    ++chunk.materials[static_cast<int>(material)];
    cell.material = material;
    cell.variant = variant;
  }
  // Sets all cells, x outer, each to what a call of next() returns: a pair of material and variant.
  template <typename Next>
  void SetMaterials(const Next& next) {
    for (BoardCell& cell : cells_) std::tie(cell.material, cell.variant) = next();
    CountMaterials();
  }
  // Adds `object` at its position, a free cell, and returns its index. Its chunk becomes known.
  int Add(Object object);
  // Removes an object from the board; its index stays valid until Compact().
  void Remove(int index);
  // Moves an object to `target`, a free cell. A removed object stays where it is.
  void Move(int index, Position target);
  // Erases removed objects; the indices of later ones decrease.
  void Compact();
  // Makes a chunk known, if it is not.
  void LearnChunk(int index);

  const Chunk& chunk(int index) const { return chunks_[index]; }
  int num_chunks() const { return static_cast<int>(chunks_.size()); }
  int ChunkIndex(Position p) const { return p.x / kChunkSize * chunks_down_ + p.y / kChunkSize; }
  // Indices of the chunks that ever held an object, in the order in which they first did.
  absl::Span<const int16_t> known_chunks() const { return known_chunks_; }
  // Number of entries into chunks so far; the next entry gets it as Object::entered.
  int64_t entries() const { return entries_; }
  void set_entries(int64_t entries) { entries_ = entries; }

 private:
  int Index(Position p) const { return p.x * height_ + p.y; }
  // Counts the cells of each chunk anew.
  void CountMaterials();
  // Counts the object in its chunk as the latest to enter.
  void Enter(Object* object);

  int width_;
  int height_;
  int chunks_down_;
  std::vector<BoardCell> cells_;  // [x][y]
  std::vector<Object> objects_;
  std::vector<Chunk> chunks_;  // [x / 12][y / 12]
  std::vector<int16_t> known_chunks_;
  int64_t entries_ = 0;
  bool any_removed_ = false;
};

}  // namespace craftfleet
