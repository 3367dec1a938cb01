// The radius of the cut towards nothing: what of the light beside the eye is lost when less and less around it is kept
// at full detail, with the pyramid beyond and with one constant beyond.
#include <algorithm>
#include <cmath>
#include <utility>

#include "formats/read/whole_world.h"
#include "tools/chart/baked_scene.h"
#include "tools/chart/neighbourhood.h"
#include "tools/chart/scene_of_model.h"
#include "tools/chart/stability/parts.h"
#include "tools/scene/town.h"

namespace ff::chart {

using namespace runtime;

namespace {

constexpr float kReach_m = 6;     // patches nearer than this to the eye are compared, active or not
constexpr int kIterations = 200;  // half of the light leaves for the sky: settled to single precision

struct Sums {
  double difference = 0, norm = 0;
  double relative() const { return norm > 0 ? std::sqrt(difference / norm) : 0; }
};

// Radiosity of a patch as the cut has it: its own, or that of its nearest active ancestor; else what is far.
Vec4 valueOf(const formats::WholeWorld& world, const LocalMatrix& matrix, std::span<const Vec4> radiosity, uint32_t patch,
             Vec4 far_value) {
  const formats::TileRef tile = world.ref({0, world.tileOf(0, patch)});
  const uint32_t slot = slotFor(matrix.tiles, tile, formats::wholeNumber(patch - tile.info().first_node));
  return slot != kNoSlot ? radiosity[slot] : far_value;
}

Result<Sums> compareNear(const formats::WholeWorld& world, const WorldTruth& truth, const Neighbourhood& there,
                         FarLight far_light, int threads) {
  const auto matrix = buildLocalMatrix(world, there.streamer->active(), far_light);
  if (!matrix) return matrix.error();
  std::vector<Vec4> source = sourceOf(truth, world, *matrix, there.streamer->active()), b(matrix->slots());
  const Vec4 outside = meanOutside(truth, *matrix);
  if (far_light == FarLight::kConstant) source[matrix->ambient_slot] = outside;
  const auto solver = makeCpuGather(threads);
  if (auto lit = lightUp(*matrix, source, *solver); !lit) return lit.error();
  if (auto done = solver->iterate(kIterations); !done) return done.error();
  if (auto read = solver->radiosity(b); !read) return read.error();
  Sums sums;
  for (const formats::Strip& strip : truth.patches)
    for (uint32_t i = 0; i < strip.nodes.size(); ++i) {
      if (length(strip.nodes[i].centroid - there.at.observer) > kReach_m) continue;
      const uint32_t patch = formats::wholeNumber(strip.first_node + i);
      const Vec4 x = valueOf(world, *matrix, b, patch, outside);
      const double value[3] = {static_cast<double>(x.x), static_cast<double>(x.y), static_cast<double>(x.z)};
      for (size_t c = 0; c < 3; ++c) {
        const double t = truth.radiosity[3 * size_t{patch} + c];
        sums.difference += (value[c] - t) * (value[c] - t);
        sums.norm += t * t;
      }
    }
  return sums;
}

}  // namespace

Result<StabilityPart> stabilityOfRadius(const StabilityOptions& options, const StabilityProgress& progress) {
  if (progress) progress("radius: a town is baked");
  const auto town = tools::makeTown({.patches = options.quick ? 8000u : 30000u, .seed = options.seed});
  if (!town) return town.error();
  const auto baked = BakedScene::bake(
      sceneOf(tools::townModel(*town, false)),
      {.cell_m = 1, .rays = options.quick ? 512u : 2048u, .seed = options.seed, .threads = options.threads});
  if (!baked) return baked.error();
  const formats::WholeWorld& world = baked->world();
  const auto truth = solveWorldTruth(world, false);
  if (!truth) return truth.error();
  const std::vector<float> radii = options.quick ? std::vector<float>{24, 16, 12, 8, 4, 2, 1}
                                                 : std::vector<float>{32, 24, 16, 12, 8, 6, 4, 3, 2, 1, 0.5f};
  const std::string scene = "town of " + numberText(static_cast<double>(world.levels()[0].nodes)) + " patches of 1 m, sun and sky";
  Measured pyramid{
      .scene = scene, .method = "the pyramid beyond", .knob = "radius", .unit = "m", .points = {}, .then = {}};
  Measured constant = pyramid;
  constant.method = "one constant beyond";
  constant.then = "nothing: the constant is already at its best value";
  Measured nodes = pyramid;
  const auto eyes = observersOf(*truth, options.quick ? 8 : 24, world.info().cell_m);
  for (const float radius : radii) {
    if (progress) progress("radius " + numberText(static_cast<double>(radius)) + " m");
    Sums sums[2];
    double leaves = 0;
    for (const Vec3 eye : eyes) {
      const auto there =
          neighbourhoodAt(world, *truth, eye, {.radius_m = radius, .hysteresis = 1, .max_level0_nodes = 32768});
      if (!there) return there.error();
      leaves += static_cast<double>(there->leaves()) / static_cast<double>(eyes.size());
      size_t k = 0;
      for (const FarLight far_light : {FarLight::kPyramid, FarLight::kConstant}) {
        const auto near = compareNear(world, *truth, *there, far_light, options.threads);
        if (!near) return near.error();
        sums[k].difference += near->difference;
        sums[k++].norm += near->norm;
      }
    }
    pyramid.points.push_back({static_cast<double>(radius), sums[0].relative()});
    constant.points.push_back({static_cast<double>(radius), sums[1].relative()});
    nodes.points.push_back({static_cast<double>(radius), leaves});
  }
  pyramid.then = "falls back to clusters: the cut has " + numberText(std::round(nodes.points.back().error)) +
                 " nodes at " + numberText(nodes.points.back().at) + " m, " +
                 numberText(std::round(nodes.points.front().error)) + " at " + numberText(nodes.points.front().at) +
                 " m";
  Chart chart;
  chart.id = "error-radius";
  chart.title = "Far too small a radius: a " + scene;
  chart.x_label = "radius of level 0, m";
  chart.y_label = "relative L2 error of radiosity";
  chart.note =
      "All patches within " + numberText(static_cast<double>(kReach_m)) + " m of " +
      numberText(static_cast<double>(eyes.size())) +
      " eyes against the full-world solve of the same rows. A patch that is not active is seen as its nearest active "
      "ancestor, or as the constant. Tiles come whole: at least the one that the eye is in.";
  chart.log_x = chart.log_y = true;
  chart.y_marks = {{0.01, "1 %"}, {0.05, "5 %"}};
  const stream::StreamSettings defaults;
  chart.x_marks = {{static_cast<double>(defaults.radius_m), "default"}};
  chart.series = {seriesOf(pyramid, pyramid.method), seriesOf(constant, constant.method)};
  const auto at_default = [&](const Measured& m) {
    for (const Measured::Point& p : m.points)
      if (p.at == static_cast<double>(defaults.radius_m)) return percentText(p.error);
    return std::string("not run");
  };
  StabilityPart part;
  part.lead = "At the default radius of " + numberText(static_cast<double>(defaults.radius_m)) + " m a town errs by " +
              at_default(pyramid) + " beside the eye, with a constant beyond by " + at_default(constant) + ".";
  part.charts = {std::move(chart)};
  part.measured = {std::move(pyramid), std::move(constant)};
  return part;
}

}  // namespace ff::chart
