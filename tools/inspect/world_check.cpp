#include "tools/inspect/world_check.h"


#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <map>
#include <mutex>
#include <thread>

#include "formats/codec/strip_codec.h"
#include "formats/read/whole_world.h"

namespace ff::tools {

using namespace ff::formats;

namespace {

constexpr double kRounding = 1e-6;  // of f32 areas and of sums of them
// Sums over the children of f32 areas, rounded to f32 once or twice on the way up.
constexpr double kSumTolerance = 1e-5;

// Calls work(i, thread) for all i < n, each once, in any order.
void forEach(size_t n, int threads, const std::function<void(size_t, size_t)>& work) {
  std::atomic<size_t> next{0};
  std::vector<std::thread> pool;
  const auto run = [&](size_t thread) {
    for (size_t i = next++; i < n; i = next++) work(i, thread);
  };
  for (size_t t = 1; t < static_cast<size_t>(threads); ++t) pool.emplace_back(run, t);
  run(0);
  for (std::thread& t : pool) t.join();
}

class CheckProgress {
 public:
  CheckProgress(const WholeWorld& world, const std::function<void(double)>& call) : call_(call) {
    for (const LevelInfo& level : world.levels()) total_ += 2 * level.tiles;  // decoded once, compared once
    if (world.hasGeometry()) total_ += world.levels()[0].tiles;
  }
  void step() {
    const std::lock_guard lock(mutex_);
    if (call_ && ++done_ <= total_) call_(static_cast<double>(done_) / static_cast<double>(total_));
  }

 private:
  const std::function<void(double)>& call_;
  std::mutex mutex_;
  uint64_t total_ = 0, done_ = 0;
};

// One level in memory, without what the checks do not need.
struct Rows {
  std::vector<Block> blocks;
  std::vector<uint8_t> rows, columns;
  std::vector<uint16_t> counts;
  bool readable = false;
};
struct Level {
  std::vector<Rows> tiles;
  std::vector<float> area;        // by node; 0 where the strip is unreadable
  std::vector<Node> nodes;        // of readable strips
  std::vector<std::vector<LampLight>> lamps;  // by tile
};

constexpr double kFractionStep = 0x1p-11;  // of two values of 12 bits
constexpr double kDimStep = 0x1p-40;       // of two weights of lamps below 2^-29, which have fewer bits
constexpr double kDeviations = 6;

class Checker {
 public:
  Checker(const WholeWorld& world, int threads, const std::function<void(double)>& progress)
      : world_(world), threads_(threads), progress_(world, progress) {}

  WorldCheck run() {
    Level below;
    for (uint32_t l = 0; l < world_.levels().size(); ++l) {
      Level level = load(l);
      compareRows(l, level);
      compareSky(l, level);
      if (l > 0) compareParents(l, below, level);
      level.tiles.clear();
      below = std::move(level);
    }
    if (world_.hasGeometry()) readGeometry();
    return std::move(check_);
  }

 private:
  // Findings of parallel work, one slot per tile, so that their order does not depend on the threads.
  using Findings = std::vector<std::vector<Error>>;
  static void append(std::vector<Error>& to, Findings& findings) {
    for (std::vector<Error>& tile : findings)
      for (Error& e : tile) to.push_back(std::move(e));
  }

  Error unphysical(TileId id, const std::string& message) const {
    return {ErrorCode::kPhysics, world_.path(), tileText(world_.ref(id)), message, "bake again"};
  }

  Level load(uint32_t l) {
    const auto tiles = world_.tiles(l);
    Level level;
    level.tiles.resize(tiles.size());
    level.area.resize(world_.levels()[l].nodes);
    level.nodes.resize(level.area.size());
    level.lamps.resize(tiles.size());
    Findings findings(tiles.size());
    forEach(tiles.size(), threads_, [&](size_t t, size_t) {
      auto strip = world_.strip(tiles[t].id);
      progress_.step();
      if (!strip) {
        findings[t].push_back(strip.error());
        return;
      }
      for (size_t i = 0; i < strip->nodes.size(); ++i) {
        level.area[strip->first_node + i] = strip->nodes[i].area_m2;
        level.nodes[strip->first_node + i] = strip->nodes[i];
      }
      if (const std::string group = unknownGroup(*strip); !group.empty())
        findings[t].push_back({ErrorCode::kInvalidFile, world_.path(), tileText(world_.ref(tiles[t].id)), group,
                               "restore the file from a copy, or bake again"});
      level.lamps[t] = std::move(strip->lamps);
      level.tiles[t] = {std::move(strip->blocks), std::move(strip->rows), std::move(strip->columns),
                        std::move(strip->counts), true};
    });
    append(check_.corrupt, findings);
    check_.strips += tiles.size();
    check_.entries += world_.levels()[l].entries;
    return level;
  }

  // Empty: the strip names none that the manifest does not list.
  std::string unknownGroup(const Strip& strip) const {
    const size_t listed = world_.info().lamp_groups.size();
    const auto named = [&](uint32_t group) {
      return "names lamp group " + std::to_string(group) + ", the manifest lists " + std::to_string(listed);
    };
    for (const Node& n : strip.nodes)
      if (n.lamp_group != kNoLampGroup && n.lamp_group >= listed) return named(n.lamp_group);
    for (const LampLight& lamp : strip.lamps)
      if (lamp.group >= listed) return named(lamp.group);
    return {};
  }

  // Rows' counts of sky against their fractions.
  void compareSky(uint32_t l, const Level& level) {
    uint32_t last_tile = ~0u;
    for (uint32_t i = 0; i < level.nodes.size(); ++i) {
      const Node& n = level.nodes[i];
      const auto total = static_cast<double>(n.row_total), f = static_cast<double>(n.sky_fraction);
      if (!(level.area[i] > 0) || n.quanta == 0 || !(total > 0) || total >= kMaxTotal) continue;
      const double expected = n.quanta * f / total;
      const double deviation = world_.info().fewest_rays > 0 ? n.quanta * std::sqrt(std::max(0.0, f * (1 - f)) / world_.info().fewest_rays) : 0;
      const double allowed = 1 + kFractionStep * expected + kDeviations * deviation;
      double off = std::abs(n.sky - expected);
      if (f >= 1 && n.sky > expected) off = 0;  // was clamped
      check_.worst_sky = std::max(check_.worst_sky, off / allowed);
      if (off <= allowed) continue;
      const uint32_t tile = world_.tileOf(l, i);
      if (tile == last_tile) continue;  // one finding a tile
      last_tile = tile;
      check_.unphysical.push_back(unphysical({l, tile}, "node " + std::to_string(i - world_.tiles(l)[tile].first_node) + ": " + std::to_string(n.sky) + " of " +
                                                            std::to_string(n.quanta) + " samples are sky, its fraction of sky makes " +
                                                            std::to_string(expected) + " of them"));
    }
  }

  // The worst pair of one tile with itself and the tiles after it, and with tiles before it that do not name it.
  struct TileResult {
    PairCheck worst;
    uint64_t pairs = 0;
  };

  void compareRows(uint32_t l, const Level& level) {
    const auto tiles = world_.tiles(l);
    std::vector<TileResult> results(tiles.size());
    std::vector<std::vector<uint16_t>> tables(static_cast<size_t>(threads_));
    forEach(tiles.size(), threads_, [&](size_t t, size_t thread) {
      tables[thread].resize(size_t{kTileNodes} * kTileNodes);
      if (level.tiles[t].readable) compareTile(l, level, static_cast<uint32_t>(t), tables[thread], results[t]);
      progress_.step();
    });
    PairCheck worst;
    for (uint32_t t = 0; t < results.size(); ++t) {
      check_.pairs += results[t].pairs;
      const PairCheck& p = results[t].worst;
      if (p.ratio() > worst.ratio()) worst = p;
      if (p.ratio() > 1)
        check_.unphysical.push_back(unphysical(
            {l, t}, "nodes " + nodeText(world_, l, p.i) + " and " + nodeText(world_, l, p.j) + " disagree: exchange areas " +
                        std::to_string(p.x_ij) + " and " + std::to_string(p.x_ji) + " m2, allowed difference " +
                        std::to_string(p.bound)));
    }
    if (worst.bound > 0) check_.worst_pairs.push_back(worst);
  }

  void compareTile(uint32_t l, const Level& level, uint32_t a, std::vector<uint16_t>& table, TileResult& result) const {
    const auto tiles = world_.tiles(l);
    const Rows& rows = level.tiles[a];
    const auto end = [&](uint32_t node, uint32_t count) {
      return PairEnd{static_cast<double>(level.area[node]), static_cast<double>(level.nodes[node].row_total), level.nodes[node].quanta, count};
    };
    size_t begin = 0;
    for (const Block& block : rows.blocks) {
      const size_t block_end = begin + block.entries;
      const uint32_t b = block.partner_tile, first_a = wholeNumber(tiles[a].first_node), first_b = wholeNumber(tiles[b].first_node);
      const auto take = [&](uint32_t i, uint32_t j, uint32_t n_ij, uint32_t n_ji) {
        ++result.pairs;
        const uint32_t from = first_a + i, to = first_b + j;
        const PairCheck p = checkPair(l, from, to, end(from, n_ij), end(to, n_ji));
        if (p.ratio() > result.worst.ratio()) result.worst = p;
      };
      // The block in the other direction; absent if tile b names none of ours. The pair is compared by the lower tile,
      // unless only the higher one has a block.
      const Rows& other = level.tiles[b];
      size_t other_begin = 0, other_entries = 0;
      for (const Block& o : other.blocks) {
        if (o.partner_tile == a) other_entries = o.entries;
        if (o.partner_tile >= a) break;
        other_begin += o.entries;
      }
      const bool mine = other.readable && (a <= b || other_entries == 0);
      if (mine) {
        for (size_t e = begin; e < block_end; ++e) table[rows.rows[e] * kTileNodes + rows.columns[e]] = rows.counts[e];
        for (size_t e = other_begin; e < other_begin + other_entries; ++e) {
          uint16_t& n_ij = table[other.columns[e] * kTileNodes + other.rows[e]];
          if (a == b && other.columns[e] > other.rows[e]) continue;  // once per pair of one tile: see below
          take(other.columns[e], other.rows[e], n_ij, other.counts[e]);
          if (a != b) n_ij = 0;
        }
        for (size_t e = begin; e < block_end; ++e) {
          const uint32_t i = rows.rows[e], j = rows.columns[e];
          if (a != b && table[i * kTileNodes + j] != 0) take(i, j, rows.counts[e], 0);
          // Within a tile: pairs i > j were compared above as (column j, row i); those with only n_ij, i < j, remain.
          if (a == b && i < j && table[j * kTileNodes + i] == 0) take(i, j, rows.counts[e], 0);
        }
        for (size_t e = begin; e < block_end; ++e) table[rows.rows[e] * kTileNodes + rows.columns[e]] = 0;
      }
      begin = block_end;
    }
  }

  // level l against its children at l - 1.
  void compareParents(uint32_t l, const Level& below, const Level& level) {
    std::vector<double> area(level.area.size());
    std::vector<double> power(3 * level.area.size());
    std::vector<uint8_t> whole(level.area.size(), 1);
    for (uint32_t i = 0; i < below.area.size(); ++i) {
      const uint32_t p = world_.parent(l - 1, i);
      area[p] += static_cast<double>(below.area[i]);
      for (int c = 0; c < 3; ++c)
        power[3 * p + static_cast<size_t>(c)] += static_cast<double>(below.area[i]) * static_cast<double>(below.nodes[i].emission[c]);
      if (!(below.area[i] > 0)) whole[p] = 0;  // a child could not be read
    }
    uint32_t last_tile = ~0u;
    for (uint32_t p = 0; p < area.size(); ++p) {
      if (whole[p] == 0 || !(level.area[p] > 0)) continue;
      const double a = static_cast<double>(level.area[p]);
      const double area_error = std::abs(a - area[p]) / area[p];
      double emission_error = 0;
      for (int c = 0; c < 3; ++c) {
        const double sum = power[3 * p + static_cast<size_t>(c)];
        const double mine = a * static_cast<double>(level.nodes[p].emission[c]);
        if (sum != mine) emission_error = std::max(emission_error, std::abs(mine - sum) / std::max(sum, mine));
      }
      check_.worst_area = std::max(check_.worst_area, area_error);
      check_.worst_emission = std::max(check_.worst_emission, emission_error);
      if (area_error <= kSumTolerance && emission_error <= kSumTolerance) continue;
      const uint32_t tile = world_.tileOf(l, p);
      if (tile == last_tile) continue;  // one finding a tile
      last_tile = tile;
      check_.unphysical.push_back(unphysical(
          {l, tile}, "node " + std::to_string(p - world_.tiles(l)[tile].first_node) + ": " + (area_error > kSumTolerance ? "area" : "emission") +
                         " is not the sum of its children's (relative difference " +
                         std::to_string(std::max(area_error, emission_error)) + ")"));
    }
    compareLamps(l, below, level, area, whole);
  }

  // Light of one lamp group at one node, power by channel, W over the group's emission.
  struct LampPower {
    double sum[3] = {0, 0, 0}, mine[3] = {0, 0, 0};
    bool clamped[3] = {false, false, false};
  };

  void compareLamps(uint32_t l, const Level& below, const Level& level, std::span<const double> area, std::span<const uint8_t> whole) {
    std::map<std::pair<uint32_t, uint16_t>, LampPower> power;  // by parent and group
    const auto visit = [&](uint32_t at, const Level& from, const auto& take) {
      for (uint32_t t = 0; t < from.lamps.size(); ++t)
        for (const LampLight& lamp : from.lamps[t]) take(wholeNumber(world_.tiles(at)[t].first_node + lamp.row), lamp);
    };
    visit(l - 1, below, [&](uint32_t node, const LampLight& lamp) {
      LampPower& p = power[{world_.parent(l - 1, node), lamp.group}];
      for (int c = 0; c < 3; ++c) {
        p.sum[c] += static_cast<double>(below.area[node]) * static_cast<double>(lamp.weight[c]);
        p.clamped[c] |= lamp.weight[c] >= kLampWeightUnit;
      }
    });
    visit(l, level, [&](uint32_t node, const LampLight& lamp) {
      LampPower& p = power[{node, lamp.group}];
      for (int c = 0; c < 3; ++c) {
        p.mine[c] += static_cast<double>(level.area[node]) * static_cast<double>(lamp.weight[c]);
        p.clamped[c] |= lamp.weight[c] >= kLampWeightUnit;
      }
    });
    std::vector<std::string> findings(world_.tiles(l).size());  // the first of each tile
    for (uint32_t i = 0; i < below.nodes.size(); ++i) {
      const uint32_t p = world_.parent(l - 1, i);
      if (whole[p] == 0 || !(level.area[p] > 0) || below.nodes[i].lamp_group == level.nodes[p].lamp_group) continue;
      const uint32_t tile = world_.tileOf(l, p);
      if (findings[tile].empty())
        findings[tile] = "node " + std::to_string(p - world_.tiles(l)[tile].first_node) + ": is of another lamp group than its child " + nodeText(world_, l - 1, i);
    }
    for (const auto& [key, p] : power) {
      const auto [node, group] = key;
      if (whole[node] == 0 || !(level.area[node] > 0)) continue;
      for (int c = 0; c < 3; ++c) {
        const double larger = std::max(p.sum[c], p.mine[c]);
        if (p.clamped[c] || larger < 0x1p-30 * area[node]) continue;
        const double off = std::abs(p.sum[c] - p.mine[c]) / larger;
        check_.worst_lamps = std::max(check_.worst_lamps, off);
        if (off <= kFractionStep + kSumTolerance + kDimStep * area[node] / larger) continue;
        const uint32_t tile = world_.tileOf(l, node);
        if (findings[tile].empty())
          findings[tile] = "node " + std::to_string(node - world_.tiles(l)[tile].first_node) + ": light of lamp group " + std::to_string(group) +
                  " is not the sum of its children's (relative difference " + std::to_string(off) + ")";
      }
    }
    for (uint32_t t = 0; t < findings.size(); ++t)
      if (!findings[t].empty()) check_.unphysical.push_back(unphysical({l, t}, findings[t]));
  }

  void readGeometry() {
    const auto tiles = world_.tiles(0);
    Findings findings(tiles.size());
    forEach(tiles.size(), threads_, [&](size_t t, size_t) {
      if (auto geometry = world_.geometry(static_cast<uint32_t>(t)); !geometry) findings[t].push_back(geometry.error());
      progress_.step();
    });
    append(check_.corrupt, findings);
    check_.geometry_tiles = tiles.size();
  }

  const WholeWorld& world_;
  const int threads_;
  CheckProgress progress_;
  WorldCheck check_;
};

}  // namespace

std::string nodeText(const WholeWorld& world, uint32_t level, uint64_t node) {
  const TileRef tile = world.ref({level, world.tileOf(level, node)});
  const ChunkCell& c = tile.chunk->cell;
  return std::to_string(c[0]) + "," + std::to_string(c[1]) + "," + std::to_string(c[2]) + " " + std::to_string(tile.index) + " " +
         std::to_string(node - tile.info().first_node);
}

PairCheck checkPair(uint32_t level, uint64_t i, uint64_t j, const PairEnd& from_i, const PairEnd& from_j) {
  const auto quantum = [](const PairEnd& e) { return e.quanta > 0 ? e.area_m2 * e.total / e.quanta : 0; };
  const double quantum_i = quantum(from_i), quantum_j = quantum(from_j);
  PairCheck p{level, i, j, quantum_i * from_i.count, quantum_j * from_j.count, 0};
  const double larger = std::max(p.x_ij, p.x_ji);
  p.bound = quantum_i + quantum_j + (kFractionStep + kRounding) * larger + kRounding * (quantum_i + quantum_j);
  if (from_i.total >= kMaxTotal || from_j.total >= kMaxTotal) p.bound = std::numeric_limits<double>::infinity();
  return p;
}

WorldCheck checkWorld(const WholeWorld& world, int threads, const std::function<void(double)>& progress) {
  if (threads <= 0) threads = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  return Checker(world, threads, progress).run();
}

}  // namespace ff::tools
