// Which worker may go by which name.

#ifndef CRAFTFLEET_LEARNER_NAME_BOOK_H_
#define CRAFTFLEET_LEARNER_NAME_BOOK_H_

#include <cstddef>
#include <map>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"

namespace craftfleet {

// The first to use a name owns it until it leaves or has not used it for `lapse`. Who somebody is, his identity, others
// find out (common/wire/access.h); where all have the same, as without TLS, the book stops nobody. Thread-safe.
class NameBook {
 public:
  static constexpr size_t kMaxNames = 16384;  // at once of one identity

  // `lapse` is at least the lease of what is given out to names. `clock` outlives the book.
  NameBook(absl::Duration lapse, Clock* clock) : lapse_(lapse), clock_(clock) {}

  // `identity` speaks as `name`, which is the name of a `kind`: "actor", "environment server".
  //   PermissionDenied: the name is another's.   ResourceExhausted: it goes by kMaxNames names already. Both say which.
  absl::Status Use(absl::string_view kind, absl::string_view name, absl::string_view identity) ABSL_LOCKS_EXCLUDED(mu_);

  // The name is free again. Call after Use.
  void Leave(absl::string_view kind, absl::string_view name) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Owner {
    std::string identity;
    absl::Time last_word;
  };
  using Owners = std::map<std::string, Owner>;

  void Release(Owners::iterator entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Frees the names that have lapsed.
  void Forget() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const absl::Duration lapse_;
  Clock* const clock_;
  Mutex mu_;
  Owners owners_ ABSL_GUARDED_BY(mu_);                           // by kind and name
  std::map<std::string, size_t> names_of_ ABSL_GUARDED_BY(mu_);  // how many, by identity
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_NAME_BOOK_H_
