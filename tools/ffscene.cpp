// ffscene: writes procedural scenes as binary glTF.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>

#include "formats/version.h"
#include "tools/run_tool.h"
#include "tools/scene/analytic.h"
#include "tools/scene/camera.h"
#include "tools/scene/glb.h"
#include "tools/scene/town.h"

namespace {

using namespace ff;
using namespace ff::tools;
using nlohmann::json;

struct Output {
  std::string path;
  bool draco = false, as_json = false;
};

struct TownArguments {
  std::string patches = "60k", camera;
  TownOptions town;
  double seconds = 24;
  bool merge = false;
};

// "60k", "1.5M", "2000".
Result<uint64_t> parsedCount(const std::string& text) {
  size_t used = 0;
  double value = 0;
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  double unit = 1;
  if (used + 1 == text.size()) unit = text[used] == 'k' || text[used] == 'K' ? 1e3 : text[used] == 'M' ? 1e6 : 0;
  if (used == 0 || used + 1 < text.size() || unit == 0 || !(value > 0) || value * unit > 1e12)
    return Error{ErrorCode::kUsage, "", "--patches", "\"" + text + "\" is not a number of patches", "write 60000, 60k or 1.5M"};
  return static_cast<uint64_t>(value * unit + 0.5);
}

json boundsOf(const SceneModel& model) {
  Box box;
  for (const SceneNode& node : model.nodes)
    for (const ScenePart& part : node.parts)
      for (Vec3 p : part.positions) box.add(p * model.scale);
  return {{"min", {box.lo.x, box.lo.y, box.lo.z}}, {"max", {box.hi.x, box.hi.y, box.hi.z}}};
}

uint64_t trianglesOf(const SceneModel& model) {
  uint64_t n = 0;
  for (const SceneNode& node : model.nodes)
    for (const ScenePart& part : node.parts) n += part.indices.size() / 3;
  return n;
}

int fail(const Error& error) {
  std::fprintf(stderr, "ffscene: %s\n", error.line().c_str());
  return static_cast<int>(error.code);
}

int finish(const SceneModel& model, const Output& output, json facts) {
  if (const auto written = writeGlb(model, output.path, {output.draco}); !written) return fail(written.error());
  facts["file"] = output.path;
  facts["triangles"] = trianglesOf(model);
  facts["bounds_m"] = boundsOf(model);
  if (output.as_json) {
    std::printf("%s\n", facts.dump().c_str());
  } else {
    for (const auto& [key, value] : facts.items())
      std::printf("%-10s %s\n", key.c_str(), value.is_string() ? value.get<std::string>().c_str() : value.dump().c_str());
  }
  return 0;
}

int runTown(const TownArguments& arguments, const Output& output) {
  TownOptions options = arguments.town;
  const auto patches = parsedCount(arguments.patches);
  if (!patches) return fail(patches.error());
  options.patches = *patches;
  const auto town = makeTown(options);
  if (!town) return fail(town.error());
  json facts = {{"faces", town->faces}, {"lamps", town->lamps}, {"seed", options.seed}};
  const auto path = flyThrough(*town, arguments.seconds);
  if (path) {
    const CameraKey& k = path->keys.front();
    facts["camera"] = {{"eye", {k.eye.x, k.eye.y, k.eye.z}}, {"target", {k.target.x, k.target.y, k.target.z}}};
  }
  if (!arguments.camera.empty()) {
    if (!path) return fail(path.error());
    std::ofstream out(arguments.camera, std::ios::trunc);
    out << cameraJson(*path);
    out.close();
    if (!out)
      return fail({ErrorCode::kIo, arguments.camera, "", "cannot write the file", "check the folder and the free space"});
  }
  return finish(townModel(*town, arguments.merge), output, facts);
}

CLI::App* command(CLI::App& app, const char* name, const char* about, Output& output) {
  CLI::App* c = app.add_subcommand(name, about);
  c->add_option("-o,--output", output.path, "file to write (.glb)")->required();
  c->add_flag("--draco", output.draco, "compress with KHR_draco_mesh_compression, without loss");
  c->add_flag("--json", output.as_json, "print what was made as JSON");
  return c;
}

int run(int argc, char** argv) {
  CLI::App app{"Writes procedural scenes as binary glTF 2.0.", "ffscene"};
  app.set_version_flag("--version", "ffscene " FF_VERSION);
  app.require_subcommand(1);
  Output output;
  TownArguments town;
  std::function<int()> run;

  CLI::App* c = command(app, "town", "a voxel town with streets, rooms and lamps", output);
  c->add_option("--patches", town.patches, "exposed unit faces wanted, within 5 %: 60000, 60k, 1.5M")->capture_default_str();
  c->add_option("--seed", town.town.seed, "another town for each number")->capture_default_str();
  c->add_option("--cell", town.town.cell_m, "edge of a voxel, metres")->check(CLI::Range(0.001f, 1000.0f))->capture_default_str();
  c->add_flag("--merge", town.merge, "join coplanar faces to rectangles (fewer triangles, T-junctions)");
  c->add_option("--camera", town.camera, "also write a camera path (JSON)");
  c->add_option("--seconds", town.seconds, "length of the camera path")->check(CLI::Range(1.0, 3600.0))->capture_default_str();
  c->callback([&] { run = [&] { return runTown(town, output); }; });

  float albedo = 0.5f, emission = 1, gap = 1, half_angle = 60, wall = 0.1f;
  int segments = 256;
  std::string layout = "parallel";
  const auto analytic = [&](const char* name, const char* about, std::function<SceneModel()> make) {
    CLI::App* a = command(app, name, about, output);
    a->add_option("--albedo", albedo, "diffuse reflectance")->check(CLI::Range(0.0f, 1.0f))->capture_default_str();
    a->add_option("--emission", emission, "emitted radiosity M, W/m2 (radiance M / pi)")->check(CLI::Range(0.0f, 1e6f))->capture_default_str();
    a->callback([&run, &output, make] { run = [&output, make] { return finish(make(), output, json::object()); }; });
    return a;
  };
  analytic("box", "a closed box that shines inside (furnace)", [&] { return furnaceBox(albedo, emission); });
  c = analytic("plates", "two unit squares that face each other", [&] {
    return layout == "parallel" ? parallelPlates(gap, albedo, emission) : perpendicularPlates(albedo, emission);
  });
  c->add_option("--gap", gap, "distance of parallel plates, metres")->check(CLI::Range(1e-3f, 1e3f))->capture_default_str();
  c->add_option("--layout", layout, "parallel or perpendicular")->check(CLI::IsMember({"parallel", "perpendicular"}))->capture_default_str();
  c = analytic("discs", "two coaxial discs of radius 1", [&] { return coaxialDiscs(gap, segments, albedo, emission); });
  c->add_option("--gap", gap, "distance, metres")->check(CLI::Range(1e-3f, 1e3f))->capture_default_str();
  c->add_option("--segments", segments, "corners")->check(CLI::Range(3, 100'000))->capture_default_str();
  c = analytic("cap", "a cap of the unit sphere, seen from inside", [&] { return sphericalCap(half_angle, segments, albedo, emission); });
  c->add_option("--half-angle", half_angle, "degrees")->check(CLI::Range(1.0f, 179.0f))->capture_default_str();
  c->add_option("--segments", segments, "corners of a ring")->check(CLI::Range(3, 4096))->capture_default_str();
  c = analytic("two-rooms", "two closed rooms, one lit (leak test)", [&] { return twoRooms(wall, albedo, emission); });
  c->add_option("--wall", wall, "thickness of the wall between, metres")->check(CLI::Range(1e-3f, 10.0f))->capture_default_str();
  analytic("corridor", "a closed corridor lit at one end", [&] { return corridor(albedo, emission); });

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : static_cast<int>(ErrorCode::kUsage);
  }
  return run();
}

}  // namespace

int main(int argc, char** argv) { return ff::tools::runTool("ffscene", argc, argv, run); }
