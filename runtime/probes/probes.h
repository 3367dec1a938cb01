// Irradiance at arbitrary points with a normal, for what moves through the world and has no patches of its own. A probe
// is a row of its own: rays from the point, spread over its hemisphere by the cosine, meet the drawing triangles of the
// nearest tiles (FacetScene) and beyond them planes that stand for the leaves of the cut (ProbeTree). Few of these rays find
// a small lamp: the patches that emit which matter most get rays of their own, weighted so that both together are unbiased
// (the power heuristic: Eric Veach, Leonidas Guibas. Optimally Combining Sampling Techniques for Monte Carlo Rendering.
// 1995). What was met is kept until the point moves or the cut changes, so that a frame's light costs a sparse dot product
// with its radiosity. Nothing is interpolated between probes, so no light comes through walls.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/read/reader.h"
#include "runtime/cut/slot_map.h"
#include "runtime/probes/facet_scene.h"
#include "runtime/probes/probe_tree.h"
#include "runtime/updater.h"

namespace ff::runtime {

struct ProbeSettings {
  uint32_t rays = 256;           // per probe
  uint32_t max_lamps = 24;       // patches that emit, of the cut and with triangles here, that rays are sent to besides
  uint32_t lamp_rays = 6;        // to each, spread over it
  uint32_t max_kept = 1024;     // probes whose rays are remembered
  uint32_t max_refreshed = 16;  // per sample(): kept probes that are traced again because the cut has changed since
  uint64_t facet_bytes = uint64_t{128} << 20;  // of drawing triangles in memory; 0: planes everywhere
};

// An active tile of the cut.
struct ProbeTile {
  formats::TileId id;
  uint32_t first_slot = 0;
  std::span<const formats::Node> nodes;
};

struct ProbeStats {
  uint64_t traced = 0, kept = 0;  // probes answered by new rays, by remembered ones
  uint64_t refused = 0;           // and with zero, since they had no place or no direction
  uint32_t facet_tiles = 0;       // level-0 tiles whose triangles are here
  bool starved = false;           // FacetScenes::starved()
};

// One thread. Neither follow() nor sample() allocates, frees or waits.
class Probes {
 public:
  // slots: of the cut that follow() is told of. Both outlive the probes.
  Probes(const formats::World& world, const SlotMap& slots, const ProbeSettings& settings);

  // Where observers are, and the cut from now on: before sample(). leaf: by slot. cut: a number that differs whenever
  // the tiles, their slots or `leaf` do; costs little when it does not.
  void follow(const stream::Observers& observers, std::span<const ProbeTile> tiles, std::span<const uint8_t> leaf, uint64_t cut);
  // Irradiance, W/m2, of a surface at each point that faces along its normal (of any length), from everything but what
  // the caller has as direct light: radiosity of surfaces and the sky. radiosity: W/m2, by slot. The answer is a
  // function of the point, the cut and the light; only a probe that was kept over a change of the cut, because
  // max_refreshed others were before it, lags. Zero where point or normal is not finite, or the normal zero.
  void sample(std::span<const Vec3> points, std::span<const Vec3> normals, std::span<const Vec4> radiosity,
              const Sky& sky, std::span<Vec3> irradiance);
  // Blocks until the triangles around the last observer are here (tests, loading screens).
  void settle();
  bool settled() const { return facets_.settled(); }
  ProbeStats stats() const;

 private:
  struct Kept {
    Vec3 point, normal;
    uint64_t state = 0;  // state_ when it was traced; 0: empty
    uint64_t used = 0;   // sample() of the last use
    uint32_t places = 0;
    uint32_t sky = 0;  // rays
    Vec3 sky_directions;  // sum
    std::array<float, 5> sky_quadratics{};  // sum
  };
  struct Place {
    uint32_t slot;
    float weight;  // of its radiosity
  };
  // A patch that emits.
  struct Lamp {
    uint32_t slot, index;  // index: in its tile
    Vec3 centroid, normal;
    float area_m2, power;  // power: luminance as baked, W
  };
  // That rays of a probe are sent to.
  struct Aim {
    const Lamp* lamp;
    float importance;  // about the irradiance that it would give unhindered
    const TileFacets* tile = nullptr;
    float area_m2 = 0;  // of its triangles
  };
  struct Met {
    uint32_t slot = kNoSlot;
    const Facet* facet = nullptr;  // null: a plane, or the sky
    float distance_m = 0;
    bool front = true, sky = false;
  };
  void enter(const ProbeTile& tile, std::span<const uint8_t> leaf);
  void leave(uint32_t slot);
  bool standsStill(size_t kept) const;
  void hideCovered();
  size_t find(Vec3 point, Vec3 normal) const;
  void trace(size_t kept, Vec3 point, Vec3 normal);
  void addLamp(uint32_t slot, uint32_t index, const formats::Node& node);
  void removeLamp(uint32_t slot);
  void aimAtLamps(Vec3 point, Vec3 normal);
  void castAtLamps(Vec3 point, Vec3 normal);
  Met meet(const RayLine& ray, uint32_t number) const;
  float weight(const Aim& aim, const Facet& facet, Vec3 direction, float cosine, float distance_m, bool own) const;
  Vec3 evaluate(size_t kept, std::span<const Vec4> radiosity, const Sky& sky) const;

  const formats::World& world_;
  const SlotMap& slots_;
  const ProbeSettings settings_;
  ProbeTree tree_;
  std::vector<Vec3> rays_;  // around +z
  // The cut, by slot.
  std::vector<formats::TileId> tile_of_slot_;  // kFree: none
  std::vector<uint8_t> hidden_;          // its plane: the triangles of all patches beneath are there
  std::vector<uint32_t> seen_;           // the last follow() whose cut held the slot
  std::vector<uint64_t> changed_;        // state_ since which the slot stands for what it stands for now
  uint64_t cut_ = ~uint64_t{0}, state_ = 1;
  uint32_t follows_ = 0;
  std::vector<Kept> kept_;
  std::vector<Place> places_;    // max_places_ of each
  const size_t max_places_;
  std::vector<Place> met_;       // by a probe's rays
  std::vector<Lamp> lamps_;      // of the cut, in no order
  std::vector<uint32_t> lamp_of_slot_, aim_of_slot_;  // number and one more; 0: none
  std::vector<Aim> aims_;        // of the probe that is traced, in no order
  uint64_t samples_ = 0;
  ProbeStats stats_;
  FacetScenes facets_;
};

}  // namespace ff::runtime
