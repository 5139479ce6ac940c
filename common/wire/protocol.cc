#include "common/wire/protocol.h"

#include <algorithm>

#include <absl/strings/ascii.h>
#include <absl/strings/escaping.h>
#include <absl/strings/str_format.h>

namespace craftfleet::wire {
namespace {

bool Differ(absl::string_view a, absl::string_view b) { return !a.empty() && !b.empty() && a != b; }

}  // namespace

absl::Status CheckText(absl::string_view field, absl::string_view text) {
  if (text.size() > kMaxTextBytes) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s has %d bytes, want at most %d", field, text.size(), kMaxTextBytes));
  }
  if (!std::all_of(text.begin(), text.end(), [](char c) { return absl::ascii_isprint(c); })) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s is \"%s\", want printable ASCII", field, absl::CHexEscape(text)));
  }
  return absl::OkStatus();
}

absl::Status CheckHandshake(absl::string_view us, const Handshake& ours, absl::string_view them,
                            const Handshake& theirs) {
  if (ours.protocol_version != theirs.protocol_version) {
    const bool they_are_older = theirs.protocol_version < ours.protocol_version;
    return absl::FailedPreconditionError(
        absl::StrFormat("this %s speaks protocol version %d, the %s %d: upgrade the %s", us, ours.protocol_version,
                        them, theirs.protocol_version, they_are_older ? them : us));
  }
  if (Differ(ours.run_id, theirs.run_id)) {
    return absl::FailedPreconditionError(
        absl::StrFormat("this %s serves run %s, the %s belongs to run %s: check the address given to the %s, or wait "
                        "until the other run ends",
                        us, ours.run_id, them, theirs.run_id, them));
  }
  if (Differ(ours.texture_digest, theirs.texture_digest)) {
    return absl::FailedPreconditionError(
        absl::StrFormat("this %s draws with textures %s, the %s with %s: give both the same --textures", us,
                        ours.texture_digest, them, theirs.texture_digest));
  }
  return absl::OkStatus();
}

}  // namespace craftfleet::wire
