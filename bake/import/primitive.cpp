#include "bake/import/primitive.h"

#include <algorithm>
#include <limits>

#include "bake/import/draco.h"

namespace ff::bake::gltf {
namespace {

constexpr uint32_t kUnseen = 0xffffffffu;
constexpr float kLargestUv = 65536;  // beyond, a float has no useful fraction left

using Triangles = PagedVector<std::array<uint32_t, 3>>;

// The triangles of a run of `count` corners. corner(i): vertex number of the i-th.
template <class Corner>
void assemble(int mode, uint64_t count, const Corner& corner, Triangles& out) {
  const uint64_t n = mode == TINYGLTF_MODE_TRIANGLES ? count / 3 : count < 3 ? 0 : count - 2;
  out.reserve(n);
  for (uint64_t i = 0; i < n; ++i) {
    if (mode == TINYGLTF_MODE_TRIANGLES)
      out.push_back({corner(3 * i), corner(3 * i + 1), corner(3 * i + 2)});
    else if (mode == TINYGLTF_MODE_TRIANGLE_STRIP)
      out.push_back({corner(i), corner(i + 1 + i % 2), corner(i + 2 - i % 2)});
    else
      out.push_back({corner(i + 1), corner(i + 2), corner(0)});
  }
}

void checkCount(int mode, uint64_t count, const std::string& place, std::vector<std::string>& warnings) {
  if (mode == TINYGLTF_MODE_TRIANGLES ? count % 3 != 0 : count < 3)
    warnings.push_back(place + ": " + std::to_string(count) +
                       " corners do not make whole triangles, the rest is left out");
}

Vec2 transformed(const UvSource& source, const Elements& uv, uint64_t i) {
  const double u = uv.value(i, 0), v = uv.value(i, 1);
  const auto fold = [](double t) { return std::clamp(static_cast<float>(t), -kLargestUv, kLargestUv); };
  return {fold(source.xx * u + source.xy * v + source.x), fold(source.yx * u + source.yy * v + source.y)};
}

// Files may declare geometry whose bytes an application is to supply: no bufferView, or a buffer without uri.
bool hasData(const Document& document, int accessor) {
  const auto present = [&](int view) {
    return document.buffer_present[static_cast<size_t>(document.model.bufferViews[static_cast<size_t>(view)].buffer)];
  };
  const tinygltf::Accessor& a = document.model.accessors[static_cast<size_t>(accessor)];
  if (a.bufferView < 0 && !a.sparse.isSparse) return false;
  return (a.bufferView < 0 || present(a.bufferView)) &&
         (!a.sparse.isSparse || (present(a.sparse.indices.bufferView) && present(a.sparse.values.bufferView)));
}

}  // namespace

uint64_t surfaceBytes(uint64_t vertices, uint64_t triangles) {
  return vertices * (sizeof(Vec3) + 2 * sizeof(Vec2) + sizeof(Rgba) + sizeof(uint32_t)) +
         triangles * (sizeof(Triangles::value_type) + sizeof(Vec3));
}

Surface readSurface(const Document& document, const tinygltf::Primitive& primitive, const UvSource& base,
                    const UvSource& emission, const std::string& place, Budget& budget,
                    std::vector<std::string>& warnings) {
  Surface out;
  std::map<std::string, Elements> attributes;
  Triangles triangles;
  const auto draco = primitive.extensions.find("KHR_draco_mesh_compression");
  uint64_t vertex_count = 0;
  uint64_t taken = 0;
  if (draco != primitive.extensions.end()) {
    DracoMesh mesh = decodeDraco(document, draco->second, primitive.mode, place, budget);
    attributes = std::move(mesh.attributes);
    triangles.assign(mesh.triangles.begin(), mesh.triangles.end());
    vertex_count = mesh.vertex_count;
    budget.take(taken = surfaceBytes(vertex_count, triangles.size()), place);
  } else {
    if (!hasData(document, primitive.attributes.at("POSITION")) ||
        (primitive.indices >= 0 && !hasData(document, primitive.indices))) {
      warnings.push_back(place + ": its accessors have no data, it is left out");
      return out;
    }
    const auto set = [](const UvSource& source) { return "TEXCOORD_" + std::to_string(source.set); };
    for (const auto& [name, accessor] : primitive.attributes) {
      if (name != "POSITION" && name != "COLOR_0" && !(base.used && name == set(base)) &&
          !(emission.used && name == set(emission)))
        continue;
      if (name == "COLOR_0" && !hasData(document, accessor)) {
        warnings.push_back(place + ": its vertex colours cannot be read, they are left out");
        continue;
      }
      attributes.emplace(name, Elements(document, accessor));
    }
    vertex_count = attributes.at("POSITION").count();
    if (primitive.indices >= 0) {
      const Elements indices(document, primitive.indices);
      checkCount(primitive.mode, indices.count(), place, warnings);
      budget.take(taken = surfaceBytes(std::min(vertex_count, indices.count()), indices.count()) + vertex_count * 4,
                  place);
      assemble(
          primitive.mode, indices.count(),
          [&](uint64_t i) {
            const uint32_t v = indices.index(i);
            if (v >= vertex_count)
              refuse(place, "index " + std::to_string(i) + " (accessor " + std::to_string(primitive.indices) +
                                ") is vertex " + std::to_string(v) + " of " + std::to_string(vertex_count));
            return v;
          },
          triangles);
    } else {
      checkCount(primitive.mode, vertex_count, place, warnings);
      budget.take(taken = surfaceBytes(vertex_count, vertex_count) + vertex_count * 4, place);
      assemble(
          primitive.mode, vertex_count, [](uint64_t i) { return static_cast<uint32_t>(i); }, triangles);
    }
  }

  const auto texCoords = [&](const UvSource& source) -> const Elements* {
    if (!source.used) return nullptr;
    const auto it = attributes.find("TEXCOORD_" + std::to_string(source.set));
    if (it == attributes.end())
      refuse(place, "its material's texture uses TEXCOORD_" + std::to_string(source.set) + ", which is missing");
    return &it->second;
  };
  const Elements* uv0 = texCoords(base);
  const Elements* uv1 = texCoords(emission);
  const auto color = attributes.find("COLOR_0");
  const Elements& positions = attributes.at("POSITION");

  // Only vertices in use are kept, in order of first use: several primitives may share one large accessor.
  PagedVector<uint32_t> kept(vertex_count, kUnseen);
  bool white = true;
  for (auto& triangle : triangles) {
    for (uint32_t& v : triangle) {
      if (kept[v] == kUnseen) {
        kept[v] = static_cast<uint32_t>(out.positions.size());
        out.positions.push_back({positions.value(v, 0), positions.value(v, 1), positions.value(v, 2)});
        if (uv0) out.uv0.push_back(transformed(base, *uv0, v));
        if (uv1) out.uv1.push_back(transformed(emission, *uv1, v));
        if (color != attributes.end()) {
          const auto channel = [&](uint32_t c) { return std::clamp(color->second.value(v, c), 0.0f, 1.0f); };
          out.colors.push_back({channel(0), channel(1), channel(2), color->second.components() > 3 ? channel(3) : 1.0f});
          white = white && out.colors.back() == Rgba{};
        }
      }
      v = kept[v];
    }
  }
  if (white) out.colors.clear();
  out.triangles = std::move(triangles);
  budget.give(taken);
  return out;
}

}  // namespace ff::bake::gltf
