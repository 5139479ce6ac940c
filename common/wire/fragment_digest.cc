#include "common/wire/fragment_digest.h"

#include <array>
#include <cstring>
#include <vector>

#include <absl/strings/string_view.h>

#include "common/base/fnv1a.h"

namespace craftfleet::wire {
namespace {

class Digest {
 public:
  void AddWord(uint64_t word) { value_ = Fnv1aWord(value_, word); }
  // Includes the size, so that bytes moved from one field to the next change the digest.
  void Add(absl::string_view bytes) {
    AddWord(bytes.size());
    if (bytes.size() >= sizeof(Words)) AddInStreams(&bytes);
    for (; bytes.size() >= sizeof(uint64_t); bytes.remove_prefix(sizeof(uint64_t))) {
      uint64_t word;
      std::memcpy(&word, bytes.data(), sizeof(word));
      AddWord(word);
    }
    uint64_t rest = 0;
    if (!bytes.empty()) std::memcpy(&rest, bytes.data(), bytes.size());  // data() of an empty one may be null
    AddWord(rest);
  }
  template <typename T>
  void Add(const std::vector<T>& values) {
    Add(absl::string_view(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)));
  }
  uint64_t value() const { return value_; }

 private:
  using Words = std::array<uint64_t, 8>;

  // Adds the whole rows of words at the beginning of `bytes`, and removes them. A hash of each column: a CPU computes
  // these side by side, while one hash would wait for its own last step at each word.
  void AddInStreams(absl::string_view* bytes) {
    Words streams;
    streams.fill(kFnv1aBasis);
    for (; bytes->size() >= sizeof(Words); bytes->remove_prefix(sizeof(Words))) {
      Words words;
      std::memcpy(&words, bytes->data(), sizeof(words));
      for (size_t i = 0; i < words.size(); ++i) streams[i] = Fnv1aWord(streams[i], words[i]);
    }
    for (const uint64_t stream : streams) AddWord(stream);
  }

  uint64_t value_ = kFnv1aBasis;
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
