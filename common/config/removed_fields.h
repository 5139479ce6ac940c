// Fields of configurations that earlier versions had.

#ifndef CRAFTFLEET_COMMON_CONFIG_REMOVED_FIELDS_H_
#define CRAFTFLEET_COMMON_CONFIG_REMOVED_FIELDS_H_

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

// " (removed in version 0.2: ...)", with what to write instead, if `field` is one that the message `type`
// ("craftfleet.v1.PpoConfig") had; else "".
std::string RemovedFieldAdvice(absl::string_view type, absl::string_view field);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CONFIG_REMOVED_FIELDS_H_
