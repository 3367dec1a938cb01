#include <algorithm>
#include <cmath>

#include "bake/gltf_reduce.h"

namespace ff::bake::gltf {
namespace {

constexpr uint64_t kMaterialBytes = 6000;  // reduced and as tinygltf's structures: measured with 50,000
constexpr uint64_t kMostTexCoords = 64;
constexpr double kLargestEmission = 1e20;  // keeps products with areas within float

class Warner {
 public:
  explicit Warner(std::vector<std::string>& warnings) : warnings_(warnings) {}
  double clamped(double value, double lo, double hi, const Item& item, const char* key) {
    if (value >= lo && value <= hi) return value;
    char text[64];
    std::snprintf(text, sizeof text, " %g is clamped to %g..%g", value, lo, hi);
    warnings_.push_back(item.place() + ": " + key + text);
    return std::clamp(value, lo, hi);
  }
  void say(const std::string& text) { warnings_.push_back(text); }
  void sayOnce(bool& said, const std::string& text) {
    if (!said) say(text);
    said = true;
  }

 private:
  std::vector<std::string>& warnings_;
};

// A textureInfo with its KHR_texture_transform folded: `texCoord` is the set that counts.
std::optional<Json> texture(const Item& owner, const char* key, size_t texture_count) {
  const auto info = owner.object(key);
  if (!info) return {};
  const auto index = info->reference("index", texture_count, "texture");
  if (!index) refuse(info->place(), "index is missing");
  uint64_t set = info->integer("texCoord").value_or(0);
  Json out = {{"index", *index}};
  if (const auto transform = info->extension("KHR_texture_transform")) {
    Json t = Json::object();
    for (const char* pair : {"offset", "scale"})
      if (const auto v = transform->numbers(pair, 2); !v.empty()) t[pair] = v;
    if (const auto r = transform->number("rotation")) t["rotation"] = *r;
    set = transform->integer("texCoord").value_or(set);
    out["extensions"]["KHR_texture_transform"] = std::move(t);
  }
  if (set >= kMostTexCoords) refuse(info->place(), "texCoord " + std::to_string(set) + " is too large");
  out["texCoord"] = set;
  return out;
}

std::vector<double> factor(const Item& item, const char* key, size_t count, double hi, Warner& warn) {
  std::vector<double> v = item.numbers(key, count);
  if (v.empty()) v.assign(count, 1.0);
  for (double& x : v) x = warn.clamped(x, 0, hi, item, key);
  return v;
}

}  // namespace

Json reduceMaterials(const Item& file, size_t texture_count, Budget& budget, std::vector<std::string>& warnings) {
  Warner warn(warnings);
  bool blend_said = false, transmission_said = false;
  Json out = Json::array();
  for (const Item& item : file.items("materials", "material")) {
    budget.take(kMaterialBytes, item.place());
    Json pbr = {{"metallicFactor", 1.0}};
    std::vector<double> base(4, 1.0);
    std::optional<Json> base_texture;
    const auto metal_rough = item.object("pbrMetallicRoughness");
    if (const auto gloss = item.extension("KHR_materials_pbrSpecularGlossiness")) {
      base = factor(*gloss, "diffuseFactor", 4, 1, warn);
      base_texture = texture(*gloss, "diffuseTexture", texture_count);
      pbr["metallicFactor"] = 0.0;
    } else if (metal_rough) {
      base = factor(*metal_rough, "baseColorFactor", 4, 1, warn);
      base_texture = texture(*metal_rough, "baseColorTexture", texture_count);
      pbr["metallicFactor"] =
          warn.clamped(metal_rough->number("metallicFactor").value_or(1), 0, 1, *metal_rough, "metallicFactor");
      if (auto t = texture(*metal_rough, "metallicRoughnessTexture", texture_count))
        pbr["metallicRoughnessTexture"] = std::move(*t);
    }
    std::string mode = item.has("alphaMode") ? item.text("alphaMode") : "OPAQUE";
    if (mode != "OPAQUE" && mode != "MASK" && mode != "BLEND")
      refuse(item.place(), "alphaMode \"" + printable(mode) + "\" is unknown");
    double cutoff = item.number("alphaCutoff").value_or(0.5);
    if (cutoff < 0) refuse(item.place(), "alphaCutoff is negative");
    if (mode == "BLEND") {
      warn.sayOnce(blend_said, "alphaMode BLEND is taken as a cutout at alpha 0.5 (first: " + item.place() + ")");
      mode = "MASK";
      cutoff = 0.5;
    }
    if (const auto transmission = item.extension("KHR_materials_transmission")) {
      const double t = warn.clamped(transmission->number("transmissionFactor").value_or(0), 0, 1, *transmission,
                                    "transmissionFactor");
      if (t > 0.5) {  // windows: light must pass
        warn.sayOnce(transmission_said,
                     "surfaces that transmit more than half of the light are left out (first: " + item.place() + ")");
        if (mode == "OPAQUE") base[3] = 1, cutoff = 0.5;
        mode = "MASK";
        base[3] *= 1 - t;
        cutoff = std::max(cutoff, 0.5);
      }
    }
    std::vector<double> emission = item.numbers("emissiveFactor", 3);
    if (emission.empty()) emission.assign(3, 0.0);
    double strength = 1;
    if (const auto extension = item.extension("KHR_materials_emissive_strength")) {
      strength = extension->number("emissiveStrength").value_or(1);
      if (strength < 0) refuse(extension->place(), "emissiveStrength is negative");
    }
    // Factors above 1 are out of the specification's range, but older exporters write radiance that way.
    for (double& x : emission) x = warn.clamped(x * strength, 0, kLargestEmission, item, "emission");
    pbr["baseColorFactor"] = base;
    if (base_texture) pbr["baseColorTexture"] = std::move(*base_texture);
    Json reduced = {{"name", item.text("name")},  {"pbrMetallicRoughness", std::move(pbr)},
                    {"emissiveFactor", emission}, {"alphaMode", mode},
                    {"alphaCutoff", cutoff},      {"doubleSided", item.flag("doubleSided")}};
    if (auto t = texture(item, "emissiveTexture", texture_count)) reduced["emissiveTexture"] = std::move(*t);
    out.push_back(std::move(reduced));
  }
  return out;
}

}  // namespace ff::bake::gltf
