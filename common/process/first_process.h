// Process 1, as that of a container is.

#ifndef CRAFTFLEET_COMMON_PROCESS_FIRST_PROCESS_H_
#define CRAFTFLEET_COMMON_PROCESS_FIRST_PROCESS_H_

namespace craftfleet {

// In process 1, lets SIGTERM and SIGINT end the process as they would end another one, until StopSignal handles them:
// the kernel drops signals to process 1 that nothing handles. A program that is linked with this also does so by
// itself, before its libraries are initialised, which takes LibTorch half a second.
void LetSignalsEndProcess1();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_FIRST_PROCESS_H_
