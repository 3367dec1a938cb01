#include "bake/import/lights.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace ff::bake::gltf {
namespace {

constexpr double kLargestIntensity = 1e20;  // keeps products within float
constexpr double kFarthest = 1e9;
constexpr double kLeastPenumbra = 1e-4;  // rad, between the inner and the outer angle of a spot

// Nothing: a kind that is not known.
std::optional<formats::Light> readLight(const Item& item, std::vector<std::string>& warnings) {
  const auto clamped = [&](double value, double lo, double hi, const char* key) {
    if (!(value >= lo && value <= hi)) warnings.push_back(item.place() + ": " + key + " is out of range and clamped");
    return std::clamp(value, lo, hi);
  };
  formats::Light light;
  light.name = item.text("name");
  const std::string type = item.text("type");
  if (type == "directional")
    light.kind = formats::Light::kDirectional;
  else if (type == "point")
    light.kind = formats::Light::kPoint;
  else if (type == "spot")
    light.kind = formats::Light::kSpot;
  else
    return {};
  std::vector<double> color = item.numbers("color", 3);
  if (color.empty()) color.assign(3, 1.0);
  const double intensity = clamped(item.number("intensity").value_or(1), 0, kLargestIntensity, "intensity");
  for (size_t c = 0; c < 3; ++c)
    light.color_intensity[static_cast<int>(c)] =
        static_cast<float>(clamped(color[c] * intensity, 0, kLargestIntensity, "color"));
  if (light.kind == formats::Light::kDirectional) return light;
  light.range_m = static_cast<float>(clamped(item.number("range").value_or(0), 0, kFarthest, "range"));
  if (light.kind == formats::Light::kPoint) return light;
  double inner = 0, outer = std::numbers::pi / 4;
  if (const auto spot = item.object("spot")) {
    inner = spot->number("innerConeAngle").value_or(inner);
    outer = spot->number("outerConeAngle").value_or(outer);
  }
  outer = clamped(outer, kLeastPenumbra, std::numbers::pi / 2, "outerConeAngle");
  inner = clamped(inner, 0, outer, "innerConeAngle");
  light.outer_angle = static_cast<float>(outer);
  light.inner_angle = std::min(static_cast<float>(std::min(inner, outer - kLeastPenumbra)), light.outer_angle);
  return light;
}

}  // namespace

Lights readLights(const Item& file, std::vector<std::string>& warnings) {
  Lights out;
  std::vector<std::optional<formats::Light>> lights;
  std::vector<std::string> types;
  if (const auto punctual = file.extension("KHR_lights_punctual"))
    for (const Item& item : punctual->items("lights", "light")) {
      lights.push_back(readLight(item, warnings));
      types.push_back(printable(item.text("type")));
    }
  const auto leave = [&](const std::string& line) {
    if (std::find(out.left_alone.begin(), out.left_alone.end(), line) == out.left_alone.end()) out.left_alone.push_back(line);
  };
  const auto nodes = file.items("nodes", "node");
  for (uint32_t n = 0; n < nodes.size(); ++n) {
    if (nodes[n].extension("EXT_lights_ies")) leave("EXT_lights_ies: lights with measured profiles are left out");
    const auto extension = nodes[n].extension("KHR_lights_punctual");
    if (!extension) continue;
    const auto number = extension->reference("light", lights.size(), "light");
    if (!number) continue;
    if (!lights[*number]) {
      leave("KHR_lights_punctual: lights of kind \"" + types[*number] + "\" are left out");
      continue;
    }
    formats::Light light = *lights[*number];
    if (const std::string name = nodes[n].text("name"); !name.empty()) light.name = name;
    if (light.name.empty()) light.name = "light " + std::to_string(*number);
    out.of_node[n] = std::move(light);
  }
  for (const Item& scene : file.items("scenes", "scene"))
    if (scene.extension("EXT_lights_image_based"))
      leave("EXT_lights_image_based: the surroundings' picture is left out; light is given at run time");
  return out;
}

std::optional<formats::Light> placed(formats::Light light, const std::array<double, 16>& m, const std::string& place,
                                     std::vector<std::string>& warnings) {
  if (light.kind != formats::Light::kDirectional)
    for (int a = 0; a < 3; ++a) {
      const double x = m[static_cast<size_t>(12 + a)];
      if (!(std::fabs(x) <= kFarthest)) refuse(place, "its light is beyond 1e9 m", "scale the scene to metres");
      light.position[a] = static_cast<float>(x);
    }
  if (light.kind == formats::Light::kPoint) return light;
  const double l = std::sqrt(m[8] * m[8] + m[9] * m[9] + m[10] * m[10]);
  if (!(l > 0) || !std::isfinite(l)) {
    warnings.push_back(place + ": its light has no direction, for the node has a scale of 0; it is left out");
    return {};
  }
  for (int a = 0; a < 3; ++a) light.direction[a] = static_cast<float>(-m[static_cast<size_t>(8 + a)] / l);
  return light;
}

}  // namespace ff::bake::gltf
