#include "bake/gltf_import.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <cmath>
#include <limits>
#include <memory>
#include <new>

#include "bake/gltf_instances.h"
#include "bake/gltf_materials.h"

namespace ff::bake {
namespace {

using namespace gltf;

// Products of four coordinates (squared areas) must stay within float for those who come after.
constexpr double kFarthest = 1e9;
// Thinner triangles than this (height over longest edge) have lost their normal to rounding in float.
constexpr double kThinnest = 1e-7;

Vec3 toWorld(const Matrix& m, Vec3 p, const std::string& place) {
  Vec3 out;
  for (int r = 0; r < 3; ++r) {
    const auto row = static_cast<size_t>(r);
    const double v = m[row] * double{p.x} + m[row + 4] * double{p.y} + m[row + 8] * double{p.z} + m[row + 12];
    if (!(std::fabs(v) <= kFarthest)) refuse(place, "a world coordinate is beyond 1e9 m", "scale the scene to metres");
    out[r] = static_cast<float>(v);
  }
  return out;
}

bool isDegenerate(Vec3 a, Vec3 b, Vec3 c) {
  const double ab[3] = {double{b.x} - a.x, double{b.y} - a.y, double{b.z} - a.z};
  const double ac[3] = {double{c.x} - a.x, double{c.y} - a.y, double{c.z} - a.z};
  const double bc[3] = {double{c.x} - b.x, double{c.y} - b.y, double{c.z} - b.z};
  const double n[3] = {ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]};
  const auto squared = [](const double* v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; };
  const double twice_area = std::sqrt(squared(n));
  const double longest_squared = std::max({squared(ab), squared(ac), squared(bc)});
  return !(twice_area > kThinnest * longest_squared) || twice_area < double{std::numeric_limits<float>::min()};
}

class Builder {
 public:
  Builder(const Document& document, const ImportLimits& limits, Budget& budget, Scene& scene)
      : document_(document), limits_(limits), budget_(budget), scene_(scene), materials_(document, scene, budget) {}

  // Mesh by mesh, so that each is decoded once and only one is held.
  void build() {
    const auto instances = listInstances(document_, budget_);
    for (size_t m = 0; m < instances.size(); ++m) {
      if (instances[m].empty()) continue;
      const auto& primitives = document_.model.meshes[m].primitives;
      for (size_t p = 0; p < primitives.size(); ++p)
        addPrimitive(primitives[p], instances[m], "mesh " + std::to_string(m) + " primitive " + std::to_string(p));
    }
    if (dropped_) scene_.warnings.push_back(std::to_string(dropped_) + " triangles without area are left out");
    if (scene_.triangles.empty()) scene_.warnings.push_back("the scene holds no triangles");
  }

 private:
  void addPrimitive(const tinygltf::Primitive& primitive, const std::vector<Instance>& instances,
                    const std::string& place) {
    const uint32_t material = materials_.number(primitive.material);
    const Surface surface = readSurface(document_, primitive, materials_.base(material), materials_.emission(material),
                                        place, budget_, scene_.warnings);
    const uint64_t vertices = surface.positions.size() * uint64_t{instances.size()};
    const uint64_t triangles = surface.triangles.size() * uint64_t{instances.size()};
    if (triangles > limits_.max_triangles - scene_.triangles.size())
      refuse(place, "more than " + std::to_string(limits_.max_triangles) + " triangles",
             "split the scene or raise the limit");
    if (vertices > 0xfffffffeu - scene_.positions.size())
      refuse(place, "more than 4294967294 vertices", "split the scene");
    budget_.take(vertices * sizeof(Vec3) + triangles * sizeof(Triangle), place);
    std::vector<uint32_t> tints;
    for (const Vec3 color : surface.colors) tints.push_back(materials_.tinted(material, color));
    for (const Instance& instance : instances) addInstance(surface, instance, material, tints);
  }

  void addInstance(const Surface& surface, const Instance& instance, uint32_t material,
                   const std::vector<uint32_t>& tints) {
    const auto first = static_cast<uint32_t>(scene_.positions.size());
    const std::string place = "node " + std::to_string(instance.node);
    for (const Vec3 p : surface.positions) scene_.positions.push_back(toWorld(instance.to_world, p, place));
    addUv(scene_.uv0, surface.uv0, first);
    addUv(scene_.uv1, surface.uv1, first);
    const bool mirrored = isMirror(instance.to_world);
    for (size_t t = 0; t < surface.triangles.size(); ++t) {
      std::array<uint32_t, 3> v = surface.triangles[t];
      for (uint32_t& i : v) i += first;
      if (mirrored) std::swap(v[1], v[2]);
      if (isDegenerate(scene_.positions[v[0]], scene_.positions[v[1]], scene_.positions[v[2]])) {
        ++dropped_;
        continue;
      }
      scene_.triangles.push_back({v, tints.empty() ? material : tints[t]});
    }
  }

  // The array starts with the first surface that needs it; surfaces without coordinates get zeros.
  void addUv(std::vector<Vec2>& all, const std::vector<Vec2>& uv, uint32_t first) {
    if (uv.empty() && all.empty()) return;
    budget_.take((scene_.positions.size() - all.size()) * sizeof(Vec2), "texture coordinates");
    all.resize(first);
    all.insert(all.end(), uv.begin(), uv.end());
    all.resize(scene_.positions.size());
  }

  const Document& document_;
  const ImportLimits& limits_;
  Budget& budget_;
  Scene& scene_;
  Materials materials_;
  uint64_t dropped_ = 0;
};

class Hasher {
 public:
  Hasher() { XXH3_128bits_reset(&state_); }
  void add(const void* bytes, size_t size) {
    if (size) XXH3_128bits_update(&state_, bytes, size);
  }
  void add(uint64_t n) { add(&n, sizeof n); }
  template <class T>
  void add(const std::vector<T>& v) {
    static_assert(std::has_unique_object_representations_v<T> || sizeof(T) % sizeof(float) == 0, "no padding");
    add(uint64_t{v.size()});
    add(v.data(), v.size() * sizeof(T));
  }
  std::array<uint8_t, 16> digest() const {
    XXH128_canonical_t canonical;
    XXH128_canonicalFromHash(&canonical, XXH3_128bits_digest(&state_));
    std::array<uint8_t, 16> out;
    std::copy(std::begin(canonical.digest), std::end(canonical.digest), out.begin());
    return out;
  }

 private:
  XXH3_state_t state_;
};

// Names and warnings do not count: they do not change a bake.
std::array<uint8_t, 16> contentHash(const Scene& scene) {
  const auto hasher = std::make_unique<Hasher>();
  hasher->add(scene.positions);
  hasher->add(scene.triangles);
  hasher->add(scene.uv0);
  hasher->add(scene.uv1);
  hasher->add(uint64_t{scene.materials.size()});
  for (const Material& m : scene.materials) {
    const float numbers[] = {m.base_color.x, m.base_color.y, m.base_color.z, m.alpha,       m.metallic,
                             m.emission.x,   m.emission.y,   m.emission.z,   m.alpha_cutoff};
    const uint32_t words[] = {m.base_image, m.emission_image, m.repeat, m.double_sided, m.cutout};
    hasher->add(numbers, sizeof numbers);
    hasher->add(words, sizeof words);
  }
  hasher->add(uint64_t{scene.images.size()});
  for (const Image& image : scene.images) {
    hasher->add(uint64_t{image.width} << 32 | image.height);
    hasher->add(image.rgba);
  }
  return hasher->digest();
}

}  // namespace

Result<Scene> importGltf(const std::string& path, const ImportLimits& limits) {
  try {
    Scene scene;
    const size_t slash = path.rfind('/');
    scene.name = slash == std::string::npos ? path : path.substr(slash + 1);
    Budget budget(limits.max_memory_bytes);
    {
      const Document document = loadDocument(path, budget, scene.warnings);
      Builder(document, limits, budget, scene).build();
    }
    scene.content_hash = contentHash(scene);
    return scene;
  } catch (Fault& fault) {
    fault.error.file = path;
    return fault.error;
  } catch (const std::bad_alloc&) {
    return Error{ErrorCode::kInvalidFile, path, "", "needs more memory than there is", "split the scene"};
  } catch (const std::exception& e) {
    return Error{ErrorCode::kInvalidFile, path, "", printable(e.what()), "re-export the file"};
  }
}

}  // namespace ff::bake
