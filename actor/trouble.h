// Which trouble with a learner or an environment server passes by itself.

#ifndef CRAFTFLEET_ACTOR_TROUBLE_H_
#define CRAFTFLEET_ACTOR_TROUBLE_H_

#include <absl/status/status.h>

namespace craftfleet {

// The other end is away, slow, restarted or failed within: try again, and play lost fragments again. Any other error
// wants somebody to act. Unknown is how gRPC calls an exception at the other end.
inline bool MayPass(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kDeadlineExceeded:
    case absl::StatusCode::kAborted:
    case absl::StatusCode::kUnknown:
    case absl::StatusCode::kResourceExhausted:  // the other side sheds load
      return true;
    default:
      return false;
  }
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_TROUBLE_H_
