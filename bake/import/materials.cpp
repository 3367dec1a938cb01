#include "bake/import/materials.h"

#include <algorithm>
#include <cmath>

#include "formats/portable_math.h"

namespace ff::bake::gltf {
namespace {

// glTF's own default is a white metal, which has no diffuse reflection at all; untextured grey serves a radiosity
// baker.
constexpr float kDefaultAlbedo = 0.8f;
// Where a picture cannot be read: a linear value that no furnace is made of.
constexpr float kStandIn = 0.5f;
constexpr double kDielectric = 0.04;  // mirror reflectance that goes without saying: glTF 2.0, appendix B.2.2

Vec3 toVec3(const std::vector<double>& v) {
  return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

}  // namespace

uint32_t Materials::add(Material material, UvSource base, UvSource emission) {
  budget_.take(sizeof(Material) + 2 * sizeof(UvSource) + material.name.size(), "materials");
  scene_.materials.push_back(std::move(material));
  base_.push_back(base);
  emission_.push_back(emission);
  return static_cast<uint32_t>(scene_.materials.size() - 1);
}

bool Materials::repeats(int texture) const {
  const int sampler = document_.model.textures[static_cast<size_t>(texture)].sampler;
  if (sampler < 0) return true;
  const tinygltf::Sampler& s = document_.model.samplers[static_cast<size_t>(sampler)];
  return s.wrapS != TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE || s.wrapT != TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE;
}

UvSource Materials::uvSource(int tex_coord, const tinygltf::ExtensionMap& extensions) const {
  UvSource out;
  out.used = true;
  out.set = tex_coord;
  const auto it = extensions.find("KHR_texture_transform");
  if (it == extensions.end()) return out;
  const tinygltf::Value& t = it->second;
  const auto pair = [&](const char* key, int i, double fallback) {
    return t.Has(key) ? t.Get(key).Get(i).GetNumberAsDouble() : fallback;
  };
  const double angle = t.Has("rotation") ? t.Get("rotation").GetNumberAsDouble() : 0;
  const auto [s, c] = sineCosine(angle);
  const double sx = pair("scale", 0, 1), sy = pair("scale", 1, 1);
  // Counter-clockwise as seen with v pointing down, as KHR_texture_transform's text says and renderers do.
  out.xx = c * sx, out.xy = s * sy, out.x = pair("offset", 0, 0);
  out.yx = -s * sx, out.yy = c * sy, out.y = pair("offset", 1, 0);
  return out;
}

double Materials::scaled(double factor, int texture, size_t channel, const char* what, Material& of) {
  if (texture < 0 || factor == 0) return factor;
  if (const auto means = pictures_.means(texture)) return factor * static_cast<double>(means->stored[channel]);
  of.left_alone.push_back(what);
  return 0;
}

// KHR_materials_pbrSpecularGlossiness: what the mirror takes, the diffuse part lacks. A dielectric's little mirror counts as
// diffuse light, as it does in metallic-roughness.
void Materials::addSpecular(const MaterialFacts& facts, Material& out) {
  if (facts.specular.empty()) return;
  Vec3 mirror = toVec3(facts.specular);
  if (facts.specular_texture >= 0) {
    if (const auto means = pictures_.means(facts.specular_texture))
      mirror = mirror * Vec3{means->linear[0], means->linear[1], means->linear[2]};
    else
      mirror = {}, out.left_alone.push_back("pictures of specular colours that cannot be read: reflects as any dielectric");
  }
  const Vec3 beyond = ff::max(mirror - Vec3{1, 1, 1} * static_cast<float>(kDielectric), {});
  out.specular = beyond / static_cast<float>(1 - kDielectric);
  out.base_color *= 1 - std::max({out.specular.x, out.specular.y, out.specular.z});
}

// A surface that lets light through stops only a share of it; what it reflects of all light it then reflects of that share.
void Materials::addTransmission(const MaterialFacts& facts, int base_texture, Material& out) {
  const char* const unread = "pictures of transmission that cannot be read: nothing passes";
  const double clear = scaled(facts.transmission, facts.transmission_texture, 0, unread, out);
  const double diffuse = scaled(facts.diffuse_transmission, facts.diffuse_transmission_texture, 3, unread, out);
  const double inside = clear + (1 - clear) * diffuse;  // what is not reflected by the base colour
  if (!(inside > 0)) return;
  const auto mean = [](Vec3 v) { return static_cast<double>(v.x + v.y + v.z) / 3; };
  const auto tint = [&](Vec3 color, int texture) {
    const auto means = texture >= 0 ? pictures_.means(texture) : std::nullopt;
    if (texture >= 0)
      color = color * (means ? Vec3{means->linear[0], means->linear[1], means->linear[2]} : Vec3{kStandIn, kStandIn, kStandIn});
    return mean(color);
  };
  const double passes = std::clamp(clear * tint(out.base_color, base_texture) +
                                       (1 - clear) * diffuse *
                                           tint(toVec3(facts.diffuse_transmission_color), facts.diffuse_transmission_color_texture),
                                   0.0, 1.0);
  constexpr double kLeastStopped = 1e-3;  // of the light: less is nothing
  if (!out.cutout) out.alpha_cutoff = 0;  // alphaMode OPAQUE: alpha does not count
  out.cutout = true;
  out.transmission = static_cast<float>(passes > 1 - kLeastStopped ? 1 : passes);
  const double stopped = std::max(1 - passes, kLeastStopped);
  out.base_color *= static_cast<float>(std::min(1.0, (1 - inside) / stopped));
  out.emission *= static_cast<float>(1 / stopped);
}

uint32_t Materials::number(int material) {
  const auto known = numbers_.find(material);
  if (known != numbers_.end()) return known->second;
  Material out;
  UvSource base, emission;
  if (material < 0) {
    scene_.warnings.push_back("surfaces without a material are taken as diffuse, albedo 0.8");
    out.name = "none";
    out.base_color = {kDefaultAlbedo, kDefaultAlbedo, kDefaultAlbedo};
    out.metallic = 0;
  } else {
    const tinygltf::Material& m = document_.model.materials[static_cast<size_t>(material)];
    const tinygltf::PbrMetallicRoughness& pbr = m.pbrMetallicRoughness;
    out.name = m.name;
    out.base_color = toVec3(pbr.baseColorFactor);
    out.alpha = static_cast<float>(pbr.baseColorFactor[3]);
    out.metallic = static_cast<float>(pbr.metallicFactor);
    out.emission = toVec3(m.emissiveFactor);
    out.double_sided = m.doubleSided;
    out.cutout = m.alphaMode == "MASK";
    out.alpha_cutoff = static_cast<float>(m.alphaCutoff);
    out.unlit = document_.objects.unlit[static_cast<size_t>(material)];
    const MaterialFacts& facts = document_.material_facts[static_cast<size_t>(material)];
    out.blend = facts.blend;
    out.cutout = out.cutout || out.blend;
    out.left_alone = facts.left_alone;
    const int base_texture = pbr.baseColorTexture.index, emissive_texture = m.emissiveTexture.index;
    if (base_texture >= 0) {
      base = uvSource(pbr.baseColorTexture.texCoord, pbr.baseColorTexture.extensions);
      out.base_image = pictures_.number(base_texture);
      out.repeat = repeats(base_texture);
      if (out.base_image == kNone) {
        out.base_color *= kStandIn;
        out.left_alone.push_back("pictures of base colours that cannot be read: middle grey (0.5) stands in");
      }
    }
    if (emissive_texture >= 0 && out.emission != Vec3{}) {
      emission = uvSource(m.emissiveTexture.texCoord, m.emissiveTexture.extensions);
      out.emission_image = pictures_.number(emissive_texture);
      if (base_texture < 0) out.repeat = repeats(emissive_texture);
      const auto means = pictures_.means(emissive_texture);
      if (!means) {
        out.emission = {};
        out.left_alone.push_back("pictures of emission that cannot be read: nothing is emitted");
      } else if (means->stored[0] + means->stored[1] + means->stored[2] == 0) {
        out.emission = {};  // all black
      }
    }
    // Metalness varies over the picture's blue channel; the scene has one number, the mean. Factor 1 is how files say
    // "see the picture"; without it most surfaces are no metals, and none should turn black.
    out.metallic = static_cast<float>(
        scaled(static_cast<double>(out.metallic), pbr.metallicRoughnessTexture.index, 2,
               "pictures of metalness that cannot be read: taken as no metal", out));
    addSpecular(facts, out);
    addTransmission(facts, base_texture, out);
  }
  return numbers_[material] = add(std::move(out), base, emission);
}

uint32_t Materials::with(uint32_t number, const Traits& traits) {
  if (!traits.occlude_only && !traits.density && !traits.lamp) return number;
  const Material& plain = scene_.materials[number];
  const std::tuple key(number, traits.occlude_only.value_or(plain.occlude_only), traits.density.value_or(plain.density),
                       traits.lamp.value_or(plain.lamp_group));
  const auto known = variants_.find(key);
  if (known != variants_.end()) return known->second;
  Material out = plain;
  out.occlude_only = std::get<1>(key);
  out.density = std::get<2>(key);
  out.lamp_group = std::get<3>(key);
  return variants_[key] = add(std::move(out), base_[number], emission_[number]);
}

}  // namespace ff::bake::gltf
