// Plays a golden trace again and compares every field of every line and, where given, pictures.
// Source: the README in CRAFTFLEET_GOLDEN_DIR.

#ifndef CRAFTFLEET_TESTS_GOLDEN_TRACE_REPLAYER_H_
#define CRAFTFLEET_TESTS_GOLDEN_TRACE_REPLAYER_H_

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/statusor.h>

namespace craftfleet {

// A picture that the reference drew in one step of a trace.
struct GoldenPicture {
  int width = 0;
  int height = 0;
  bool extra = false;  // drawn beside the observation, from a copy of the stream as it was after it
  std::string bytes;   // uint8[height][width][3]
};

// Pictures of one trace by (steps in the file so far, step of the episode).
using GoldenPictures = std::map<std::pair<int64_t, int64_t>, std::vector<GoldenPicture>>;

struct ReplayReport {
  int64_t steps = 0;       // steps that agree
  int64_t frames = 0;      // observations and golden pictures that agree
  std::string difference;  // the first difference: place, field, expected and found; empty: none
};

// Replays the trace in the gzip file `path` with the textures of `texture_folder`.
//   NotFound, DataLoss, InvalidArgument: the file or the textures can't be used; the message names the file.
absl::StatusOr<ReplayReport> ReplayTrace(const std::string& path, const std::string& texture_folder,
                                         const GoldenPictures& pictures = {});

// Replays each trace listed in the frames.jsonl at `path`, from the same folder, with its pictures.
// `ReplayReport::difference` names the trace. Errors as above.
absl::StatusOr<ReplayReport> ReplayFrames(const std::string& path, const std::string& texture_folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_GOLDEN_TRACE_REPLAYER_H_
