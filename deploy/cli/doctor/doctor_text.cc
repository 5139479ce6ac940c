#include "deploy/cli/doctor/doctor_text.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/string_view.h>
#include <nlohmann/json.hpp>

namespace craftfleet {
namespace {

absl::string_view Name(Verdict verdict) {
  if (verdict == Verdict::kOk) return "ok";
  return verdict == Verdict::kWarn ? "warn" : "FAIL";
}

absl::string_view Colour(Verdict verdict) {
  if (verdict == Verdict::kOk) return "\033[32m";
  return verdict == Verdict::kWarn ? "\033[33m" : "\033[1;31m";
}

}  // namespace

std::string DoctorText(const std::vector<Finding>& findings, bool colour) {
  size_t width = 0;
  for (const Finding& finding : findings) width = std::max(width, finding.check.size());
  std::string text;
  for (const Finding& finding : findings) {
    const std::string verdict = absl::StrFormat("%-4s", Name(finding.verdict));
    absl::StrAppendFormat(&text, "%s  %-*s  %s\n",
                          colour ? absl::StrCat(Colour(finding.verdict), verdict, "\033[0m") : verdict,
                          static_cast<int>(width), finding.check, finding.found);
    if (!finding.remedy.empty()) absl::StrAppendFormat(&text, "      %*s  -> %s\n", width, "", finding.remedy);
  }
  return text;
}

std::string DoctorJson(const std::vector<Finding>& findings) {
  nlohmann::ordered_json checks = nlohmann::ordered_json::array();
  for (const Finding& finding : findings) {
    checks.push_back({{"check", finding.check},
                      {"verdict", finding.verdict == Verdict::kFail ? "fail" : std::string(Name(finding.verdict))},
                      {"found", finding.found},
                      {"remedy", finding.remedy}});
  }
  const nlohmann::ordered_json json = {{"ok", FailedChecks(findings).empty()}, {"checks", std::move(checks)}};
  return json.dump(2, ' ', /*ensure_ascii=*/false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

std::string FailedChecks(const std::vector<Finding>& findings) {
  std::vector<std::string> names;
  for (const Finding& finding : findings) {
    if (finding.verdict == Verdict::kFail) names.push_back(finding.check);
  }
  return absl::StrJoin(names, ", ");
}

bool WantsColour(bool terminal, const char* no_color, const char* term) {
  const bool refused = no_color != nullptr && *no_color != '\0';
  return terminal && !refused && term != nullptr && absl::string_view(term) != "dumb";
}

}  // namespace craftfleet
