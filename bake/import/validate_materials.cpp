#include <algorithm>
#include <cmath>
#include <numbers>

#include "bake/import/validate.h"
#include "formats/model.h"

namespace ff::bake::gltf {
namespace {

constexpr uint64_t kMaterialBytes = 6000;  // validated and as tinygltf's structures: measured with 50,000
constexpr uint64_t kMaxTexCoords = 64;
constexpr double kLargestEmission = 3e11;  // W/(m2 sr)
static_assert(kLargestEmission * std::numbers::pi < static_cast<double>(formats::kMaxEmission));

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
  if (set >= kMaxTexCoords) refuse(info->place(), "texCoord " + std::to_string(set) + " is too large");
  out["texCoord"] = set;
  return out;
}

std::vector<double> factor(const Item& item, const char* key, size_t count, double hi, Warner& warn) {
  std::vector<double> v = item.numbers(key, count);
  if (v.empty()) v.assign(count, 1.0);
  for (double& x : v) x = warn.clamped(x, 0, hi, item, key);
  return v;
}

int textureIndex(const Item& owner, const char* key, size_t texture_count) {
  const auto info = texture(owner, key, texture_count);
  return info ? (*info)["index"].get<int>() : -1;
}

// Extensions that change what is reflected, and are not modelled: named if they are switched on.
struct Unmodelled {
  const char* extension;
  const char* factor;  // a number or numbers
  double neutral;      // the value that changes nothing; also the default unless `on_by_default`
  bool on_by_default;
  const char* what;
};
constexpr Unmodelled kUnmodelled[] = {
    {"KHR_materials_clearcoat", "clearcoatFactor", 0, false, "the coat's reflection is left out"},
    {"KHR_materials_sheen", "sheenColorFactor", 0, false, "the sheen's reflection is left out"},
    {"KHR_materials_iridescence", "iridescenceFactor", 0, false, "colours of thin films are left out"},
    {"KHR_materials_anisotropy", "anisotropyStrength", 0, false, "its reflection is the same all around"},
    {"KHR_materials_specular", "specularFactor", 1, false, "reflects as any dielectric"},
    {"KHR_materials_specular", "specularColorFactor", 1, false, "reflects as any dielectric"},
    {"KHR_materials_ior", "ior", 1.5, false, "reflects as any dielectric"},
    {"KHR_materials_volume", "thicknessFactor", 0, false, "neither absorbs nor refracts within"},
    {"KHR_materials_subsurface", "subsurfaceFactor", 0, true, "light does not wander below the surface"},
    {"KHR_materials_volume_scatter", "multiscatterColor", 0, true, "light does not scatter within"},
    {"KHR_materials_dispersion", "dispersion", 0, false, "light is not split into colours"}};
// Read elsewhere, or without effect on diffuse light.
constexpr const char* kModelled[] = {"KHR_materials_pbrSpecularGlossiness", "KHR_materials_emissive_strength",
                                     "KHR_materials_transmission", "KHR_materials_diffuse_transmission",
                                     "KHR_materials_unlit"};

std::vector<std::string> leftAlone(const Item& item, const MaterialFacts& facts) {
  std::vector<std::string> out;
  const auto add = [&](std::string line) {
    if (std::find(out.begin(), out.end(), line) == out.end()) out.push_back(std::move(line));
  };
  for (const Unmodelled& u : kUnmodelled) {
    const auto extension = item.extension(u.extension);
    if (!extension) continue;
    bool on = u.on_by_default && !extension->has(u.factor);
    if (extension->has(u.factor)) {
      const Json& value = extension->json()[u.factor];
      for (const Json& v : value.is_array() ? value : Json::array({value}))
        on = on || (v.is_number() && v.get<double>() != u.neutral);
    }
    if (on) add(std::string(u.extension) + ": " + u.what);
  }
  if (facts.diffuse_transmission > 0)
    add("KHR_materials_diffuse_transmission: light goes straight on behind the surface, not in all directions");
  if (item.extension("KHR_materials_pbrSpecularGlossiness") && facts.specular.empty())
    add("KHR_materials_pbrSpecularGlossiness: without a specular colour reflects as any dielectric");
  if (item.extension("KHR_materials_unlit"))
    add("KHR_materials_unlit: reflects its colour as other surfaces do, and emits nothing");
  if (item.has("extensions") && item.json()["extensions"].is_object())
    for (const auto& [name, unused] : item.json()["extensions"].items()) {
      const bool known = std::any_of(std::begin(kUnmodelled), std::end(kUnmodelled), [&, &n = name](const Unmodelled& u) { return n == u.extension; }) ||
                         std::find(std::begin(kModelled), std::end(kModelled), name) != std::end(kModelled);
      if (!known && name.find("_materials_") != std::string::npos) add(printable(name) + ": is not known");
    }
  return out;
}

// The whole of a material's extensions that let light through, or reflect it otherwise than metallic-roughness.
MaterialFacts readFacts(const Item& item, size_t texture_count, Warner& warn) {
  MaterialFacts f;
  const auto share = [&](const Item& extension, const char* key) {
    return warn.clamped(extension.number(key).value_or(0), 0, 1, extension, key);
  };
  if (const auto transmission = item.extension("KHR_materials_transmission")) {
    f.transmission = share(*transmission, "transmissionFactor");
    f.transmission_texture = textureIndex(*transmission, "transmissionTexture", texture_count);
  }
  if (const auto diffuse = item.extension("KHR_materials_diffuse_transmission")) {
    f.diffuse_transmission = share(*diffuse, "diffuseTransmissionFactor");
    f.diffuse_transmission_texture = textureIndex(*diffuse, "diffuseTransmissionTexture", texture_count);
    f.diffuse_transmission_color = factor(*diffuse, "diffuseTransmissionColorFactor", 3, 1, warn);
    f.diffuse_transmission_color_texture = textureIndex(*diffuse, "diffuseTransmissionColorTexture", texture_count);
  }
  if (const auto gloss = item.extension("KHR_materials_pbrSpecularGlossiness")) {
    f.specular_texture = textureIndex(*gloss, "specularGlossinessTexture", texture_count);
    // The default is a perfect mirror, which exporters that say nothing do not mean.
    if (gloss->has("specularFactor") || f.specular_texture >= 0) f.specular = factor(*gloss, "specularFactor", 3, 1, warn);
  }
  f.left_alone = leftAlone(item, f);
  return f;
}

}  // namespace

Json validateMaterials(const Item& file, size_t texture_count, Budget& budget, std::vector<MaterialFacts>& facts,
                       std::vector<std::string>& warnings) {
  Warner warn(warnings);
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
    facts.push_back(readFacts(item, texture_count, warn));
    facts.back().blend = mode == "BLEND";
    if (item.extension("KHR_materials_unlit")) pbr["metallicFactor"] = 0.0;
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
    Json validated = {{"name", item.text("name")},  {"pbrMetallicRoughness", std::move(pbr)},
                    {"emissiveFactor", emission}, {"alphaMode", mode},
                    {"alphaCutoff", cutoff},      {"doubleSided", item.flag("doubleSided")}};
    if (auto t = texture(item, "emissiveTexture", texture_count)) validated["emissiveTexture"] = std::move(*t);
    out.push_back(std::move(validated));
  }
  return out;
}

}  // namespace ff::bake::gltf
