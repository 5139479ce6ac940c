// A test as a user with no more rights than others.

#pragma once

#include <unistd.h>

#include "common/base/check.h"

namespace craftfleet {

// Makes root, who may read and write everything, another user until destruction; other users stay who they are.
class PlainUser {
 public:
  PlainUser() : is_root_(::geteuid() == 0) {
    constexpr uid_t kNobody = 65534;
    if (is_root_) CRAFTFLEET_CHECK(::seteuid(kNobody) == 0);
  }
  ~PlainUser() {
    if (is_root_) CRAFTFLEET_CHECK(::seteuid(0) == 0);
  }
  PlainUser(const PlainUser&) = delete;
  PlainUser& operator=(const PlainUser&) = delete;

 private:
  const bool is_root_;
};

}  // namespace craftfleet
