#include "deploy/cli/report/report_target.h"

#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

constexpr char kFlag[] = "--out";
constexpr char kPage[] = "report.md";

bool IsStream(const std::string& path, const fs::file_status& target) {
  return path == "-" || absl::StartsWith(path, "/dev/fd/") || absl::StartsWith(path, "/proc/self/fd/") ||
         path == "/dev/stdout" || path == "/dev/stderr" ||
         (fs::exists(target) && !fs::is_directory(target) && !fs::is_regular_file(target));
}

absl::Status Named(const absl::Status& status) { return WithPrefix(kFlag, status); }

}  // namespace

absl::StatusOr<ReportTarget> ReportTarget::Open(const std::string& out) {
  ReportTarget target(out);
  std::error_code error;
  const fs::file_status file = fs::status(out, error);
  target.is_folder_ = !IsStream(out, file);
  if (target.is_folder_ && !fs::is_directory(file)) {
    CRAFTFLEET_RETURN_IF_ERROR(target.CheckNewFolder());
  } else {
    CRAFTFLEET_ASSIGN_OR_RETURN(OutputFile page,
                                OutputFile::Open(kFlag, target.is_folder_ ? JoinPath(out, kPage) : out));
    target.page_.emplace(std::move(page));
  }
  return target;
}

// Whether the folder can be created; creates nothing.
absl::Status ReportTarget::CheckNewFolder() const {
  std::error_code error;
  fs::path above = fs::absolute(out_, error).lexically_normal();
  while (above.has_parent_path() && above != above.root_path() && !fs::exists(fs::symlink_status(above, error))) {
    above = above.parent_path();
  }
  if (!fs::is_directory(above, error)) {
    return absl::InvalidArgumentError(
        absl::StrCat(kFlag, ": ", above.string(), " is not a folder; want a folder, or - for standard output"));
  }
  if (::access(above.c_str(), W_OK | X_OK) != 0)
    return Named(FileError(errno, "cannot create a folder in", above.string()));
  return absl::OkStatus();
}

absl::StatusOr<int> ReportTarget::Write(const Report& report) {
  if (!is_folder_) {
    CRAFTFLEET_RETURN_IF_ERROR(page_->Write(report.files.at(kPage)));
    return 1;
  }
  CRAFTFLEET_RETURN_IF_ERROR(Named(CreateFolders(out_)));
  std::vector<std::pair<OutputFile, const std::string*>> files;  // all are opened before one is replaced
  for (const auto& [name, content] : report.files) {
    absl::StatusOr<OutputFile> file = name == kPage && page_.has_value()
                                          ? absl::StatusOr<OutputFile>(*std::move(page_))
                                          : OutputFile::Open(kFlag, JoinPath(out_, name));
    CRAFTFLEET_RETURN_IF_ERROR(file.status());
    files.emplace_back(*std::move(file), &content);
  }
  for (auto& [file, content] : files) CRAFTFLEET_RETURN_IF_ERROR(file.Write(*content));
  return static_cast<int>(files.size());
}

}  // namespace craftfleet
