#include "deploy/cli/top/top_state.h"

#include <algorithm>
#include <array>
#include <cstddef>

#include <absl/strings/strip.h>

namespace craftfleet {
namespace {

constexpr std::array<absl::string_view, kNumTopColumns> kNames = {"role", "name", "state", "steps", "lanes",
                                                                  "lag",  "mem",  "err",   "seen"};
constexpr char kCtrlC = 3;

void Sort(int by, TopState* state) {
  const int column = (static_cast<int>(state->sort) + by + kNumTopColumns) % kNumTopColumns;
  state->sort = static_cast<TopColumn>(column);
  state->scroll = 0;
}

void HandleKey(char key, TopState* state) {
  switch (key) {
    case 'q':
    case kCtrlC:
      state->quit = true;
      break;
    case 'p':
    case ' ':
      state->paused = !state->paused;
      break;
    case 's':
      Sort(1, state);
      break;
    case 'S':
      Sort(-1, state);
      break;
    case 'r':
      state->reverse = !state->reverse;
      break;
    case 'h':
    case '?':
      state->help = !state->help;
      break;
    case 'j':
      ++state->scroll;
      break;
    case 'k':
      --state->scroll;
      break;
    default:
      break;
  }
}

}  // namespace

absl::string_view TopColumnName(TopColumn column) { return kNames[static_cast<size_t>(column)]; }

std::optional<TopColumn> TopColumnByName(absl::string_view name) {
  const auto* const found = std::find(kNames.begin(), kNames.end(), name);
  if (found == kNames.end()) return std::nullopt;
  return static_cast<TopColumn>(found - kNames.begin());
}

void HandleKeys(absl::string_view bytes, int page, TopState* state) {
  while (!bytes.empty()) {
    if (absl::ConsumePrefix(&bytes, "\x1b[A")) {
      --state->scroll;
    } else if (absl::ConsumePrefix(&bytes, "\x1b[B")) {
      ++state->scroll;
    } else if (absl::ConsumePrefix(&bytes, "\x1b[5~")) {
      state->scroll -= page;
    } else if (absl::ConsumePrefix(&bytes, "\x1b[6~")) {
      state->scroll += page;
    } else {
      HandleKey(bytes.front(), state);
      bytes.remove_prefix(1);
    }
    state->scroll = std::max(0, state->scroll);
  }
}

}  // namespace craftfleet
