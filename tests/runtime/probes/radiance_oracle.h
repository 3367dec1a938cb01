// The light of a world by another road: every patch's radiosity from the full solve, and Embree to find the patch that a
// ray meets. Sun, sky and lamps.
#pragma once
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "bake/rays/ray_caster.h"
#include "formats/read/whole_world.h"
#include "runtime/cut/node_values.h"
#include "runtime/full_solve.h"
#include "runtime/updater.h"
#include "tools/chart/sun_light.h"

namespace ff::runtime {

class RadianceOracle {
 public:
  RadianceOracle(const formats::WholeWorld& world, const Sky& sky, Vec3 to_sun, Vec3 sun) : sky_(sky) {
    scene_.materials.emplace_back();
    std::vector<formats::Node> nodes;
    for (const formats::TileInfo& info : world.tiles(0)) {
      const auto geometry = world.geometry(info.id.tile);
      const auto strip = world.strip(info.id);
      if (!geometry || !strip) throw std::runtime_error("unreadable world");
      nodes.insert(nodes.end(), strip->nodes.begin(), strip->nodes.end());
      for (size_t t = 0; t < geometry->patch.size(); ++t) {
        const auto first = static_cast<uint32_t>(scene_.positions.size());
        for (size_t k = 0; k < 3; ++k) scene_.positions.push_back(geometry->positions[3 * t + k]);
        scene_.triangles.push_back({{first, first + 1, first + 2}, 0});
        patch_of_.push_back(formats::wholeNumber(info.first_node + geometry->patch[t]));
      }
    }
    auto caster = bake::RayCaster::create(scene_);
    if (!caster) throw std::runtime_error(caster.error().line());
    caster_ = std::make_unique<bake::RayCaster>(std::move(*caster));
    sun_ = std::move(*chart::sunIrradiance(world, to_sun, sun));
    radiosity_ = solveFullWorld(world, *fullSource(world, sun_, sky, Lamps(world.info())))->radiosity;
    for (size_t i = 0; i < nodes.size(); ++i)
      for (size_t c = 0; c < 3; ++c) radiosity_[3 * i + c] += static_cast<double>(nodes[i].emission[static_cast<int>(c)]);
  }

  const std::vector<Vec3>& sun() const { return sun_; }  // irradiance by patch

  struct Irradiance {
    double value[3] = {0, 0, 0};
    double deviation[3] = {0, 0, 0};  // of a single ray's share
    double back_faces = 0, sky = 0;   // of the rays
  };
  // By cosine-distributed rays drawn at random.
  Irradiance at(Vec3 point, Vec3 normal, int rays, uint64_t seed) const {
    std::mt19937_64 random(seed);
    const auto uniform = [&] { return static_cast<float>(random() >> 40) * 0x1p-24f; };
    const Vec3 x = normalized(cross(normal, std::abs(normal.x) < 0.5f ? Vec3{1, 0, 0} : Vec3{0, 1, 0}));
    const Vec3 y = cross(normal, x);
    Irradiance e;
    double squares[3] = {0, 0, 0};
    for (int r = 0; r < rays; ++r) {
      const float radius = std::sqrt(uniform()), angle = 6.2831853f * uniform();
      const Vec3 d = normalized(radius * std::cos(angle) * x + radius * std::sin(angle) * y +
                                std::sqrt(1 - radius * radius) * normal);
      const bake::Hit hit = caster_->nearest({point, d});
      double share[3] = {0, 0, 0};
      if (hit.triangle == bake::kNone) {
        e.sky += 1.0 / rays;
        for (int c = 0; c < 3; ++c) share[c] = 3.14159265358979 * static_cast<double>(skyRadiance(sky_, d)[c]);
      } else if (hit.front) {
        for (size_t c = 0; c < 3; ++c) share[c] = radiosity_[size_t{3} * patch_of_[hit.triangle] + c];
      } else {
        e.back_faces += 1.0 / rays;
      }
      for (int c = 0; c < 3; ++c) {
        e.value[c] += share[c] / rays;
        squares[c] += share[c] * share[c] / rays;
      }
    }
    for (int c = 0; c < 3; ++c) e.deviation[c] = std::sqrt(std::max(0.0, squares[c] - e.value[c] * e.value[c]));
    return e;
  }

 private:
  const Sky sky_;
  bake::Scene scene_;
  std::vector<uint32_t> patch_of_;  // by triangle
  std::unique_ptr<bake::RayCaster> caster_;
  std::vector<Vec3> sun_;
  std::vector<double> radiosity_;  // 3 a patch
};

}  // namespace ff::runtime
