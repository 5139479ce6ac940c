#include "learner/run/arrival_log.h"

#include <algorithm>

#include <absl/status/status.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <nlohmann/json.hpp>

#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

constexpr size_t kDigestDigits = 16;

bool IsCount(const nlohmann::json& value) { return value.is_number_unsigned(); }

// Nothing: `value` is not [lane, fragment, policy_version, "digest"].
std::optional<Arrival> ParseArrival(const nlohmann::json& value, int lanes) {
  if (!value.is_array() || value.size() != 4 || !IsCount(value[0]) || !IsCount(value[1]) || !IsCount(value[2]) ||
      !value[3].is_string() || value[0].get<uint64_t>() >= static_cast<uint64_t>(lanes)) {
    return std::nullopt;
  }
  Arrival arrival;
  arrival.permit = {value[0].get<int>(), value[1].get<int64_t>(), value[2].get<int64_t>()};
  const auto& digest = value[3].get_ref<const std::string&>();
  if (digest.size() != kDigestDigits || !absl::SimpleHexAtoi(digest, &arrival.digest)) return std::nullopt;
  return arrival;
}

absl::StatusOr<UpdateArrivals> ParseLine(absl::string_view line, int lanes) {
  const auto object = nlohmann::json::parse(line.begin(), line.end(), nullptr, /*allow_exceptions=*/false);
  if (!object.is_object() || object.size() != 2 || !object.contains("policy_version") ||
      !IsCount(object["policy_version"]) || !object.contains("fragments") || !object["fragments"].is_array()) {
    return absl::DataLossError("not an object with \"policy_version\" and \"fragments\"");
  }
  UpdateArrivals update;
  update.policy_version = object["policy_version"].get<int64_t>();
  for (const nlohmann::json& value : object["fragments"]) {
    const std::optional<Arrival> arrival = ParseArrival(value, lanes);
    if (!arrival.has_value()) {
      return absl::DataLossError(
          absl::StrFormat("%s, want [lane 0..%d, fragment, policy_version, \"digest\"]", value.dump(), lanes - 1));
    }
    update.fragments.push_back(*arrival);
  }
  return update;
}

}  // namespace

std::string FormatArrivals(const UpdateArrivals& update) {
  std::string line = absl::StrCat("{\"policy_version\": ", update.policy_version, ", \"fragments\": [");
  absl::string_view separator;
  for (const Arrival& arrival : update.fragments) {
    const Permit& permit = arrival.permit;
    absl::StrAppendFormat(&line, "%s[%d, %d, %d, \"%016x\"]", separator, permit.lane, permit.fragment,
                          permit.policy_version, arrival.digest);
    separator = ", ";
  }
  return line + "]}\n";
}

absl::StatusOr<ArrivalReader> ArrivalReader::Open(const std::string& path, const Run& run) {
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string text, ReadFile(path));
  text.resize(text.rfind('\n') + 1);  // npos + 1 is 0
  return ArrivalReader(path, std::move(text), run);
}

ArrivalReader::ArrivalReader(std::string path, std::string text, const Run& run)
    : path_(std::move(path)), text_(std::move(text)), run_(run), next_(run.lanes) {}

absl::StatusOr<UpdateArrivals> ArrivalReader::Next() {
  const size_t end = text_.find('\n', at_);
  absl::StatusOr<UpdateArrivals> update = ParseLine(absl::string_view(text_).substr(at_, end - at_), run_.lanes);
  absl::Status status = update.status();
  if (status.ok()) status = Check(*update);
  if (!status.ok()) return absl::DataLossError(absl::StrCat(path_, ":", lines_ + 1, ": ", status.message()));
  at_ = end + 1;
  ++lines_;
  return update;
}

absl::Status ArrivalReader::Check(const UpdateArrivals& update) {
  if (update.policy_version != lines_) {
    return absl::DataLossError(absl::StrFormat("policy_version %d, want %d", update.policy_version, lines_));
  }
  if (update.fragments.size() != static_cast<size_t>(run_.fragments)) {
    return absl::DataLossError(absl::StrFormat("%d fragments, want %d", update.fragments.size(), run_.fragments));
  }
  for (const Arrival& arrival : update.fragments) {
    const Permit& permit = arrival.permit;
    if (permit.fragment != next_[permit.lane]) {
      return absl::DataLossError(
          absl::StrFormat("fragment %d of lane %d, want %d", permit.fragment, permit.lane, next_[permit.lane]));
    }
    if (permit.policy_version > update.policy_version ||
        permit.policy_version < update.policy_version - run_.max_staleness) {
      return absl::DataLossError(absl::StrFormat("fragment %d of lane %d was played with weights %d, want %d..%d",
                                                 permit.fragment, permit.lane, permit.policy_version,
                                                 std::max<int64_t>(0, update.policy_version - run_.max_staleness),
                                                 update.policy_version));
    }
    ++next_[permit.lane];
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
