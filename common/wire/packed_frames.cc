#include "common/wire/packed_frames.h"

#include <lz4.h>

#include <absl/strings/str_format.h>

namespace craftfleet {
namespace wire {

void PackFrames(std::string* frames) {
  if (frames->size() > LZ4_MAX_INPUT_SIZE) return;
  std::string block(frames->size(), '\0');
  // 0: the block would not be shorter.
  const int size = frames->size() < 2
                       ? 0
                       : LZ4_compress_default(frames->data(), block.data(), static_cast<int>(frames->size()),
                                              static_cast<int>(frames->size() - 1));
  if (size == 0) return;
  block.resize(size);
  *frames = std::move(block);
}

absl::Status UnpackFrames(size_t size, std::string* frames) {
  if (frames->size() == size) return absl::OkStatus();
  if (frames->size() < size && size <= LZ4_MAX_INPUT_SIZE) {
    std::string pixels(size, '\0');
    const int unpacked =
        LZ4_decompress_safe(frames->data(), pixels.data(), static_cast<int>(frames->size()), static_cast<int>(size));
    if (unpacked == static_cast<int>(size)) {
      *frames = std::move(pixels);
      return absl::OkStatus();
    }
  }
  return absl::InvalidArgumentError(
      absl::StrFormat("%d bytes, want %d or a shorter LZ4 block of as many", frames->size(), size));
}

}  // namespace wire
}  // namespace craftfleet
