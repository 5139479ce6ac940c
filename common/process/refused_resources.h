// What a program says when the system refuses it a thread or memory.

#ifndef CRAFTFLEET_COMMON_PROCESS_REFUSED_RESOURCES_H_
#define CRAFTFLEET_COMMON_PROCESS_REFUSED_RESOURCES_H_

namespace craftfleet {

// From now on an exception that nobody catches, because a thread cannot be started, memory is exhausted or a library
// met another limit (std::runtime_error), ends the process with exit code 1 and one line that says what to raise,
// instead of a crash. Other exceptions end it as before. Call once, after SetUpLog.
void ExplainRefusedResources();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_REFUSED_RESOURCES_H_
