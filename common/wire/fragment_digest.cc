#include "common/wire/fragment_digest.h"

#include <cstring>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet::wire {
namespace {

// FNV-1a over words of 8 bytes, whose high bits are mixed in too.
class Digest {
 public:
  void AddWord(uint64_t word) {
    value_ = (value_ ^ word) * 1099511628211U;
    value_ ^= value_ >> 32;
  }
  // With its size, so that bytes can't move from one field to the next.
  void Add(absl::string_view bytes) {
    AddWord(bytes.size());
    for (; bytes.size() >= sizeof(uint64_t); bytes.remove_prefix(sizeof(uint64_t))) {
      uint64_t word;
      std::memcpy(&word, bytes.data(), sizeof(word));
      AddWord(word);
    }
    uint64_t rest = 0;
    if (!bytes.empty()) std::memcpy(&rest, bytes.data(), bytes.size());  // none may be null
    AddWord(rest);
  }
  template <typename T>
  void Add(const std::vector<T>& values) {
    Add(absl::string_view(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)));
  }
  uint64_t value() const { return value_; }

 private:
  uint64_t value_ = 14695981039346656037U;
};

}  // namespace

uint64_t FragmentDigest(const Fragment& fragment) {
  Digest digest;
  digest.AddWord(static_cast<uint64_t>(fragment.lane));
  digest.AddWord(static_cast<uint64_t>(fragment.number));
  digest.AddWord(static_cast<uint64_t>(fragment.policy_version));
  digest.Add(fragment.frames);
  digest.Add(fragment.actions);
  for (const auto* values : {&fragment.log_probs, &fragment.values, &fragment.rewards, &fragment.truncation_values,
                             &fragment.states, &fragment.snapshot.state}) {
    digest.Add(*values);
  }
  digest.Add(fragment.ends);
  digest.Add(std::vector<float>{fragment.bootstrap_value});
  for (const Episode& episode : fragment.episodes) {
    digest.AddWord(static_cast<uint64_t>(episode.step));
    digest.AddWord(static_cast<uint64_t>(episode.length));
    digest.Add(std::vector<double>{episode.reward});
    digest.Add(std::vector<int32_t>(episode.achievements.begin(), episode.achievements.end()));
  }
  digest.Add(fragment.snapshot.game);
  return digest.value();
}

}  // namespace craftfleet::wire
