// Frames in the format FRAMES_LZ4 (types.proto): for games whose receiver can't draw them.

#ifndef CRAFTFLEET_COMMON_WIRE_PACKED_FRAMES_H_
#define CRAFTFLEET_COMMON_WIRE_PACKED_FRAMES_H_

#include <cstddef>
#include <string>

#include <absl/status/status.h>

namespace craftfleet {
namespace wire {

// Compresses raw frames. They stay as they are if that does not make them shorter, so a message never grows.
void PackFrames(std::string* frames);

// Reverses PackFrames; the frames have `size` bytes then. Takes no more memory than that, whatever a sender claims.
//   InvalidArgument: the frames were neither `size` bytes nor a block of as many.
absl::Status UnpackFrames(size_t size, std::string* frames);

}  // namespace wire
}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_WIRE_PACKED_FRAMES_H_
