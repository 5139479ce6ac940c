// Functions of libraries that a program may have been linked with.

#pragma once

#include <dlfcn.h>

namespace craftfleet {

// The function `name` of type `Function` in the program or its libraries; null if none has it. Asked at run time,
// because linkers disagree about weak symbols: some set those that only an indirect dependency defines to null.
// Thread-safe.
template <typename Function>
Function* FindSymbol(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

}  // namespace craftfleet
