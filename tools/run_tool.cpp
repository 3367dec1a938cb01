#include "tools/run_tool.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <iostream>
#include <new>
#include <string>
#include <system_error>

#include "formats/result.h"

namespace ff::tools {
namespace {

constexpr int kIo = static_cast<int>(ErrorCode::kIo);

void openStandardFiles() {
  const int ways[] = {O_RDONLY, O_RDONLY, O_WRONLY};  // of stdin; of stdout, so that writing fails; of stderr, for nobody to read
  for (int fd = 0; fd < 3; ++fd)
    if (::fcntl(fd, F_GETFD) < 0 && errno == EBADF) (void)::open("/dev/null", ways[fd]);  // takes the lowest number that is free
}

std::string faultOf(const std::exception_ptr& thrown) {
  try {
    std::rethrow_exception(thrown);
  } catch (const std::bad_alloc&) {
    return "out of memory";
  } catch (const std::system_error& e) {
    if (e.code() == std::errc::resource_unavailable_try_again) return "no thread can be started: raise the limit on processes (ulimit -u)";
    return e.what();
  } catch (const std::exception& e) {
    return e.what();
  } catch (...) {
    return "an unknown fault";
  }
}

// What is thrown where nobody can catch it. Without anything thrown it is our own bug, which ends as ever.
[[noreturn]] void endInALine() {
  const std::exception_ptr thrown = std::current_exception();
  if (!thrown) std::abort();
  std::fprintf(stderr, "%s: %s\n", program_invocation_short_name, faultOf(thrown).c_str());
  ::_exit(kIo);
}

// Called before any library's own beginnings: some start threads there (log4cplus, which OpenVDB brings), whether they may or not.
void beforeLibraries(int, char**, char**) { std::set_terminate(endInALine); }
[[gnu::section(".preinit_array"), gnu::used]] void (*const before_libraries)(int, char**, char**) = beforeLibraries;

}  // namespace

int runTool(const char* name, int argc, char** argv, int (*run)(int argc, char** argv)) {
  openStandardFiles();
  int code = kIo, cause = 0;
  std::string thrown;
  try {
    code = run(argc, argv);
    std::cout.flush();
  } catch (const std::system_error& e) {
    thrown = faultOf(std::current_exception());
    cause = e.code().value();
  } catch (const std::exception&) {
    thrown = faultOf(std::current_exception());
  }
  const bool lost = std::ferror(stdout) != 0;  // then that is what was thrown
  errno = 0;
  const bool unwritten = std::fflush(stdout) != 0 || lost || !std::cout;
  if (errno != 0) cause = errno;
  if (!thrown.empty() && !lost) {
    std::fprintf(stderr, "%s: %s\n", name, thrown.c_str());
  } else if (unwritten) {
    std::fprintf(stderr, "%s: cannot write to stdout%s%s\n", name, cause ? ": " : "", cause ? std::strerror(cause) : "");
    if (code == 0) code = kIo;
  }
  return code;
}

}  // namespace ff::tools
