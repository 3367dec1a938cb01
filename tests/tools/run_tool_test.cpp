// What commands do around their own work: one line and an exit code, whatever goes wrong.
#include "tools/run_tool.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <iostream>
#include <new>
#include <stdexcept>
#include <string>
#include <system_error>

#include "formats/storage/storage.h"
#include "tests/support/random_world.h"

namespace ff::tools {
namespace {

struct Ended {
  int code = -1;
  std::string said;  // on stderr
};

// In a process of its own, with stdout going to a file.
Ended ended(const char* out, int (*run)(int, char**)) {
  const formats::TemporaryFolder folder;
  const std::string err = folder.file("err.txt");
  const pid_t child = fork();
  if (child == 0) {
    dup2(open(out, O_WRONLY), 1);
    dup2(open(err.c_str(), O_WRONLY | O_CREAT, 0600), 2);
    _exit(runTool("tool", 0, nullptr, run));
  }
  int status = 0;
  waitpid(child, &status, 0);
  const auto bytes = formats::readWholeFile(*formats::posixStorage(), err);
  EXPECT_TRUE(WIFEXITED(status) && bytes);
  return {WEXITSTATUS(status), bytes ? std::string(reinterpret_cast<const char*>(bytes->data()), bytes->size()) : ""};
}

// As libraries write: all of it, or an exception.
void write(size_t bytes) {
  const std::string text(bytes, 'x');
  if (std::fwrite(text.data(), 1, text.size(), stdout) < text.size()) throw std::system_error(errno, std::generic_category(), "cannot write to file");
}

TEST(RunTool, WhatCannotBeWrittenToStdoutIsOneLine) {
  for (const auto run : {+[](int, char**) { return write(10), 0; }, +[](int, char**) { return write(10'000'000), 0; }, +[](int, char**) { return std::cout << "x" << std::string(10'000, 'x'), 0; }}) {
    const Ended full = ended("/dev/full", run);
    EXPECT_EQ(full.code, 2);
    EXPECT_EQ(full.said.rfind("tool: cannot write to stdout", 0), 0u) << full.said;
    EXPECT_EQ(std::count(full.said.begin(), full.said.end(), '\n'), 1) << full.said;
    EXPECT_EQ(ended("/dev/null", run).code, 0);
  }
}

TEST(RunTool, WhatIsThrownIsOneLine) {
  for (const char* out : {"/dev/null", "/dev/full"}) {
    const Ended thrown = ended(out, [](int, char**) -> int { write(10); throw std::runtime_error("a fault"); });
    EXPECT_EQ(thrown.code, 2);
    EXPECT_EQ(thrown.said, "tool: a fault\n");
    EXPECT_EQ(ended(out, [](int, char**) -> int { throw std::bad_alloc(); }).said, "tool: out of memory\n");
  }
  EXPECT_EQ(ended("/dev/full", [](int, char**) { return write(10), 3; }).code, 3) << "the command's own code counts";
}

}  // namespace
}  // namespace ff::tools
