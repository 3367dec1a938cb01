// Leaks: light in closed dark rooms beside lit ones, with walls of 1 m between them. Whatever shines there comes from a
// patch or a cluster that spans both.
#include <algorithm>
#include <cmath>
#include <utility>

#include "bake/light/form_factor.h"
#include "formats/read/whole_world.h"
#include "runtime/cut/node_values.h"
#include "runtime/solver/solver.h"
#include "stream/streamer.h"
#include "stream/strip_loader.h"
#include "tools/chart/baked_scene.h"
#include "tools/chart/neighbourhood.h"
#include "tools/chart/patch_rows.h"
#include "tools/chart/stability/parts.h"

namespace ff::chart {

using namespace bake;

namespace {

constexpr Vec3 kRoom{4, 3, 4};
constexpr float kWall = 1;
constexpr float kAlbedo = 0.5f;
enum RoomMaterial : uint32_t { kLit, kDark };

bool isLit(uint32_t x, uint32_t z) { return (x + z) % 2 == 0; }

// Inside faces of one room; counter-clockwise seen from within.
void addRoom(Scene& scene, Vec3 lo, uint32_t material) {
  const Vec3 hi = lo + kRoom;
  const auto quad = [&](Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
    const auto first = static_cast<uint32_t>(scene.positions.size());
    for (const Vec3& p : {a, b, c, d}) scene.positions.push_back(p);
    scene.triangles.push_back({{first, first + 1, first + 2}, material});
    scene.triangles.push_back({{first, first + 2, first + 3}, material});
  };
  const auto at = [&](int x, int y, int z) { return Vec3{x ? hi.x : lo.x, y ? hi.y : lo.y, z ? hi.z : lo.z}; };
  quad(at(0, 0, 0), at(0, 1, 0), at(0, 1, 1), at(0, 0, 1));
  quad(at(1, 0, 0), at(1, 0, 1), at(1, 1, 1), at(1, 1, 0));
  quad(at(0, 0, 0), at(0, 0, 1), at(1, 0, 1), at(1, 0, 0));
  quad(at(0, 1, 0), at(1, 1, 0), at(1, 1, 1), at(0, 1, 1));
  quad(at(0, 0, 0), at(1, 0, 0), at(1, 1, 0), at(0, 1, 0));
  quad(at(0, 0, 1), at(0, 1, 1), at(1, 1, 1), at(1, 0, 1));
}

// Rooms in a square, lit and dark like a chessboard. Direct light falls on all surfaces of lit rooms alike, 1 W/m2 goes
// on from there; nothing shines by itself (the bake keeps what does apart), all reflect the same.
Scene rooms(uint32_t across, uint32_t deep) {
  Scene scene;
  scene.name = "rooms";
  for (const char* name : {"lit", "dark"})
    scene.materials.push_back({.name = name, .base_color = {kAlbedo, kAlbedo, kAlbedo}, .metallic = 0, .emission = {}});
  for (uint32_t x = 0; x < across; ++x)
    for (uint32_t z = 0; z < deep; ++z)
      addRoom(scene, {static_cast<float>(x) * (kRoom.x + kWall), 0, static_cast<float>(z) * (kRoom.z + kWall)},
              isLit(x, z) ? kLit : kDark);
  return scene;
}

// Mean light on dark surfaces over that on lit ones, from values given for pieces of surface.
struct Balance {
  double area[2] = {0, 0}, light[2] = {0, 0};
  void add(uint32_t material, double area_m2, double b) {
    area[material] += area_m2;
    light[material] += area_m2 * b;
  }
  double leaked() const { return light[kLit] > 0 && area[kDark] > 0 ? light[kDark] / area[kDark] / (light[kLit] / area[kLit]) : 0; }
};

template <class Visit>
void eachPiece(const Scene& scene, const PatchSet& set, const Patch& patch, const Visit& visit) {
  for (uint32_t t = 0; t < patch.triangles; ++t) {
    const PatchTriangle& piece = set.triangles[patch.first_triangle + t];
    visit(scene.triangles[piece.source].material,
          0.5 * static_cast<double>(length(cross(piece.b - piece.a, piece.c - piece.a))));
  }
}

struct PatchLeak {
  double leaked = 0;
  size_t patches = 0, shared = 0;  // shared: patches with surface of both rooms
};

Result<PatchLeak> leakOfPatches(const Scene& scene, float cell_m, uint32_t rays, uint64_t seed) {
  const auto caster = RayCaster::create(scene);
  if (!caster) return caster.error();
  auto set = makePatches(scene, {.cell_m = cell_m}, &*caster);
  if (!set) return set.error();
  WorkCount done;
  const PatchRows rows = pooledRows(*set, castRows(scene, *set, *caster, rays, seed, done), 512);
  std::vector<double> source;
  for (const Patch& p : set->patches) {
    Balance surface;
    eachPiece(scene, *set, p, [&](uint32_t material, double area_m2) { surface.add(material, area_m2, 0); });
    const double lit = surface.area[kLit] / (surface.area[kLit] + surface.area[kDark]);
    source.insert(source.end(), 3, lit);
  }
  const std::vector<double> b = solveRows(*set, rows, source, 1e-10, 1000);
  Balance balance;
  PatchLeak leak;
  leak.patches = set->patches.size();
  for (size_t i = 0; i < set->patches.size(); ++i) {
    bool of[2] = {false, false};
    eachPiece(scene, *set, set->patches[i], [&](uint32_t material, double area_m2) {
      of[material] = true;
      balance.add(material, area_m2, b[3 * i]);
    });
    leak.shared += of[kLit] && of[kDark];
  }
  leak.leaked = balance.leaked();
  return leak;
}

// Which kind of room a patch of the baked chessboard is in: surfaces lie on the room's own side of the wall.
uint32_t materialAt(const formats::Node& node) {
  const Vec3 inside = node.centroid + node.normal * (kWall / 4);
  return isLit(static_cast<uint32_t>(inside.x / (kRoom.x + kWall)), static_cast<uint32_t>(inside.z / (kRoom.z + kWall)))
             ? kLit
             : kDark;
}

// Direct light of all levels: clusters have the mean over their patches, as the run time asks for it.
Result<runtime::NodeValues> directLight(const formats::WholeWorld& world) {
  const auto areas = runtime::patchAreas(world);
  if (!areas) return areas.error();
  std::vector<Vec3> direct;
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto strip = world.strip(info.id);
    if (!strip) return strip.error();
    for (const formats::Node& node : strip->nodes) direct.push_back(materialAt(node) == kLit ? Vec3{1, 1, 1} : Vec3{});
  }
  return runtime::aggregateUp(world, *areas, direct);
}

// The cut's light, by slot.
Result<std::vector<runtime::Vec4>> solved(const formats::WholeWorld& world, const runtime::NodeValues& direct,
                                          const runtime::LocalMatrix& matrix, std::span<const stream::StripPtr> active,
                                          int threads) {
  using namespace runtime;
  std::vector<Vec4> source(matrix.slots()), b(matrix.slots());
  for (const auto& strip : active) {
    const std::span<const Vec3> m = direct.tile(world, strip->id);
    const uint32_t first = matrix.slotOf(strip->id.level, strip->first_node);
    for (uint32_t i = 0; i < m.size(); ++i) source[first + i] = {m[i].x, m[i].y, m[i].z, 0};
  }
  const auto solver = makeCpuGather(threads);
  if (auto lit = lightUp(matrix, source, *solver); !lit) return lit.error();
  if (auto done = solver->iterate(100); !done) return done.error();  // albedo 0.5: settled to single precision
  if (auto read = solver->radiosity(b); !read) return read.error();
  return b;
}

// The brightest patch of the dark room around the eye, over the light of a lit room.
Result<double> leakAround(const formats::WholeWorld& world, const runtime::NodeValues& direct, Vec3 eye, int threads) {
  auto streamer = stream::Streamer::create(world, {});
  if (!streamer) return streamer.error();
  (*streamer)->update(eye, {});
  if (auto settled = (*streamer)->settle(); !settled) return settled.error();
  const auto matrix = runtime::buildLocalMatrix(world, (*streamer)->active());
  if (!matrix) return matrix.error();
  const auto b = solved(world, direct, *matrix, (*streamer)->active(), threads);
  if (!b) return b.error();
  double most = 0;
  for (const auto& strip : (*streamer)->active())
    for (uint32_t i = 0; i < strip->nodes.size() && strip->id.level == 0; ++i) {
      const Vec3 away = strip->nodes[i].centroid - eye;
      if (std::abs(away.x) > kRoom.x / 2 + 0.01f || std::abs(away.z) > kRoom.z / 2 + 0.01f) continue;
      most = std::max(most, static_cast<double>((*b)[matrix->slotOf(0, strip->first_node + i)].x));
    }
  return most * (1 - static_cast<double>(kAlbedo));
}

// Everything from one level up active, solved; every patch has the light of its ancestor there.
Result<double> leakOfLevel(const formats::WholeWorld& world, const runtime::NodeValues& direct, uint32_t level,
                           int threads) {
  using namespace runtime;
  std::vector<stream::StripPtr> active;
  for (uint32_t l = level; l < world.levels().size(); ++l)
    for (const formats::TileInfo& info : world.tiles(l)) {
      auto strip = stream::readResident(world, world.ref(info.id));
      if (!strip) return strip.error();
      active.push_back(std::move(*strip));
    }
  const auto matrix = buildLocalMatrix(world, active);
  if (!matrix) return matrix.error();
  const auto b = solved(world, direct, *matrix, active, threads);
  if (!b) return b.error();
  Balance balance;
  for (const formats::TileInfo& info : world.tiles(0)) {
    const auto strip = world.strip(info.id);
    if (!strip) return strip.error();
    for (uint32_t i = 0; i < info.nodes; ++i) {
      uint32_t node = formats::wholeNumber(info.first_node + i);
      for (uint32_t l = 0; l < level; ++l) node = world.parent(l, node);
      balance.add(materialAt(strip->nodes[i]), static_cast<double>(strip->nodes[i].area_m2),
                  static_cast<double>((*b)[matrix->slotOf(level, node)].x));
    }
  }
  return balance.leaked();
}

}  // namespace

Result<StabilityPart> stabilityOfLeaks(const StabilityOptions& options, const StabilityProgress& progress) {
  StabilityPart part;
  if (progress) progress("leaks: patches larger than rooms");
  const Scene two = rooms(2, 1);
  Measured patches{.scene = "dark room beside a lit one (share of its light)",
                   .method = "patches of that size",
                   .knob = "patch size",
                   .unit = "m",
                   .points = {},
                   .then = {}};
  std::string first_shared;
  for (const float share : {0.125f, 0.25f, 0.5f, 1.0f, 2.0f, 3.0f, 4.0f, 4.5f, 6.0f, 8.0f}) {
    const float cell = share * kRoom.x;
    const auto leak = leakOfPatches(two, cell, options.quick ? 1024 : 4096, options.seed);
    if (!leak) return leak.error();
    patches.points.push_back({static_cast<double>(cell), leak->leaked});
    if (leak->shared > 0 && first_shared.empty())
      first_shared =
          "from " + numberText(static_cast<double>(cell)) + " m on " + numberText(static_cast<double>(leak->shared)) +
          " of " + numberText(static_cast<double>(leak->patches)) +
          " patches have surface of both rooms: pieces under " +
          percentText(static_cast<double>(PatchSettings{}.crumb_fraction)) + " of a cell join the nearest patch";
  }
  patches.then = first_shared.empty() ? "surfaces that do not touch are never one patch" : first_shared;

  const uint32_t across = options.quick ? 10 : 40;
  if (progress) progress("leaks: clusters");
  const auto baked = BakedScene::bake(rooms(across, across), {.cell_m = 1,
                                                              .rays = options.quick ? 256u : 512u,
                                                              .seed = options.seed,
                                                              .threads = options.threads,
                                                              .geometry = false});
  if (!baked) return baked.error();
  const auto direct = directLight(baked->world());
  if (!direct) return direct.error();
  const auto levels = static_cast<uint32_t>(baked->world().levels().size());
  Measured clusters{.scene = "dark rooms beside lit ones (share of their light)",
                    .method = "one level of the pyramid alone",
                    .knob = "cluster size",
                    .unit = "m",
                    .points = {},
                    .then = {}};
  for (uint32_t level = 0; level < levels; ++level) {
    uint64_t nodes = 0;
    for (uint32_t l = level; l < levels; ++l) nodes += baked->world().levels()[l].nodes;
    if (nodes > runtime::kMaxSlots) continue;  // more than a cut can hold
    const auto leaked = leakOfLevel(baked->world(), *direct, level, options.threads);
    if (!leaked) return leaked.error();
    clusters.points.push_back({std::exp2(static_cast<double>(level)), *leaked});
  }
  const stream::StreamSettings defaults;
  const auto around =
      leakAround(baked->world(), *direct, {1.5f * kRoom.x + kWall, kRoom.y / 2, kRoom.z / 2}, options.threads);
  if (!around) return around.error();
  double nearest = 0;
  for (size_t l = 0; l < clusters.points.size(); ++l)
    if (clusters.points[l].error > 0.01) {
      nearest = static_cast<double>(defaults.radius_m) *
                std::pow(static_cast<double>(defaults.growth), std::log2(clusters.points[l].at) - 1);
      break;
    }
  clusters.then = nearest > 0
                      ? "the cut has such clusters only " + numberText(std::round(nearest)) +
                            " m from the eye and farther; in the dark room around the eye the brightest patch has " +
                            percentText(*around) + " of a lit room's light"
                      : "nothing to do";
  Chart chart;
  chart.id = "leaks";
  chart.title = "Leaks: light in a closed dark room beside a lit one";
  chart.x_label = "size of a patch or cluster, m (the rooms are 4 m wide, walls 1 m)";
  chart.y_label = "share of the lit room's light";
  chart.note =
      "Patches are cut by cells of that size and lit by their own rows. Clusters: all of one level of a baked "
      "chessboard of " +
      numberText(across) + " x " + numberText(across) +
      " rooms, without the finer ones, which the cut never does nearby. No light at all is drawn at the lower edge.";
  chart.log_x = chart.log_y = true;
  chart.y_marks = {{0.01, "1 %"}, {0.05, "5 %"}};
  chart.x_marks = {{static_cast<double>(kRoom.x), "a room"}};
  chart.series = {seriesOf(patches, patches.method), seriesOf(clusters, clusters.method)};
  part.lead =
      "Light leaks past 1 % into a closed room " +
      (passes(patches, 0.01).starts_with("never") ? "with no patch size tried"
                                                  : "with patches of " + passes(patches, 0.01)) +
      ", and " +
      (passes(clusters, 0.01).starts_with("never") ? "with no cluster" : "with clusters of " + passes(clusters, 0.01)) +
      " (rooms of " + numberText(static_cast<double>(kRoom.x)) + " m).";
  part.charts = {std::move(chart)};
  part.measured = {std::move(patches), std::move(clusters)};
  return part;
}

}  // namespace ff::chart
