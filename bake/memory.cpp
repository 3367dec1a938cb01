#include "bake/memory.h"

#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>

namespace ff::bake {
namespace {

uint64_t numberIn(const std::string& path) {
  std::ifstream in(path);
  uint64_t value = 0;
  return in >> value ? value : std::numeric_limits<uint64_t>::max();
}

}  // namespace

uint64_t freeMemory() {
  constexpr uint64_t kAll = std::numeric_limits<uint64_t>::max();
  uint64_t free = kAll;
  std::ifstream in("/proc/meminfo");
  std::string key;
  uint64_t kib;
  for (std::string unit; in >> key >> kib; std::getline(in, unit))
    if (key == "MemAvailable:") free = kib << 10;
  std::ifstream groups("/proc/self/cgroup");  // "0::/a/b" of version 2, "4:memory:/a/b" of version 1
  for (std::string line; std::getline(groups, line);) {
    const bool second = line.starts_with("0::");
    const size_t memory = line.find(":memory:");
    if (!second && memory == std::string::npos) continue;
    const std::string root = second ? "/sys/fs/cgroup" : "/sys/fs/cgroup/memory";
    for (std::string folder = root + line.substr(second ? 3 : memory + 8);; folder.resize(folder.rfind('/'))) {  // limits of those above count, too
      const uint64_t limit = numberIn(folder + (second ? "/memory.max" : "/memory.limit_in_bytes")),
                     used = numberIn(folder + (second ? "/memory.current" : "/memory.usage_in_bytes"));
      if (limit != kAll && used != kAll) free = std::min(free, limit - std::min(limit, used));
      if (folder.size() <= root.size()) break;
    }
  }
  return free;
}

ResidentMemory residentMemory() {
  std::ifstream statm("/proc/self/statm");
  uint64_t pages = 0, resident = 0, files = 0;
  statm >> pages >> resident >> files;
  const auto page = static_cast<uint64_t>(sysconf(_SC_PAGESIZE));
  return {resident * page, std::min(files, resident) * page};
}

uint64_t spareMemory(uint64_t limit_bytes) {
  constexpr uint64_t kLeast = uint64_t{8} << 20;
  if (limit_bytes == 0) return std::max(kLeast, freeMemory());
  const ResidentMemory resident = residentMemory();
  return std::max(kLeast, limit_bytes - std::min(limit_bytes, resident.all - resident.files));
}

void giveBackMemory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace ff::bake
