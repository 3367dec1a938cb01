// A synthetic world written, opened and cut at random: what the tests of this room share.
#pragma once
#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <set>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/cut/local_matrix.h"
#include "stream/strip_loader.h"
#include "tests/support/synthetic_world.h"

namespace ff::runtime {

using Cut = std::vector<stream::StripPtr>;

class TestWorld {
 public:
  explicit TestWorld(const stream::SyntheticSettings& settings) : made_(stream::makeSyntheticWorld(settings)) {
    const std::string path = folder_.file("world.ffm");
    const auto written = formats::writeWorld(made_, path, uint64_t{1} << 20);
    if (!written) throw std::runtime_error(written.error().line());
    auto opened = formats::WholeWorld::open(path);
    if (!opened) throw std::runtime_error(opened.error().line());
    world_ = std::make_unique<formats::WholeWorld>(std::move(*opened));
    for (uint32_t level = 0; level < world_->levels().size(); ++level)
      for (const formats::TileInfo& info : world_->tiles(level)) {
        auto strip = world_->strip(info.id);
        if (!strip) throw std::runtime_error(strip.error().line());
        strips_[info.id] = std::move(*strip);
        auto packed = stream::readResident(*world_, world_->ref(info.id));
        if (!packed) throw std::runtime_error(packed.error().line());
        packed_[info.id] = std::move(*packed);
      }
  }

  const formats::WholeWorld& world() const { return *world_; }
  const formats::Strip& strip(formats::TileId id) const { return strips_.at(id); }
  const formats::Node& node(uint32_t level, uint64_t node) const {
    const formats::Strip& s = strip({level, world_->tileOf(level, node)});
    return s.nodes[node - s.first_node];
  }
  uint32_t top() const { return static_cast<uint32_t>(world_->levels().size() - 1); }

  // Every tile whose chance comes up and whose parents' tiles are in; the top level always. chance 1: everything. orphans: also where parents' tiles
  // are not in, as where these cannot be read.
  Cut randomCut(double chance, uint64_t seed, bool orphans = false) const {
    std::mt19937_64 random(seed);
    std::set<formats::TileId> in;
    for (uint32_t level = top() + 1; level-- > 0;)
      for (const formats::TileInfo& info : world_->tiles(level)) {
        bool parents = true;
        for (uint32_t i = 0; i < info.nodes && level < top(); ++i) {
          const uint32_t parent = world_->parent(level, info.first_node + i);
          parents = parents && in.count({level + 1, world_->tileOf(level + 1, parent)}) != 0;
        }
        const bool drawn = static_cast<double>(random() >> 11) < chance * 9007199254740992.0;
        if ((parents || orphans) && (level == top() || drawn)) in.insert(info.id);
      }
    Cut cut;
    for (const formats::TileId id : in) cut.push_back(packed_.at(id));
    return cut;
  }

 private:
  formats::TemporaryFolder folder_;
  formats::RandomWorld made_;
  std::unique_ptr<formats::WholeWorld> world_;
  std::map<formats::TileId, formats::Strip> strips_;
  std::map<formats::TileId, stream::StripPtr> packed_;
};

}  // namespace ff::runtime
