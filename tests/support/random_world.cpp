#include "tests/support/random_world.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <numeric>
#include <random>

#include "formats/read/reader.h"
#include "formats/write/writer.h"

namespace ff::formats {
namespace {

using Random = std::mt19937_64;

float uniform(Random& random, float lo, float hi) {
  return lo + (hi - lo) * static_cast<float>(random() >> 40) / static_cast<float>(1 << 24);
}
uint32_t below(Random& random, uint32_t n) { return static_cast<uint32_t>(random() % n); }

Vec3 direction(Random& random) {
  Vec3 v;
  do v = {uniform(random, -1, 1), uniform(random, -1, 1), uniform(random, -1, 1)};
  while (length(v) < 0.1f || length(v) > 1);
  return normalized(v);
}

// A row's quanta thrown at random nodes; some columns are hit often, so that counts of all sizes appear.
void fillRows(Random& random, uint32_t quanta, std::span<const uint32_t> tile_nodes, Strip& strip) {
  std::map<std::array<uint32_t, 3>, uint32_t> entries;  // (partner, row, column) -> count
  for (uint32_t row = 0; row < strip.nodes.size(); ++row) {
    Node& node = strip.nodes[row];
    node.quanta = quanta;
    while (node.sky + node.absorbed < quanta) {
      const uint32_t left = quanta - node.sky - node.absorbed;
      const uint32_t kind = below(random, 16);
      const uint32_t n = std::min(left, kind == 0 ? 1 + below(random, 400) : 1 + below(random, 2));
      const uint32_t partner = below(random, static_cast<uint32_t>(tile_nodes.size()));
      if (kind == 1) node.absorbed += n;
      else if (kind < 5) node.sky += n;
      else {
        entries[{partner, row, below(random, tile_nodes[partner])}] += n;
        node.sky += n;  // for now: closed below
      }
    }
  }
  for (const auto& [key, count] : entries) {
    strip.nodes[key[1]].sky -= count;
    if (strip.blocks.empty() || strip.blocks.back().partner_tile != key[0]) strip.blocks.push_back({key[0], 0});
    ++strip.blocks.back().entries;
    strip.rows.push_back(static_cast<uint8_t>(key[1]));
    strip.columns.push_back(static_cast<uint8_t>(key[2]));
    strip.counts.push_back(static_cast<uint16_t>(count));
  }
}

constexpr uint32_t kLampGroups = 3;

// Every second node or so has light of some groups; half the groups are of one colour.
void fillLamps(Random& random, Strip& strip) {
  for (uint32_t row = 0; row < strip.nodes.size(); ++row)
    for (uint16_t group = 0; group < kLampGroups; ++group) {
      if (below(random, 3) != 0) continue;
      const float weight = std::exp2(uniform(random, -28, 0));
      strip.lamps.push_back({static_cast<uint8_t>(row), group, {weight, weight, group == 1 ? uniform(random, 0, 1) : weight}});
    }
}

Node randomNode(Random& random, const Box& bounds) {
  Node n;
  n.area_m2 = uniform(random, 0.01f, 2);
  for (int c = 0; c < 3; ++c) {
    n.centroid[c] = uniform(random, bounds.lo[c], bounds.hi[c]);
    n.albedo[c] = uniform(random, 0, 1);
    n.emission[c] = below(random, 8) == 0 ? uniform(random, 0, 1e4f) : 0;
  }
  if (below(random, 10) != 0) n.normal = direction(random);
  n.sky_direction = direction(random) * uniform(random, 0, 1);
  for (float& mean : n.sky_quadratic) mean = uniform(random, -1, 1);
  n.sky_fraction = below(random, 4) == 0 ? 0 : std::exp2(uniform(random, -25, 0));
  n.row_total = uniform(random, 0, 3);
  if (!(n.emission == Vec3{})) n.lamp_group = static_cast<uint16_t>(below(random, kLampGroups));
  return n;
}

TileGeometry randomGeometry(Random& random, uint32_t tile, uint32_t nodes, const Box& bounds) {
  TileGeometry g;
  g.tile = tile;
  const uint32_t triangles = below(random, 3) == 0 ? 0 : 1 + below(random, 3 * nodes);
  for (uint32_t t = 0; t < triangles; ++t) {
    g.patch.push_back(static_cast<uint8_t>(below(random, nodes)));
    for (int k = 0; k < 3; ++k) {
      Vec3 p;
      for (int c = 0; c < 3; ++c) p[c] = uniform(random, bounds.lo[c], bounds.hi[c]);
      g.positions.push_back(p);
    }
  }
  return g;
}

}  // namespace

RandomWorld makeRandomWorld(const RandomWorldSettings& settings) {
  Random random(settings.seed);
  RandomWorld w;
  std::vector<uint32_t> tile_nodes;
  for (uint32_t t = 0; t < settings.level0_tiles; ++t) tile_nodes.push_back(1 + below(random, settings.max_tile_nodes));
  for (uint32_t level = 0; level < settings.levels; ++level) {
    w.strips.emplace_back();
    w.bounds.emplace_back();
    uint32_t first_node = 0;
    for (uint32_t tile = 0; tile < tile_nodes.size(); ++tile) {
      Box bounds;
      bounds.add(Vec3{uniform(random, -100, 100), uniform(random, 0, 50), uniform(random, -100, 100)});
      bounds.add(bounds.lo + Vec3{uniform(random, 0, 16), uniform(random, 0, 16), tile % 2 == 0 ? 0.0f : 3.0f});
      Strip strip;
      strip.id = {level, tile};
      strip.first_node = first_node;
      for (uint32_t i = 0; i < tile_nodes[tile]; ++i) strip.nodes.push_back(randomNode(random, bounds));
      fillRows(random, settings.quanta, tile_nodes, strip);
      fillLamps(random, strip);
      if (level == 0 && settings.geometry) w.geometry.push_back(randomGeometry(random, tile, tile_nodes[tile], bounds));
      first_node += tile_nodes[tile];
      w.strips[level].push_back(std::move(strip));
      w.bounds[level].push_back(bounds);
      w.info.bounds.add(bounds);
    }
    if (level + 1 == settings.levels) break;
    // Families of 1..4 siblings that do not straddle tiles; then tiles of the level above, each of some tiles' parents, shuffled among these.
    std::vector<uint32_t> families, parents, above;
    for (uint32_t t = 0; t < tile_nodes.size();) {
      std::vector<uint32_t> of_tile;  // families of each tile
      uint32_t all = 0;
      for (const uint32_t first = t, tiles = 1 + below(random, 3); t < tile_nodes.size() && t < first + tiles; ++t) {
        const size_t before = families.size();
        for (uint32_t i = 0; i < tile_nodes[t]; i += families.back()) families.push_back(std::min(tile_nodes[t] - i, 1 + below(random, 4)));
        const auto own = static_cast<uint32_t>(families.size() - before);
        if (all + own > kTileNodes) {
          families.resize(before);
          break;
        }
        of_tile.push_back(own);
        all += own;
      }
      std::vector<uint32_t> owner;  // of each parent: one of the tiles
      for (uint32_t k = 0; k < of_tile.size(); ++k) owner.insert(owner.end(), of_tile[k], k);
      std::shuffle(owner.begin(), owner.end(), random);
      const uint32_t first = std::accumulate(above.begin(), above.end(), 0u);
      size_t family = families.size() - all;
      for (uint32_t k = 0; k < of_tile.size(); ++k)
        for (uint32_t p = 0; p < all; ++p)
          if (owner[p] == k) parents.insert(parents.end(), families[family++], first + p);
      above.push_back(all);
    }
    w.parents.push_back(std::move(parents));
    tile_nodes = std::move(above);
  }
  w.info.cell_m = 1;
  w.info.rays = w.info.fewest_rays = 4096;
  w.info.quanta = settings.quanta;
  w.info.seed = settings.seed;
  for (uint8_t& b : w.info.bake_key) b = static_cast<uint8_t>(below(random, 256));
  w.info.generator = "random_world";
  w.info.scene = "random.glb";
  w.info.row_total_deviation = 0.25f;
  w.info.target_error = 0.02f;
  w.info.row_error = 0.018f;
  w.info.preview = 1;
  w.info.area_m2 = 1234.5;
  w.info.triangles = 42;
  w.info.absorbed_fraction = 0.0625;
  w.info.lights = {{"sun", Light::kDirectional, {3, 2, 1}, {}, {0, -1, 0}, 0, 0, 0},
                   {"bulb", Light::kPoint, {10, 0, 0.5f}, {1, 2, 3}, {}, 4, 0, 0},
                   {"", Light::kSpot, {1, 1, 1}, {-1, 0, 7}, {0.6f, 0, 0.8f}, 0, 0.25f, 0.5f}};
  for (uint32_t g = 0; g < kLampGroups; ++g) w.info.lamp_groups.push_back({"lamp " + std::to_string(g), {1, 2, static_cast<float>(g)}, 0.5, g});
  return w;
}

std::vector<std::vector<TileName>> nameTiles(const RandomWorld& w) {
  std::vector<std::vector<TileName>> names(w.strips.size());
  for (size_t level = w.strips.size(); level-- > 0;) {
    const bool top = level + 1 == w.strips.size();
    std::map<ChunkCell, uint32_t> numbers;
    for (size_t t = 0; t < w.strips[level].size(); ++t) {
      TileName name;
      if (top) {
        name.chunk = {static_cast<int32_t>(t / 4) - 1, 0, 1};
      } else {
        const uint64_t first = w.strips[level][t].first_node, node = level < w.parents.size() && first < w.parents[level].size() ? w.parents[level][first] : 0;
        size_t parent = 0;
        while (parent + 1 < w.strips[level + 1].size() && w.strips[level + 1][parent + 1].first_node <= node) ++parent;
        const TileName& above = names[level + 1][parent];
        const uint32_t octant = above.tile % 2;  // comes back: a chunk in several records
        for (size_t a = 0; a < 3; ++a) name.chunk[a] = 2 * above.chunk[a] + static_cast<int32_t>(octant >> a & 1);
      }
      name.tile = numbers[name.chunk]++;
      names[level].push_back(name);
    }
  }
  return names;
}

Result<void> writeWorld(const RandomWorld& world, const std::string& path, uint64_t shard_bytes, const StoragePtr& storage,
                        std::vector<std::string>* warnings) {
  auto writer = WorldWriter::create(path, shard_bytes, storage);
  if (!writer) return writer.error();
  const auto names = nameTiles(world);
  for (size_t level = world.strips.size(); level-- > 0;)
    for (size_t tile = 0; tile < world.strips[level].size(); ++tile) {
      auto encoded = encodeStrip(world.strips[level][tile], world.bounds[level][tile], names[level]);
      if (!encoded) return encoded.error();
      if (auto ok = writer->addStrip(std::move(*encoded)); !ok) return ok;
    }
  for (const TileGeometry& g : world.geometry)
    if (auto ok = writer->addGeometry(g, world.info); !ok) return ok;
  auto finished = writer->finish(world.info, world.parents);
  if (warnings) warnings->assign(writer->warnings().begin(), writer->warnings().end());
  return finished;
}

std::string shardOf(const std::string& path, uint32_t kind) {
  const auto world = World::open(path);
  if (world)
    for (const ShardInfo& shard : world->shards())
      if (shard.kind == kind) return folderOf(path) + shard.name;
  return "no shard";
}

TemporaryFolder::TemporaryFolder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "ff_test_XXXXXX").string();
  path_ = ::mkdtemp(pattern.data()) != nullptr ? pattern : std::string();
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  if (!path_.empty()) std::filesystem::remove_all(path_, ignored);
}

std::vector<std::byte> readFile(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::vector<char> chars((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  std::vector<std::byte> bytes(chars.size());
  std::transform(chars.begin(), chars.end(), bytes.begin(), [](char c) { return static_cast<std::byte>(c); });
  return bytes;
}

void writeFile(const std::string& path, std::span<const std::byte> bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

}  // namespace ff::formats
