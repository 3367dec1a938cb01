#include "tools/view/run.h"

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "formats/read/whole_world.h"
#include "runtime/clock.h"
#include "runtime/cut/node_values.h"
#include "runtime/full_solve.h"
#include "runtime/updater.h"
#include "stream/streamer.h"
#include "tools/view/light.h"
#include "tools/view/lights.h"
#include "tools/view/picture.h"

namespace ff::view {
namespace {

using nlohmann::json;
using runtime::Clock;
using runtime::msSince;

constexpr float kHeatScale = 0.1f;  // full scale of difference pictures: 10 % of the mean reflected radiosity
// Change of an iteration over the largest radiosity: a dark room beside a sunlit wall needs it small.
constexpr float kConverged = 1e-6f;
constexpr double kAdaptionSeconds = 0.7;  // in which automatic exposure follows all but 1/e of a change

json triple(Vec3 v) { return json::array({v.x, v.y, v.z}); }

// Where nothing was said about the light: sun and sky for worlds that see them, the lamps alone for those that do not. The
// strongest directional light of the file is the sun; the sky that nobody named then keeps its ratio to it.
struct Lighting {
  Sun sun;
  runtime::Sky sky;
  std::vector<formats::Light> lights;  // of the file, without what has become the sun
};

float strength(Vec3 irradiance) { return irradiance.x + irradiance.y + irradiance.z; }

Lighting lightingFor(const RunOptions& options, const CameraPath& camera, const ViewScene& scene,
                     std::span<const formats::Light> of_file) {
  Lighting l;
  const Sun usual{normalized({0.512f, 0.768f, 0.384f}), {13.0f, 11.8f, 9.6f}};
  const bool sun_named = options.sun || camera.sun || options.lamps_only;
  for (formats::Light light : of_file) {
    light.color_intensity *= options.lights;
    if (light.color_intensity == Vec3{} || (light.kind == formats::Light::kDirectional && sun_named)) continue;
    l.lights.push_back(std::move(light));
  }
  if (options.lamps_only) return l;
  const bool sealed = openness(scene) < 0.01f;
  if (!sealed) {
    l.sun = usual;
    l.sky = skyOf({0.9f, 1.15f, 1.5f}, {0.1f, 0.3f, 0.6f});
  }
  auto sun = l.lights.end();
  for (auto it = l.lights.begin(); it != l.lights.end(); ++it)
    if (it->kind == formats::Light::kDirectional &&
        (sun == l.lights.end() || strength(it->color_intensity) > strength(sun->color_intensity)))
      sun = it;
  if (sun != l.lights.end()) {
    l.sun = {sun->direction * -1.0f, sun->color_intensity};
    const float ratio = strength(l.sun.irradiance) / strength(usual.irradiance);
    l.sky.l0 *= ratio;
    for (Vec3& gradient : l.sky.l1) gradient *= ratio;
    l.lights.erase(sun);
  }
  l.sun = options.sun.value_or(camera.sun.value_or(l.sun));
  l.sky = options.sky.value_or(camera.sky.value_or(l.sky));
  return l;
}

// Everything that lasts for the whole flight. Members die in reverse order: the context goes last.
struct Flight {
  const RunOptions& options;
  const formats::WholeWorld& world;
  std::shared_ptr<runtime::VkContext> context;
  ViewScene scene;
  Lists neighbours;  // Weld::neighbours
  DrawGeometry geometry;
  CameraPath camera;
  Lighting light;
  SunRaster raster;
  Renderer renderer;
  std::vector<float> sun_exposure;      // per patch
  runtime::NodeValues direct_on_nodes;  // irradiance from the sun and the lights of the file
  std::vector<double> source, full;     // of the full solve, 3 per patch
  float radius_m = 0;
  std::string name;                     // of the world's file, without folder and extension
  float stops = 0;                      // exposure of the last picture, at last_t
  double last_t = 0;
};

struct PictureNames {
  std::string direct, bounce, difference;
};

PictureNames namesOf(const Flight& f, int frame) {
  char number[16];
  std::snprintf(number, sizeof(number), "%04d", frame);
  const std::string stem = f.name + "_" + number;
  return {stem + "_direct.png", stem + "_bounce.png", stem + "_difference.png"};
}

Result<void> writePictures(const Flight& f, const Rendered& drawn, const PictureNames& names, float exposure) {
  const RunOptions& o = f.options;
  const std::filesystem::path folder(o.out_folder);
  const auto toned = [&](const std::vector<runtime::Vec4>& pixels) {
    return toneMapped(pixels, o.width, o.height, o.samples, exposure);
  };
  if (auto w = writePng(toned(drawn.direct), (folder / names.direct).string()); !w) return w;
  if (auto w = writePng(toned(drawn.bounced), (folder / names.bounce).string()); !w) return w;
  if (!o.compare) return {};
  const Picture heat = heatMap(drawn.difference, o.width, o.height, o.samples, kHeatScale,
                               "|streamed - full solve| / mean reflected radiosity");
  return writePng(heat, (folder / names.difference).string());
}

// Empty: the frame has errors.
std::string whyNotCompared(const Flight& f, const Comparison& comparison) {
  if (!f.options.compare) return "--no-difference leaves the full-world solve out";
  if (comparison.patches_compared > 0) return {};
  char radius[32];
  std::snprintf(radius, sizeof(radius), "%.3g", static_cast<double>(0.5f * f.radius_m));
  return "no patch within " + std::string(radius) +
         " m of the eye, half the radius, is lit by itself: raise --radius, or "
         "bring the eye nearer";
}

Result<json> flyFrame(Flight& f, stream::Streamer& streamer, runtime::Updater& updater, int frame, double t) {
  const View view = f.camera.at(t);
  const Vec3 velocity = f.camera.velocityAt(t);
  const stream::StreamStats before = streamer.stats();
  // A picture waits for its strips; a game would draw coarser light until they are there.
  streamer.update(view.eye, velocity);
  if (auto r = streamer.settle(); !r) return r.error();
  auto stats = updater.frame(view.eye, velocity, f.options.iterations);
  if (!stats) return stats.error();
  auto settled = updater.converge(kConverged, f.options.settle);
  if (!settled) return settled.error();

  const runtime::LocalMatrix& matrix = updater.matrix();
  std::vector<runtime::Vec4> reflected(matrix.slots());
  if (auto r = updater.reflected(reflected); !r) return r.error();
  const auto slots = gatherLight(matrix, reflected);
  const auto patch_slot = patchSlots(f.world, matrix);
  Comparison comparison;
  comparison.difference.resize(f.scene.patches.size());
  if (f.options.compare)
    comparison = compare(f.scene, matrix, patch_slot, slots, f.full, f.source, view.eye, 0.5f * f.radius_m);

  const auto draw_start = Clock::now();
  const auto smooth = patchLight(f.scene, f.neighbours, patch_slot, slots);
  auto drawn = f.renderer.render(f.raster, f.geometry, view, f.light.sun, {smooth, comparison.difference, f.sun_exposure});
  if (!drawn) return drawn.error();
  const double draw_ms = msSince(draw_start);
  const float wanted = f.options.exposure_stops.value_or(exposureStops(drawn->bounced));
  if (frame == 0 || f.options.exposure_stops) f.stops = wanted;
  f.stops += static_cast<float>(1 - std::exp(-(t - f.last_t) / kAdaptionSeconds)) * (wanted - f.stops);
  f.last_t = t;
  const float exposure = std::exp2(f.stops);
  const PictureNames names = namesOf(f, frame);
  if (auto w = writePictures(f, *drawn, names, exposure); !w) return w.error();

  const stream::StreamStats s = streamer.stats();
  json j = {{"frame", frame},
            {"t", t},
            {"eye", triple(view.eye)},
            {"slots", stats->slots},
            {"leaves", stats->leaves},
            {"level0_leaves", stats->level0_leaves},
            {"entries", stats->entries},
            {"matrix_ms", stats->matrix_ms},
            {"solve_ms", stats->solve_ms},
            {"solve_iterations", f.options.iterations},
            {"iterations_to_converge", settled->iterations},
            {"settled", settled->settled},
            {"settle_change", settled->change},
            {"draw_ms", draw_ms},
            {"bytes_read", s.bytes_read - before.bytes_read},
            {"strips_read", s.strips_read - before.strips_read},
            {"reads", s.reads - before.reads},
            {"resident_bytes", s.resident_bytes},
            {"strips_failed", s.failed},
            {"exposure_stops", f.stops},
            {"direct_picture", names.direct},
            {"bounce_picture", names.bounce}};
  if (f.options.compare) {
    j["difference_picture"] = names.difference;
    j["patches_compared"] = comparison.patches_compared;
  }
  const std::string why = whyNotCompared(f, comparison);
  j["reflected_error_inner"] = why.empty() ? json(comparison.reflected_error) : json(nullptr);
  j["bounced_error_inner"] = why.empty() ? json(comparison.bounced_error) : json(nullptr);
  if (!why.empty()) j["not_compared_because"] = why;
  return j;
}

Result<void> writeFigures(const json& figures, const std::string& path) {
  std::ofstream out(path, std::ios::binary);
  out << figures.dump(1) << "\n";
  out.close();
  if (!out) return Error{ErrorCode::kIo, path, "", "cannot be written", ""};
  return {};
}

Result<void> refuseMessages(const runtime::VkContext& context) {
  const auto messages = runtime::validationMessages(context);
  if (messages.empty()) return {};
  return Error{ErrorCode::kIo, "", "vulkan validation", std::to_string(messages.size()) + " messages, first: " + messages.front(), ""};
}

// Sun, drawing geometry, renderer, full solve: all that is done once.
Result<void> prepare(Flight& f, json& figures, const std::function<void(const std::string&)>& say) {
  auto scene = loadScene(f.world);
  if (!scene) return scene.error();
  f.scene = std::move(*scene);
  auto start = Clock::now();
  Weld weld = weldScene(f.scene);
  f.neighbours = std::move(weld.neighbours);
  say(std::to_string(f.scene.patches.size()) + " patches, " + std::to_string(f.scene.triangles()) + " triangles, " +
      std::to_string(weld.position.size()) + " light vertices");
  figures["weld_ms"] = msSince(start);
  if (f.options.camera.empty()) {
    f.camera = findPath(f.scene, f.options.lamps_only);
  } else {
    auto camera = readCamera(f.options.camera, f.world.info().origin);
    if (!camera) return camera.error();
    f.camera = std::move(*camera);
  }
  json& keys = figures["camera"]["keys"];  // a found path can be flown again
  const auto inScene = [&](Vec3 p) {
    const auto& origin = f.world.info().origin;
    return json{static_cast<double>(p.x) + origin[0], static_cast<double>(p.y) + origin[1], static_cast<double>(p.z) + origin[2]};
  };
  for (const CameraKey& k : f.camera.keys) keys.push_back({{"t", k.t}, {"eye", inScene(k.eye)}, {"target", inScene(k.target)}});
  figures["camera"]["fps"] = f.camera.fps;
  f.light = lightingFor(f.options, f.camera, f.scene, f.world.info().lights);
  figures["sun"] = {{"direction", triple(f.light.sun.to_sun)}, {"irradiance", triple(f.light.sun.irradiance)}};
  figures["openness"] = openness(f.scene);
  figures["dark"] = !f.light.sun.shines() && f.light.sky.l0 == Vec3{} && f.light.lights.empty() && f.world.info().lamp_groups.empty();

  start = Clock::now();
  std::vector<Vec3> direct = irradianceFrom(f.light.lights, f.scene);
  for (size_t p = 0; p < direct.size(); ++p) f.scene.lamps[p] += direct[p];
  figures["lights"] = json::array();
  for (const formats::Light& light : f.world.info().lights) figures["lights"].push_back(light.name);
  figures["lights_ms"] = msSince(start);
  auto geometry = uploadGeometry(*f.context, f.scene, weld);
  if (!geometry) return geometry.error();
  f.geometry = std::move(*geometry);
  auto raster = SunRaster::create(*f.context);
  if (!raster) return raster.error();
  f.raster = std::move(*raster);
  const VkExtent2D extent{f.options.width * f.options.samples, f.options.height * f.options.samples};
  auto renderer = Renderer::create(*f.context, f.scene, weld, f.geometry, f.light.sky, extent);
  if (!renderer) return renderer.error();
  f.renderer = std::move(*renderer);

  start = Clock::now();
  f.sun_exposure.resize(f.scene.patches.size());
  if (f.light.sun.shines()) {
    auto seen = f.raster.exposure(f.geometry, f.scene, f.light.sun.to_sun);
    if (!seen) return seen.error();
    f.sun_exposure = std::move(*seen);
  }
  figures["sun_ms"] = msSince(start);
  std::vector<float> areas;
  for (size_t p = 0; p < f.scene.patches.size(); ++p) {
    areas.push_back(f.scene.patches[p].area_m2);
    direct[p] += f.sun_exposure[p] * f.light.sun.irradiance;
  }
  f.direct_on_nodes = runtime::aggregateUp(f.world, areas, direct);
  if (!f.options.compare) return {};
  start = Clock::now();
  f.source = patchSource(f.scene, f.sun_exposure, f.light.sun, f.light.sky);
  auto full = runtime::solveFullWorld(f.world, f.source, {.tolerance = 1e-7, .max_iterations = 2000, .threads = 0});
  if (!full) return full.error();
  f.full = std::move(full->radiosity);
  figures["full_solve_ms"] = msSince(start);
  figures["full_solve_iterations"] = full->iterations;
  return {};
}

}  // namespace

Result<json> run(const RunOptions& options, const std::function<void(const std::string&)>& say) {
  auto world = formats::WholeWorld::open(options.world);
  if (!world) return world.error();
  auto context = runtime::openVulkan(options.device);
  if (!context) return context.error();
  const std::string device = runtime::deviceName(**context);
  say("device: " + device);
  if (world->info().preview) say("a preview (ffbake --preview): few large patches, few rays");
  std::error_code failed;
  std::filesystem::create_directories(options.out_folder, failed);
  if (failed) return Error{ErrorCode::kIo, options.out_folder, "", "cannot be made: " + failed.message(), ""};

  json figures = {{"world", std::filesystem::path(options.world).filename().string()}, {"device", device}};
  {
    Flight f{options, *world, *context, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, {}, 0, std::filesystem::path(options.world).stem().string(), 0, 0};
    if (auto r = prepare(f, figures, say); !r) return r.error();
    auto settings = cutSettings(*world, options.solver, {options.radius_m, options.max_patches});
    if (!settings) return settings.error();
    f.radius_m = settings->radius_m;
    auto streamer = stream::Streamer::create(*world, *settings);
    if (!streamer) return streamer.error();
    (*streamer)->update(f.camera.at(f.camera.start()).eye, {});
    if (auto settled = (*streamer)->settle(); !settled) return settled.error();
    auto solver = makeSolver(*world, **streamer, *context, options.solver);
    if (!solver) return solver.error();
    runtime::Updater updater(*world, **streamer, **solver);
    if (auto taken = updater.setSky(f.light.sky); !taken) return taken.error();
    updater.setDirectLight([&](formats::TileId id, std::span<Vec3> out) {
      const auto values = f.direct_on_nodes.tile(*world, id);
      std::copy(values.begin(), values.end(), out.begin());
    });
    figures["solver"] = (*solver)->name();
    say(std::string("solver: ") + (*solver)->name());
    figures["radius_m"] = f.radius_m;
    figures["frames"] = json::array();
    for (int i = 0; i < options.frames; ++i) {
      const double along = options.frames > 1 ? static_cast<double>(i) / (options.frames - 1) : 0;
      const double t = f.camera.start() + along * (f.camera.end() - f.camera.start());
      auto frame = flyFrame(f, **streamer, updater, i, t);
      if (!frame) return frame.error();
      say("frame " + std::to_string(i) + ": " + frame->dump());
      figures["frames"].push_back(std::move(*frame));
    }
  }
  if (auto r = refuseMessages(**context); !r) return r.error();
  if (auto r = writeFigures(figures, (std::filesystem::path(options.out_folder) / "figures.json").string()); !r) return r.error();
  return figures;
}

std::string warningOf(const json& figures) {
  if (figures["dark"]) return "nothing shines, and the pictures are black: there is no sun, no sky, no lamp in the world and no light in its file; leave out --night, or name --sun or --sky";
  size_t undone = 0;
  double most = 0;
  for (const json& frame : figures["frames"]) {
    if (frame["settled"]) continue;
    ++undone;
    most = std::max(most, frame["settle_change"].is_number() ? frame["settle_change"].get<double>() : 1);
  }
  if (undone == 0) return {};
  char change[32];
  std::snprintf(change, sizeof(change), "%.2g", most);
  return "light has not settled in " + std::to_string(undone) + " of " + std::to_string(figures["frames"].size()) +
         " pictures: the last iteration still changed it by up to " + change +
         " of the largest radiosity; raise --settle";
}

}  // namespace ff::view
