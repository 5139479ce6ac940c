#include "common/config/removed_fields.h"

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

struct RemovedField {
  absl::string_view type;
  absl::string_view field;
  absl::string_view advice;
};

constexpr absl::string_view kPpo = "craftfleet.v1.PpoConfig";
constexpr absl::string_view kLagIsCorrected =
    "leave it out; with overlap or max_staleness, several epochs and no dropout, the first epoch corrects for older "
    "weights";

constexpr RemovedField kRemovedFields[] = {
    {kPpo, "decoupled_objective", kLagIsCorrected}, {kPpo, "vtrace_rho_bar", kLagIsCorrected},
    {kPpo, "vtrace_c_bar", kLagIsCorrected},        {kPpo, "recompute_values", kLagIsCorrected},
    {kPpo, "correction_pass", kLagIsCorrected},
};

}  // namespace

std::string RemovedFieldAdvice(absl::string_view type, absl::string_view field) {
  for (const RemovedField& removed : kRemovedFields) {
    if (removed.type == type && removed.field == field) {
      return absl::StrCat(" (removed in version 0.2: ", removed.advice, ")");
    }
  }
  return "";
}

}  // namespace craftfleet
