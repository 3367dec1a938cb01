#include "bake/gltf_materials.h"

#include <cmath>

#include "bake/gltf_images.h"

namespace ff::bake::gltf {
namespace {

// glTF's own default is a white metal, which has no diffuse reflection at all; untextured grey serves a radiosity
// baker.
constexpr float kDefaultAlbedo = 0.8f;
const char* const kFactorAlone = "the factor alone is used";
constexpr float kTintSteps = 15;  // per channel, in square roots: at most 4096 tints of a material

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

uint32_t Materials::image(int texture, bool* repeat) {
  const tinygltf::Texture& t = document_.model.textures[static_cast<size_t>(texture)];
  if (t.sampler >= 0) {
    const tinygltf::Sampler& s = document_.model.samplers[static_cast<size_t>(t.sampler)];
    *repeat = s.wrapS != TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE || s.wrapT != TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE;
  }
  if (t.source < 0) {
    scene_.warnings.push_back("texture " + std::to_string(texture) + ": has no PNG or JPEG source; " + kFactorAlone);
    return kNone;
  }
  const auto source = static_cast<uint32_t>(t.source);
  const auto known = images_.find(source);
  if (known != images_.end()) return known->second;
  uint32_t number = kNone;
  if (auto picture = readImage(document_, source, kFactorAlone, budget_, scene_.warnings)) {
    number = static_cast<uint32_t>(scene_.images.size());
    scene_.images.push_back(std::move(*picture));
  }
  images_[source] = number;
  return number;
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
  const double c = std::cos(angle), s = std::sin(angle);
  const double sx = pair("scale", 0, 1), sy = pair("scale", 1, 1);
  // Counter-clockwise as seen with v pointing down, as KHR_texture_transform's text says and renderers do.
  out.xx = c * sx, out.xy = s * sy, out.x = pair("offset", 0, 0);
  out.yx = -s * sx, out.yy = c * sy, out.y = pair("offset", 1, 0);
  return out;
}

// Metalness varies over the picture's blue channel; the scene has one number, the mean.
float Materials::meanMetal(int texture) {
  const tinygltf::Texture& t = document_.model.textures[static_cast<size_t>(texture)];
  // Factor 1 is how files say "see the picture"; without it most surfaces are no metals, and none should turn black.
  if (t.source < 0) return 0;
  const auto picture =
      readImage(document_, static_cast<uint32_t>(t.source), "taken as no metal", budget_, scene_.warnings);
  if (!picture) return 0;
  uint64_t sum = 0;
  for (size_t i = 2; i < picture->rgba.size(); i += 4) sum += picture->rgba[i];
  budget_.give(picture->rgba.size());
  return static_cast<float>(static_cast<double>(sum) / (255.0 * static_cast<double>(picture->rgba.size() / 4)));
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
    if (pbr.baseColorTexture.index >= 0) {
      base = uvSource(pbr.baseColorTexture.texCoord, pbr.baseColorTexture.extensions);
      out.base_image = image(pbr.baseColorTexture.index, &out.repeat);
    }
    if (m.emissiveTexture.index >= 0 && out.emission != Vec3{}) {
      emission = uvSource(m.emissiveTexture.texCoord, m.emissiveTexture.extensions);
      out.emission_image = image(m.emissiveTexture.index, &out.repeat);
    }
    if (pbr.metallicRoughnessTexture.index >= 0 && out.metallic > 0)
      out.metallic *= meanMetal(pbr.metallicRoughnessTexture.index);
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

uint32_t Materials::tinted(uint32_t number, Vec3 color) {
  const auto step = [](float c) { return static_cast<int>(std::lround(std::sqrt(c) * kTintSteps)); };
  const std::tuple key(number, step(color.x), step(color.y), step(color.z));
  const auto known = tints_.find(key);
  if (known != tints_.end()) return known->second;
  const auto back = [](int s) { return static_cast<float>(s * s) / (kTintSteps * kTintSteps); };
  Material out = scene_.materials[number];
  out.base_color = out.base_color * Vec3{back(std::get<1>(key)), back(std::get<2>(key)), back(std::get<3>(key))};
  const bool same = out.base_color == scene_.materials[number].base_color;
  return tints_[key] = same ? number : add(std::move(out), base_[number], emission_[number]);
}

}  // namespace ff::bake::gltf
