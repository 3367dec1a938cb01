#include "tools/run_tool.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <exception>
#include <iostream>
#include <new>

#include "formats/result.h"

namespace ff::tools {
namespace {

constexpr int kIo = static_cast<int>(ErrorCode::kIo);

void openStandardFiles() {
  const int ways[] = {O_RDONLY, O_RDONLY, O_WRONLY};  // of stdin; of stdout, so that writing fails; of stderr, for nobody to read
  for (int fd = 0; fd < 3; ++fd)
    if (::fcntl(fd, F_GETFD) < 0 && errno == EBADF) (void)::open("/dev/null", ways[fd]);  // takes the lowest number that is free
}

}  // namespace

int runTool(const char* name, int argc, char** argv, int (*run)(int argc, char** argv)) {
  openStandardFiles();
  int code = kIo;
  try {
    code = run(argc, argv);
    std::cout.flush();
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", name);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s: %s\n", name, e.what());
  }
  errno = 0;
  if (std::fflush(stdout) != 0 || std::ferror(stdout) || !std::cout) {
    std::fprintf(stderr, "%s: cannot write to stdout%s%s\n", name, errno ? ": " : "", errno ? std::strerror(errno) : "");
    if (code == 0) code = kIo;
  }
  return code;
}

}  // namespace ff::tools
