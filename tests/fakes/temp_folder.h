// A temporary folder for a test.

#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

#include <absl/strings/string_view.h>
#include <gtest/gtest.h>

#include "common/base/check.h"
#include "common/io/files.h"

namespace craftfleet {

// Created empty; removed with its contents on destruction.
class TempFolder {
 public:
  TempFolder() : path_(JoinPath(testing::TempDir(), "craftfleet-XXXXXX")) {
    CRAFTFLEET_CHECK(::mkdtemp(&path_[0]) != nullptr);
  }
  ~TempFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;

  const std::string& path() const { return path_; }
  std::string operator/(absl::string_view name) const { return JoinPath(path_, name); }

 private:
  std::string path_;
};

}  // namespace craftfleet
