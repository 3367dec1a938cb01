// An edit changes the strips of the chunks that it is in, and of those that see them. Farther away every byte of the patches' rows stays.
#include <gtest/gtest.h>

#include <iostream>
#include <map>
#include <set>

#include "bake/bake.h"
#include "bake/import/gltf_import.h"
#include "formats/read/whole_world.h"
#include "tests/support/analytic_scenes.h"
#include "tests/support/random_world.h"
#include "tests/support/town_scene.h"

namespace ff::bake {
namespace {

using Bytes = std::vector<std::byte>;

Bytes storedStrip(const formats::World& world, const formats::TileInfo& tile) {
  Bytes bytes(tile.strip.stored_bytes);
  EXPECT_TRUE(world.readStored(tile.strip, bytes));
  return bytes;
}

// Whether any row of a chunk names a patch in one of these chunks.
bool sees(const formats::WholeWorld& world, const formats::Chunk& chunk, const std::set<formats::ChunkCell>& others) {
  for (const formats::TileInfo& tile : chunk.tiles) {
    const auto strip = world.strip(tile.id);
    EXPECT_TRUE(strip);
    for (const formats::Block& block : strip->blocks)
      if (others.contains(world.ref({tile.id.level, block.partner_tile}).chunk->cell)) return true;
  }
  return false;
}

TEST(Edit, ChunksThatNeitherHoldANewHouseNorSeeThoseThatDoKeepTheirBytes) {
  const formats::TemporaryFolder folder;
  Scene scene = test::townScene(folder, 60000);
  Box all;
  for (const Vec3 p : scene.positions) all.add(p);
  const auto cache = BakeCache::open(folder.file("cache"), uint64_t{1} << 30);
  ASSERT_TRUE(cache) << cache.error().line();
  const BakeSettings settings{.cell_m = 1, .rays = 64, .cache = cache->get(), .geometry = false};
  ASSERT_TRUE(bakeWorld(scene, settings, folder.file("before.ffm")));
  const auto before = formats::WholeWorld::open(folder.file("before.ffm"));
  ASSERT_TRUE(before) << before.error().line();
  // On the most open ground within 25 m of a corner of the town.
  Vec3 ground;
  float most = 0;
  for (const formats::TileInfo& tile : before->tiles(0)) {
    const auto strip = before->strip(tile.id);
    ASSERT_TRUE(strip);
    for (const formats::Node& n : strip->nodes)
      if (n.normal.y > 0.9f && std::abs(n.centroid.y) < 0.01f && length(n.centroid - Vec3{all.lo.x, 0, all.lo.z}) < 25 && n.sky_fraction > most) {
        most = n.sky_fraction;
        ground = n.centroid;
      }
  }
  const Box house{ground - Vec3{1.75f, 0, 1.75f}, ground + Vec3{1.75f, 5.5f, 1.75f}};
  test::addBlock(scene, house.lo, house.hi, scene.triangles[0].material, false);
  const auto stats = bakeWorld(scene, settings, folder.file("after.ffm"));
  ASSERT_TRUE(stats) << stats.error().line();
  const auto after = formats::WholeWorld::open(folder.file("after.ffm"));
  ASSERT_TRUE(after) << after.error().line();
  std::map<formats::ChunkCell, formats::ChunkPtr> chunks_before;
  for (const formats::ChunkPtr& chunk : before->chunks(0)) chunks_before[chunk->cell] = chunk;
  std::set<formats::ChunkCell> holding;
  size_t of_house = 0;
  for (const formats::TileInfo& tile : after->tiles(0)) {
    const auto strip = after->strip(tile.id);
    ASSERT_TRUE(strip);
    for (const formats::Node& n : strip->nodes) {
      if (house.distance(n.centroid) > 1e-3f) continue;
      holding.insert(after->ref(tile.id).chunk->cell);
      of_house += n.centroid.y > 0.01f;
    }
  }
  ASSERT_GT(of_house, 30u);
  size_t far = 0, near_changed = 0;
  for (const formats::ChunkPtr& chunk : after->chunks(0)) {
    const auto old = chunks_before.find(chunk->cell);
    const bool near = holding.contains(chunk->cell) || sees(*after, *chunk, holding);
    bool same = old != chunks_before.end() && old->second->tiles.size() == chunk->tiles.size();
    for (size_t t = 0; same && t < chunk->tiles.size(); ++t) same = storedStrip(*after, chunk->tiles[t]) == storedStrip(*before, old->second->tiles[t]);
    near_changed += near && !same;
    if (near) continue;
    ++far;
    EXPECT_TRUE(same) << formats::chunkText(0, chunk->cell);
  }
  std::cout << far << " chunks of " << after->chunks(0).size() << " neither hold nor see it\n";
  EXPECT_GT(far, 10u);
  std::cout << "the rays of " << stats->cached.rows.clean << " patches of " << stats->cached.patches() << " were not cast again\n";
  EXPECT_GT(2 * stats->cached.rows.clean, stats->cached.patches());
  EXPECT_GT(near_changed, 0u);
}

}  // namespace
}  // namespace ff::bake
