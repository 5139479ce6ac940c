// For LD_PRELOAD: simulates the disk that BAD_DISK describes, with words separated by spaces.
//   nolocks        every lock is granted to every process, as on some shared disks
//   ENDING:N       the Nth sync of a path with that ending fails, and the data since the previous sync is lost
#include <sys/file.h>

#include <cstdlib>
#include <sstream>
#include <string>

#include "tests/fakes/dropping_disk.h"

namespace {

bool locks_nothing = false;

__attribute__((constructor)) void ReadEnvironment() {
  const char* const text = std::getenv("BAD_DISK");
  std::istringstream words(text != nullptr ? text : "");
  for (std::string word; words >> word;) {
    const size_t colon = word.find(':');
    if (word == "nolocks") locks_nothing = true;
    if (colon != std::string::npos) {
      craftfleet::DroppingDisk::Get().FailSync(word.substr(0, colon), std::atoi(word.c_str() + colon + 1));
    }
  }
}

}  // namespace

extern "C" int flock(int descriptor, int operation) {
  return locks_nothing ? 0 : static_cast<int>(::syscall(SYS_flock, descriptor, operation));
}
