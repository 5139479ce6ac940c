// Where a report is written: a folder, or a stream.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_REPORT_TARGET_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_REPORT_TARGET_H_

#include <optional>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/io/output_file.h"
#include "deploy/cli/report/report.h"

namespace craftfleet {

// Opened before the runs are read, so that a target that can't be written is reported then, and written once.
// Not thread-safe.
class ReportTarget {
 public:
  // `out`, of --out and not empty, is a folder, which Write creates if it does not exist; or standard output ("-"), a
  // FIFO or another stream, which takes report.md alone.
  //   InvalidArgument: a file that is neither.   Others: why nothing can be created there.
  static absl::StatusOr<ReportTarget> Open(const std::string& out);

  // Replaces files of the report's names in the folder, as OutputFile does; none if one of them can't be written.
  // Returns how many files were written. Called at most once.
  absl::StatusOr<int> Write(const Report& report);

  // The target is standard output: what is printed for people belongs on standard error then.
  bool is_standard_output() const { return page_.has_value() && page_->is_standard_output(); }

 private:
  explicit ReportTarget(std::string out) : out_(std::move(out)) {}
  absl::Status CheckNewFolder() const;

  std::string out_;
  bool is_folder_ = false;
  std::optional<OutputFile> page_;  // report.md; none in a folder that does not exist yet
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_REPORT_TARGET_H_
