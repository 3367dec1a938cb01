// What is put aside comes back, from memory or from a file, and a file that fails is an error.
#include "bake/spill.h"

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <filesystem>

#include "bake/rays/sobol.h"
#include "tests/formats/faulty_storage.h"
#include "tests/support/random_world.h"

namespace ff::bake {
namespace {

// Of 1000 bytes, of which zstd makes no less.
std::vector<std::byte> noise(uint64_t seed) {
  std::vector<std::byte> bytes(1000);
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = std::byte(mix64(seed * 1000 + i) & 0xff);
  return bytes;
}

size_t filesIn(const std::string& folder) {
  return static_cast<size_t>(std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator()));
}

TEST(Spill, GivesBackWhatWasPutFromManyThreads) {
  const formats::TemporaryFolder folder;
  for (const uint64_t memory : {uint64_t{0}, uint64_t{20000}, uint64_t{1} << 20}) {
    Spill spill(folder.file("w.ffm"), memory);
    std::vector<Spill::Block> blocks(100);
    tbb::parallel_for(size_t{0}, blocks.size(), [&](size_t k) { blocks[k] = spill.put(noise(k)); });
    EXPECT_EQ(filesIn(folder.file("")), 0u) << "the file has a name";
    tbb::parallel_for(size_t{0}, blocks.size(), [&](size_t k) { EXPECT_EQ(spill.get(blocks[k]), noise(k)); });
    EXPECT_EQ(spill.get(spill.put({})).size(), 0u);
    if (memory > 100000) {
      EXPECT_EQ(spill.written(), 0u);
    } else {
      EXPECT_GE(spill.written(), 100000 - memory);
    }
  }
}

TEST(Spill, AFileThatFailsIsAnErrorThatNamesItAndSaysWhatToDo) {
  const formats::TemporaryFolder folder;
  for (uint64_t call = 0;; ++call) {
    const auto faulty = std::make_shared<formats::FaultyStorage>(formats::posixStorage());
    faulty->fail_at = call;
    bool failed = false;
    try {
      Spill spill(folder.file("w.ffm"), 1500, faulty);
      std::vector<Spill::Block> blocks;
      for (uint64_t k = 0; k < 4; ++k) blocks.push_back(spill.put(noise(k)));
      for (uint64_t k = 0; k < 4; ++k) EXPECT_EQ(spill.get(blocks[k]), noise(k));
    } catch (const SpillFailed& e) {
      failed = true;
      EXPECT_EQ(e.error.code, ErrorCode::kIo);
      EXPECT_NE(e.error.line().find("w.ffm"), std::string::npos) << e.error.line();
      EXPECT_NE(e.error.remedy.find("--memory"), std::string::npos);
    }
    EXPECT_EQ(failed, faulty->calls > call);
    if (!failed) {
      EXPECT_GE(call, 9u);  // create, open, remove, three appends, three reads
      break;
    }
  }
}

}  // namespace
}  // namespace ff::bake
