// ffimport_check FILE: imports one glTF file and prints what came out as one JSON line. Exit codes 0 and 1..3 as every
// tool's; an invariant that the importer broke (an index out of range, a coordinate that is not finite) ends in
// abort().
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "bake/import/gltf_import.h"
#include "formats/version.h"
#include "tools/run_tool.h"

namespace {

using ff::Vec3;

// What scene.h promises; returns the bounds.
ff::Box checkScene(const ff::bake::Scene& scene) {
  ff::Box bounds;
  for (const Vec3 p : scene.positions)
    FF_CHECK_EQ(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z), true);
  for (const auto* uv : {&scene.uv0, &scene.uv1}) {
    if (!uv->empty()) FF_CHECK_EQ(uv->size(), scene.positions.size());
    for (const ff::bake::Vec2 t : *uv) FF_CHECK_EQ(std::isfinite(t.x) && std::isfinite(t.y), true);
  }
  if (!scene.colors.empty()) FF_CHECK_EQ(scene.colors.size(), scene.positions.size());
  for (const ff::bake::Rgba& c : scene.colors)
    for (const float x : {c.r, c.g, c.b, c.a}) FF_CHECK_EQ(x >= 0 && x <= 1, true);
  for (const auto& triangle : scene.triangles) {
    for (const uint32_t v : triangle.v) {
      FF_CHECK_LT(v, scene.positions.size());
      bounds.add(scene.positions[v]);
    }
    FF_CHECK_LT(triangle.material, scene.materials.size());
  }
  for (const auto& material : scene.materials)
    for (const uint32_t image : {material.base_image, material.emission_image})
      if (image != ff::bake::kNone) FF_CHECK_LT(image, scene.images.size());
  return bounds;
}

std::string hex(const std::array<uint8_t, 16>& bytes) {
  std::string out;
  for (const uint8_t b : bytes) {
    char text[3];
    std::snprintf(text, sizeof text, "%02x", b);
    out += text;
  }
  return out;
}

int run(int argc, char** argv) {
  CLI::App app{"Imports one glTF file as ffbake does and prints what came out as one JSON line.", "ffimport_check"};
  std::string file;
  app.add_option("file", file, ".gltf or .glb")->required();
  app.set_version_flag("--version", std::string(FF_VERSION));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 1;
  }
  const auto scene = ff::bake::importGltf(file);
  if (!scene) {
    std::cerr << "ffimport_check: " << scene.error().line() << '\n';
    return static_cast<int>(scene.error().code);
  }
  const ff::Box bounds = checkScene(*scene);
  nlohmann::json out = {{"file", file},
                        {"triangles", scene->triangles.size()},
                        {"vertices", scene->positions.size()},
                        {"materials", scene->materials.size()},
                        {"images", scene->images.size()},
                        {"hash", hex(scene->content_hash)},
                        {"warnings", scene->warnings}};
  if (!bounds.empty())
    out["extent_m"] = {bounds.hi.x - bounds.lo.x, bounds.hi.y - bounds.lo.y, bounds.hi.z - bounds.lo.z};
  std::cout << out.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << '\n';
  return 0;
}

}  // namespace

int main(int argc, char** argv) { return ff::tools::runTool("ffimport_check", argc, argv, run); }
