// The folder for the files of fuzz targets.

#ifndef CRAFTFLEET_TESTS_FUZZ_FUZZ_FOLDER_H_
#define CRAFTFLEET_TESTS_FUZZ_FUZZ_FOLDER_H_

#include <cstdlib>
#include <string>

#include "common/base/check.h"
#include "common/io/files.h"

namespace craftfleet {

// A folder of this process, in memory if possible; removed when it exits.
inline const std::string& FuzzFolder() {
  static const std::string* folder = [] {
    std::string path = PathExists("/dev/shm") ? "/dev/shm/craftfleet-fuzz-XXXXXX" : "/tmp/craftfleet-fuzz-XXXXXX";
    CRAFTFLEET_CHECK(::mkdtemp(path.data()) != nullptr);
    std::atexit([] { RemoveAll(FuzzFolder()).IgnoreError(); });
    return new std::string(path);
  }();
  return *folder;
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FUZZ_FUZZ_FOLDER_H_
