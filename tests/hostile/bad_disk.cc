// For LD_PRELOAD: simulates the disk that BAD_DISK describes, with words separated by spaces.
//   nolocks        every lock is granted to every process, as on some shared disks
//   flock=ERROR    every lock fails with this number of errno
//   nofoldersync   the sync of a folder fails with EINVAL, as with FUSE
//   busy=TEXT      what has TEXT in its path can't be deleted (EBUSY), as on NFS while it is open elsewhere
//   ENDING:N       the Nth sync of a path with that ending fails, and the data since the previous sync is lost
#include <dlfcn.h>
#include <sys/file.h>

#include <climits>
#include <cstdlib>
#include <sstream>
#include <string>

#include "tests/fakes/dropping_disk.h"

namespace {

bool locks_nothing = false;
int lock_error = 0;
char busy[NAME_MAX] = "";  // not a string, which would be set before it is constructed

// Whether `path`, seen from the folder `descriptor`, is one that can't be deleted.
bool IsBusy(int descriptor, const char* path) {
  if (busy[0] == '\0') return false;
  std::string whole = path;
  char folder[PATH_MAX] = "";
  if (descriptor >= 0 && path[0] != '/' &&
      ::readlink(("/proc/self/fd/" + std::to_string(descriptor)).c_str(), folder, sizeof(folder) - 1) > 0) {
    whole = std::string(folder) + "/" + whole;
  }
  return whole.find(busy) != std::string::npos;
}

// The function that this library replaces.
template <typename Function>
Function* Real(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

int FailBusy() {
  errno = EBUSY;
  return -1;
}

__attribute__((constructor)) void ReadEnvironment() {
  const char* const text = std::getenv("BAD_DISK");
  std::istringstream words(text != nullptr ? text : "");
  for (std::string word; words >> word;) {
    const size_t colon = word.find(':');
    if (word == "nolocks") locks_nothing = true;
    if (word == "nofoldersync") craftfleet::DroppingDisk::Get().SyncNoFolders();
    if (word.rfind("flock=", 0) == 0) lock_error = std::atoi(word.c_str() + 6);
    if (word.rfind("busy=", 0) == 0) word.copy(busy, sizeof(busy) - 1, 5);
    if (colon != std::string::npos) {
      craftfleet::DroppingDisk::Get().FailSync(word.substr(0, colon), std::atoi(word.c_str() + colon + 1));
    }
  }
}

}  // namespace

extern "C" int unlinkat(int folder, const char* path, int flags) {
  return IsBusy(folder, path) ? FailBusy() : Real<int(int, const char*, int)>("unlinkat")(folder, path, flags);
}

extern "C" int unlink(const char* path) {
  return IsBusy(-1, path) ? FailBusy() : Real<int(const char*)>("unlink")(path);
}

extern "C" int rmdir(const char* path) { return IsBusy(-1, path) ? FailBusy() : Real<int(const char*)>("rmdir")(path); }

extern "C" int remove(const char* path) {
  return IsBusy(-1, path) ? FailBusy() : Real<int(const char*)>("remove")(path);
}

extern "C" int flock(int descriptor, int operation) {
  if (lock_error != 0) {
    errno = lock_error;
    return -1;
  }
  return locks_nothing ? 0 : static_cast<int>(::syscall(SYS_flock, descriptor, operation));
}
