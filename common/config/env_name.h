// The name of an environment: `crafter`, or `crafter:` and options joined by commas, such as
// `crafter:appearance=25/25/25/25,numbers=easy-x2,inventory=off`.

#pragma once

#include <array>
#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

struct EnvName {
  // Whether trees, cows, zombies, stone, coal and skeletons have variants, and the percentage of each; sum 100.
  bool appearance = false;
  std::array<int, 4> percentages = {100, 0, 0, 0};
  // Number of trees, coal, cows, zombies and skeletons in a new world, one letter each: q a quarter of the standard
  // number, h half, s standard, d double, f four times. Always five letters: setting names are resolved.
  std::string numbers = "sssss";
  // Whether the picture shows the inventory.
  bool inventory = true;

  // InvalidArgument names the bad part and lists what is allowed.
  static absl::StatusOr<EnvName> Parse(absl::string_view name);
  // The canonical name: options in the order above, defaults left out, numbers by name where they have one.
  std::string ToString() const;
  // The canonical name without options that affect only the picture. Environments with equal names have equal worlds.
  std::string WorldName() const;
};

}  // namespace craftfleet
