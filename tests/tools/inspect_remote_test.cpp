// ffinspect, of a world behind Debian's nginx.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdio>
#include <cstdlib>

#include "tests/support/furnace_world.h"
#include "tests/support/nginx.h"

namespace ff::tools {
namespace {

using namespace ff::formats;

// stdout and stderr, then the exit code; `world` is written WORLD.
std::string said(const std::string& command, const std::string& world) {
  std::string text;
  std::FILE* pipe = ::popen((std::string(FF_INSPECT) + " " + command + " " + world + " 2>&1").c_str(), "r");
  if (!pipe) return text;
  char buffer[4096];
  for (size_t n = 0; (n = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) text.append(buffer, n);
  text += "exit code " + std::to_string(WEXITSTATUS(::pclose(pipe)));
  for (size_t at = 0; (at = text.find(world)) != std::string::npos;) text.replace(at, world.size(), "WORLD");
  return text;
}

TEST(InspectRemote, SaysOfAWorldBehindNginxWhatItSaysOfItsFiles) {
  const TemporaryFolder folder, cache;
  ASSERT_TRUE(writeWorld(makeFurnaceWorld(300), folder.file("f.ffm"), 1 << 14));
  const auto nginx = Nginx::start(folder.path());
  if (!nginx) GTEST_SKIP();
  ::setenv("FORMFIELD_CACHE", cache.file("cache").c_str(), 1);
  for (const char* command : {"verify --quiet", "info", "stats --json", "verify --quiet"}) {
    const std::string here = said(command, folder.file("f.ffm"));
    EXPECT_NE(here.find("exit code 0"), std::string::npos) << here;
    EXPECT_EQ(said(command, nginx->address("f.ffm")), here) << command;
  }
  // A damaged file: the same finding, with the address for the path.
  std::vector<std::byte> bytes = readFile(shardOf(folder.file("f.ffm")));
  bytes[bytes.size() / 2] ^= std::byte{1};
  writeFile(shardOf(folder.file("f.ffm")), bytes);
  ::setenv("FORMFIELD_CACHE", "off", 1);
  const std::string damaged = said("verify --quiet", nginx->address("f.ffm"));
  EXPECT_NE(damaged.find("checksum"), std::string::npos) << damaged;
  EXPECT_NE(damaged.find("exit code 3"), std::string::npos) << damaged;
  const std::string absent = said("info", nginx->address("g.ffm"));
  EXPECT_NE(absent.find("ffinspect: WORLD: offset 0: there is no such file on the server (404)"), std::string::npos) << absent;
  EXPECT_NE(absent.find("exit code 2"), std::string::npos) << absent;
  ::setenv("FORMFIELD_CACHE", "/dev/null", 1);
  const std::string uncached = said("verify --quiet", nginx->address("f.ffm"));
  EXPECT_NE(uncached.find("ffinspect: /dev/null: "), std::string::npos) << uncached;
  ::unsetenv("FORMFIELD_CACHE");
}

}  // namespace
}  // namespace ff::tools
