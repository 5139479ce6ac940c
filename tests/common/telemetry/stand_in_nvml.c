/* An NVML (libnvidia-ml.so.1) with two GPUs, an old one and a new one; the second reports no utilisation, as a slice of a
   GPU does. */
#include <string.h>

struct memory {
  unsigned long long total, free, used;
};
struct utilization {
  unsigned int gpu, memory;
};

int nvmlInit_v2(void) { return 0; }
int nvmlShutdown(void) { return 0; }
int nvmlDeviceGetHandleByIndex_v2(unsigned int index, void** device) {
  static char devices[2];
  if (index > 1) return 2;
  *device = &devices[index];
  devices[index] = (char)index;
  return 0;
}
int nvmlDeviceGetHandleByUUID(const char* uuid, void** device) {
  return strcmp(uuid, "GPU-1234") == 0 ? nvmlDeviceGetHandleByIndex_v2(1, device) : 6;
}
int nvmlDeviceGetName(void* device, char* name, unsigned int length) {
  strncpy(name, *(char*)device == 0 ? "NVIDIA First" : "NVIDIA Second", length);
  return 0;
}
int nvmlDeviceGetMemoryInfo(void* device, struct memory* memory) {
  (void)device;
  memory->total = 80ULL << 30;
  memory->used = 3ULL << 30;
  memory->free = memory->total - memory->used;
  return 0;
}
int nvmlDeviceGetCudaComputeCapability(void* device, int* major, int* minor) {
  *major = *(char*)device == 0 ? 7 : 9;
  *minor = *(char*)device == 0 ? 5 : 0;
  return 0;
}
int nvmlDeviceGetUtilizationRates(void* device, struct utilization* utilization) {
  utilization->gpu = 87;
  utilization->memory = 20;
  return *(char*)device == 0 ? 0 : 3;
}
