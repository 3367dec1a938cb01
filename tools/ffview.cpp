// ffview: flies through a world and draws it with its streamed light.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>

#include "formats/storage/storage.h"
#include "formats/version.h"
#include "tools/run_tool.h"
#include "tools/view/run.h"

namespace {

using namespace ff;

struct Texts {
  std::string size = "1280x720", exposure = "auto", sun, sun_irradiance, sky, solver = "auto", device = "auto";
};

Error usage(const std::string& option, const std::string& message, const std::string& remedy) {
  return {ErrorCode::kUsage, "", option, message, remedy};
}

// "1,2.5,3": finite numbers; empty: not that.
std::vector<float> numbers(const std::string& text) {
  std::vector<float> out;
  for (size_t at = 0; at <= text.size();) {
    const size_t comma = std::min(text.find(',', at), text.size());
    size_t used = 0;
    float x = 0;
    try {
      x = std::stof(text.substr(at, comma - at), &used);
    } catch (const std::exception&) {
      return {};
    }
    if (used != comma - at || !std::isfinite(x)) return {};
    out.push_back(x);
    at = comma + 1;
  }
  return out;
}

Result<void> parseLight(const Texts& texts, view::RunOptions& o) {
  view::Sun sun{normalized({0.512f, 0.768f, 0.384f}), {13.0f, 11.8f, 9.6f}};
  if (!texts.sun.empty()) {
    const auto n = numbers(texts.sun);
    if (n.size() == 2) {
      constexpr float kDegree = 3.14159265f / 180;
      const float azimuth = n[0] * kDegree, elevation = n[1] * kDegree;
      sun.to_sun = {std::cos(elevation) * std::cos(azimuth), std::sin(elevation), std::cos(elevation) * std::sin(azimuth)};
    } else if (n.size() == 3 && length({n[0], n[1], n[2]}) > 0) {
      sun.to_sun = normalized({n[0], n[1], n[2]});
    } else {
      return usage("--sun", "'" + texts.sun + "' is no direction", "write azimuth,elevation in degrees or x,y,z");
    }
  }
  if (!texts.sun_irradiance.empty()) {
    const auto n = numbers(texts.sun_irradiance);
    if (n.size() != 3 || n[0] < 0 || n[1] < 0 || n[2] < 0)
      return usage("--sun-irradiance", "'" + texts.sun_irradiance + "' is no colour", "write r,g,b in W/m2");
    sun.irradiance = {n[0], n[1], n[2]};
  }
  if (!texts.sun.empty() || !texts.sun_irradiance.empty()) o.sun = sun;
  if (!texts.sky.empty()) {
    const auto n = numbers(texts.sky);
    if (n.size() != 3 && n.size() != 6)
      return usage("--sky", "'" + texts.sky + "' is no sky", "write r,g,b of its radiance, and r,g,b more at the zenith");
    o.sky = view::skyOf({n[0], n[1], n[2]}, n.size() == 6 ? Vec3{n[3], n[4], n[5]} : Vec3{});
  }
  return {};
}

Result<void> parse(const Texts& texts, view::RunOptions& o) {
  unsigned width = 0, height = 0;
  char rest = 0;
  if (std::sscanf(texts.size.c_str(), "%ux%u%c", &width, &height, &rest) != 2 || width < 16 || height < 16 ||
      width > 8192 || height > 8192)
    return usage("--size", "'" + texts.size + "' is no size from 16x16 to 8192x8192", "write 1280x720");
  o.width = width;
  o.height = height;
  if (texts.exposure != "auto") {
    const auto n = numbers(texts.exposure);
    if (n.size() != 1) return usage("--exposure", "'" + texts.exposure + "' is no number", "write auto or stops, such as -2.5");
    o.exposure_stops = n[0];
  }
  if (texts.solver != "auto" && texts.solver != "gather" && texts.solver != "multibounce")
    return usage("--solver", "'" + texts.solver + "' is not known", "write auto, gather or multibounce");
  o.solver.kind = texts.solver;
  o.device.device = texts.device;
  return parseLight(texts, o);
}

int run(int argc, char** argv) {
  CLI::App app{"Flies through a world and draws its patches with their streamed radiosity."};
  app.set_version_flag("--version", std::string("ffview ") + FF_VERSION);
  view::RunOptions o;
  Texts texts;
  bool headless = false, as_json = false, no_difference = false;
  app.add_option("world", o.world, "the world's manifest, NAME.ffm, or its address behind a web server, https://.../NAME.ffm")->required();
  app.add_flag("--headless", headless, "draw to files (the only way so far)");
  app.add_option("-o,--out", o.out_folder, "folder for pictures and figures.json")->required();
  app.add_option("--camera", o.camera, "camera path (JSON); without it one is found");
  app.add_option("--size", texts.size, "of the pictures")->capture_default_str();
  app.add_option("--frames", o.frames, "pictures, evenly over the path")->check(CLI::Range(1, 100000))->capture_default_str();
  app.add_option("--device", texts.device, "auto, cpu, or part of a name")->capture_default_str();
  app.add_option("--solver", texts.solver, "auto, gather (open worlds) or multibounce (closed spaces)")->capture_default_str();
  app.add_flag("--solve-on-cpu", o.solver.on_cpu, "natively instead of on the Vulkan device: faster than lavapipe");
  app.add_option("--radius", o.radius_m,
                 "m around the eye with light patch by patch; default: as recommended beside the world, else 24 cells")
      ->check(CLI::PositiveNumber);
  app.add_option("--max-patches", o.max_patches,
                 "of the finest level, active at once; default: as recommended beside the world, else all");
  app.add_option("--iterations", o.iterations, "of the solver per frame")->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--settle", o.settle,
                 "more of them, at most, before a picture, until light stands still: white rooms take some hundred")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  app.add_option("--exposure", texts.exposure, "auto, or stops on radiosity in W/m2")->capture_default_str();
  app.add_option("--samples", o.samples, "per pixel and axis")->check(CLI::Range(1, 4))->capture_default_str();
  app.add_option("--sun", texts.sun, "towards the sun: azimuth,elevation (degrees) or x,y,z");
  app.add_option("--sun-irradiance", texts.sun_irradiance, "r,g,b, W/m2 on a surface that faces it");
  app.add_option("--sky", texts.sky, "r,g,b of its radiance, W/(m2 sr); three more: added towards the zenith");
  app.add_option("--lights", o.lights, "factor on the lights of the scene's file, 0: without them")
      ->check(CLI::Range(0.0, 1e9))
      ->capture_default_str();
  app.add_flag("--lamps-only,--night", o.lamps_only, "neither sun nor sky");
  app.add_flag("--no-difference", no_difference, "no full-world solve to compare with");
  app.add_flag("--validate", o.device.validate, "run under the Vulkan validation layers; any message is an error");
  app.add_flag("--json", as_json, "print the figures as JSON");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    const int code = app.exit(e);
    return code == 0 ? 0 : static_cast<int>(ErrorCode::kUsage);
  }
  o.compare = !no_difference;
  const auto fail = [](const Error& e) {
    std::fprintf(stderr, "ffview: %s\n", e.line().c_str());
    return static_cast<int>(e.code);
  };
  if (!headless)
    return fail(usage("--headless", "there is no window yet", "add --headless"));
  if (auto parsed = parse(texts, o); !parsed) return fail(parsed.error());
  auto figures = view::run(o, [&](const std::string& line) {
    if (!as_json) std::printf("%s\n", line.c_str());
  });
  if (!figures) return fail(figures.error());
  if (as_json) std::printf("%s\n", figures->dump(1).c_str());
  for (const std::string& warning : {view::warningOf(*figures), formats::storageFor(o.world)->warning()})
    if (!warning.empty()) std::fprintf(stderr, "ffview: %s\n", warning.c_str());
  return 0;
}

}  // namespace

int main(int argc, char** argv) { return ff::tools::runTool("ffview", argc, argv, run); }
