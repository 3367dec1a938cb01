/* Preloaded into ffbake: its Embree is configured by FF_EMBREE ("isa=sse2"), as it could be on another processor. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>

void* rtcNewDevice(const char* config) {
  void* (*const embree)(const char*) = (void* (*)(const char*))dlsym(RTLD_NEXT, "rtcNewDevice");
  const char* forced = getenv("FF_EMBREE");
  return embree(forced ? forced : config);
}
