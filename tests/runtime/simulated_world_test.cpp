// Past 2^32 patches (tests/support/simulated_world.h): the far end of a world of 1.7e10 is streamed, put together and lit as the same place of a small one.
#include <gtest/gtest.h>

#include <map>
#include <vector>

#include "runtime/api/formfield.h"
#include "runtime/updater.h"
#include "stream/streamer.h"
#include "tests/support/random_world.h"
#include "tests/support/simulated_world.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kSmall = 5, kLarge = 12;          // levels
constexpr int32_t kFarChunk = (1 << (kLarge - 1)) - (1 << (kSmall - 1));  // of level 0: the last square of the large world that is as wide as the small one
constexpr float kFar_m = static_cast<float>(kFarChunk * formats::kChunkCells);
constexpr uint64_t kPatches = (uint64_t{1} << 2 * (kLarge - 1)) * 16 * 248;

using Name = std::tuple<uint32_t, int32_t, int32_t, uint32_t, uint32_t>;  // level, chunk's x and z, tile, index: of the small world

struct Lit {
  Vec4 source, reflected;
  std::vector<std::pair<Name, uint32_t>> row;  // column, count
  bool operator==(const Lit& o) const {
    return source.x == o.source.x && reflected.x == o.reflected.x && source.z == o.source.z && reflected.z == o.reflected.z && row == o.row;
  }
};

// What a frame at a place comes to from darkness, after two steps: light of at most two bounces, which does not leave a chunk.
std::map<Name, Lit> litAt(const std::string& path, Vec3 at, int32_t first_chunk) {
  const auto world = formats::World::open(path);
  if (!world) throw std::runtime_error(world.error().line());
  const auto streamer = stream::Streamer::create(*world, {.hysteresis = 1, .decode_threads = 2});
  if (!streamer) throw std::runtime_error(streamer.error().line());
  const auto solver = makeCpuGather(2);
  Updater updater(*world, **streamer, *solver);
  EXPECT_TRUE(updater.setSky({{1, 2, 3}, {}, {}}));
  updater.setDirectLight([&](formats::TileId id, std::span<Vec3> out) {
    const auto tile = world->tile(id);
    ASSERT_TRUE(tile) << tile.error().line();
    for (uint32_t i = 0; i < out.size(); ++i) out[i] = {static_cast<float>((i * 7 + tile->name().tile * 3 + id.level) % 11), 1, static_cast<float>(i % 5)};
  });
  EXPECT_TRUE(updater.frame(at, {}, 1));
  EXPECT_TRUE((*streamer)->settle());
  EXPECT_TRUE(updater.frame(at, {}, 1));
  EXPECT_EQ((*streamer)->stats().failed, 0u) << (*streamer)->lastFailure();

  const LocalMatrix& m = updater.matrix();
  std::vector<Vec4> light(m.slots());
  EXPECT_TRUE(solver->setRadiosity(light));
  EXPECT_TRUE(solver->iterate(2));
  EXPECT_TRUE(solver->radiosity(light));
  std::vector<Name> names(m.slots());
  for (size_t t = 0; t < m.tiles.size(); ++t) {
    const SlotRange& range = m.tiles[t];
    const formats::TileName name = updater.strip(t).tile.name();
    for (uint32_t i = 0; i < range.nodes; ++i) {
      names[range.first_slot + i] = {range.id.level, name.chunk[0] - (first_chunk >> range.id.level), name.chunk[2] - (first_chunk >> range.id.level), name.tile, i};
      EXPECT_EQ(m.slotOf(range.id.level, range.first_node + i), range.first_slot + i);
      EXPECT_EQ(world->tileOfNode(range.id.level, range.first_node + i)->id(), range.id);
    }
  }
  std::map<Name, Lit> nodes;
  for (uint32_t slot = 0; slot < m.slots(); ++slot) {
    if (std::get<0>(names[slot]) > 1) continue;  // the rows of coarser ones reach farther than the small world
    Lit& lit = nodes[names[slot]] = {updater.source()[slot], light[slot], {}};
    if (m.leaf[slot])
      for (const uint32_t entry : m.row(slot)) lit.row.emplace_back(names[slotOfEntry(entry)], countOfEntry(entry));
  }
  return nodes;
}

class BeyondTwoToThe32Patches : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<formats::TemporaryFolder>();
    for (const uint32_t levels : {kSmall, kLarge}) ASSERT_TRUE(formats::writeSimulatedWorld(path(levels), levels));
  }
  static void TearDownTestSuite() { folder_.reset(); }
  static std::string path(uint32_t levels) { return folder_->file("w" + std::to_string(levels) + ".ffm"); }
  static inline std::unique_ptr<formats::TemporaryFolder> folder_;
};

TEST_F(BeyondTwoToThe32Patches, TheFarEndIsLitAsTheSamePlaceOfASmallWorld) {
  const Vec3 at{500.5f, 2, 490.25f}, far{kFar_m, 0, kFar_m};
  const auto small = litAt(path(kSmall), at, 0), large = litAt(path(kLarge), at + far, kFarChunk);
  ASSERT_EQ(small.size(), large.size());
  size_t patches = 0, lit = 0, columns = 0;
  for (const auto& [name, node] : small) {
    ASSERT_TRUE(large.count(name) && large.at(name) == node) << std::get<0>(name) << " " << std::get<1>(name) << "," << std::get<2>(name) << " " << std::get<3>(name) << " " << std::get<4>(name);
    patches += std::get<0>(name) == 0;
    lit += node.reflected.x > node.source.x;
    columns += node.row.size();
  }
  EXPECT_GT(patches, 1000u);
  EXPECT_GT(lit, 1000u);
  EXPECT_GT(columns, 100000u);
}

TEST_F(BeyondTwoToThe32Patches, TheInterfaceNumbersThem) {
  FormfieldDevice device = nullptr;
  FormfieldWorld world = nullptr;
  ASSERT_EQ(formfieldCreateCpuDevice(2, &device), FORMFIELD_OK);
  ASSERT_EQ(formfieldOpenWorld(device, path(kLarge).c_str(), nullptr, &world), FORMFIELD_OK) << formfieldError(device);
  FormfieldWorldInfo info{};
  info.size = sizeof info;
  ASSERT_EQ(formfieldGetWorldInfo(world, &info), FORMFIELD_OK);
  EXPECT_EQ(info.patches, kPatches);
  uint64_t most = 0;
  ASSERT_EQ(formfieldSetDirectLight(world, [](void* user, uint32_t level, uint32_t, uint64_t first_node, uint32_t nodes, const FormfieldNode*, float*) {
    uint64_t& last = *static_cast<uint64_t*>(user);
    if (level == 0) last = std::max(last, first_node + nodes - 1);
  }, &most), FORMFIELD_OK);
  const double at[3] = {65535.5, 2, 65535.5};
  const float still[3] = {0, 0, 0};
  ASSERT_EQ(formfieldFrame(world, at, still), FORMFIELD_OK) << formfieldError(device);
  ASSERT_EQ(formfieldSettle(world, 1e-3f, 10), FORMFIELD_OK) << formfieldError(device);
  EXPECT_EQ(most, kPatches - 1);

  uint32_t tiles = 0, first_slot = FORMFIELD_NO_SLOT;
  const FormfieldTile* tile = formfieldTiles(world, &tiles, nullptr);
  for (uint32_t t = 0; t < tiles; ++t)
    if (tile[t].level == 0 && tile[t].first_node + tile[t].nodes == kPatches) first_slot = tile[t].first_slot;
  std::vector<uint32_t> slots(248);
  ASSERT_EQ(formfieldPatchSlots(world, kPatches - 248, 248, slots.data()), FORMFIELD_OK) << formfieldError(device);
  for (uint32_t i = 0; i < slots.size(); ++i) {
    uint32_t level = 1;
    uint64_t node = 0;
    EXPECT_EQ(slots[i], first_slot + i);
    EXPECT_EQ(formfieldSlotNode(world, slots[i], &level, &node), FORMFIELD_OK);
    EXPECT_EQ(level, 0u);
    EXPECT_EQ(node, kPatches - 248 + i);
  }
  EXPECT_EQ(formfieldPatchSlots(world, kPatches - 7, 8, slots.data()), FORMFIELD_ERROR_USAGE);
  formfieldCloseWorld(world);
  formfieldDestroyDevice(device);
}

}  // namespace
}  // namespace ff::runtime
