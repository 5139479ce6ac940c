#include "learner/run/epoch.h"

#include <absl/status/status.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>

#include "common/files.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

std::string EpochPath(const std::string& logdir) { return JoinPath(logdir, "epoch"); }

}  // namespace

absl::StatusOr<int64_t> ReadEpoch(const std::string& logdir) {
  const absl::StatusOr<std::string> text = ReadFile(EpochPath(logdir));
  if (absl::IsNotFound(text.status())) return 0;
  CRAFTFLEET_RETURN_IF_ERROR(text.status());
  int64_t epoch = 0;
  if (!absl::SimpleAtoi(*text, &epoch) || epoch < 1) {
    return absl::DataLossError(absl::StrCat(EpochPath(logdir), " holds \"", *text, "\", want a number from 1"));
  }
  return epoch;
}

absl::StatusOr<int64_t> NextEpoch(const std::string& logdir) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t epoch, ReadEpoch(logdir));
  CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(EpochPath(logdir), absl::StrCat(epoch + 1, "\n")));
  return epoch + 1;
}

}  // namespace craftfleet
