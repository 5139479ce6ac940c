// A screen that presses given keys and remembers what it was shown.

#pragma once

#include <deque>
#include <utility>
#include <vector>

#include "deploy/cli/screen/screen.h"
#include "tests/fakes/fake_clock.h"

namespace craftfleet {

// Presses a key each time it is asked, and closes itself after the last one. kNoKey waits for the whole timeout, which
// takes no time but that of the clock.
class FakeScreen : public Screen {
 public:
  FakeScreen(std::deque<Key> keys, FakeClock* clock) : keys_(std::move(keys)), clock_(clock) {}

  PictureRoom Room() const override { return {100, 80}; }
  absl::Status Show(const View& view) override {
    shown_.push_back(view);
    return absl::OkStatus();
  }
  Key ReadKey(absl::Duration timeout) override {
    if (keys_.empty()) return kCloseKey;
    const Key key = keys_.front();
    keys_.pop_front();
    if (key == kNoKey) clock_->Advance(timeout);
    return key;
  }

  const std::vector<View>& shown() const { return shown_; }

 private:
  std::deque<Key> keys_;
  FakeClock* const clock_;
  std::vector<View> shown_;
};

}  // namespace craftfleet
