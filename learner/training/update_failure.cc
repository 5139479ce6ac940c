#include "learner/training/update_failure.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

constexpr size_t kMaxSenders = 16;
constexpr size_t kMaxListBytes = 300;

struct Sent {
  std::string list;    // "lane/number" of each fragment
  float log_prob = 0;  // lowest
  float value = 0;     // largest magnitude
};

}  // namespace

std::vector<std::string> DescribeSenders(const std::vector<Fragment>& fragments) {
  std::map<std::string, Sent> senders;
  for (const Fragment& fragment : fragments) {
    Sent& sent = senders[fragment.sender];
    absl::StrAppend(&sent.list, sent.list.empty() ? "" : " ", fragment.lane, "/", fragment.number);
    for (const float log_prob : fragment.log_probs) sent.log_prob = std::min(sent.log_prob, log_prob);
    for (const float value : fragment.values) sent.value = std::max(sent.value, std::abs(value));
  }
  std::vector<std::string> lines;
  for (const auto& [sender, sent] : senders) {
    if (lines.size() == kMaxSenders) {
      lines.push_back(absl::StrFormat("and %d more", senders.size() - kMaxSenders));
      break;
    }
    const bool is_long = sent.list.size() > kMaxListBytes;
    lines.push_back(absl::StrFormat("from %s (lane/fragment): %s%s; log_probs down to %g, values up to %g", sender,
                                    sent.list.substr(0, kMaxListBytes), is_long ? "..." : "", sent.log_prob,
                                    sent.value));
  }
  return lines;
}

}  // namespace craftfleet
