#include "bake/import/gltf_import.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <new>
#include <string_view>
#include <unordered_set>

#include "bake/import/instances.h"
#include "bake/import/materials.h"

namespace ff::bake {
namespace {

using namespace gltf;

// Products of four coordinates (squared areas) must stay within float for those who come after.
constexpr double kFarthest = 1e9;
// Pixels that are decoded, many of them only to take their mean, over the memory that may be held.
constexpr uint64_t kDecodedTimes = 4;
// Thinner triangles than this (height over longest edge) have lost their normal to rounding in float.
constexpr double kThinnest = 1e-7;

// Coordinates of a scene that stands far from the origin of its file lose their last digits in float; so they count from
// a place near it. The median tells where it is, whatever strays: of a scene within kNearBy times its own size (that of all but the
// outermost tenths) the origin stays. Whole powers of two not below the size, so that grids and lattices stay where they were.
constexpr double kNearBy = 16;

std::array<double, 3> originOf(const Scene& scene) {
  std::array<double, 3> median{}, origin{};
  double size = 0;
  PagedVector<float> at;
  for (int a = 0; a < 3; ++a) {
    at.clear();
    for (const Triangle& t : scene.triangles) at.push_back(scene.positions[t.v[0]][a]);
    if (at.empty()) return origin;
    const auto quantile = [&](size_t tenths) {
      const auto nth = at.begin() + static_cast<ptrdiff_t>((at.size() - 1) * tenths / 10);
      std::nth_element(at.begin(), nth, at.end());
      return static_cast<double>(*nth);
    };
    median[static_cast<size_t>(a)] = quantile(5);
    size = std::max(size, quantile(9) - quantile(1));
  }
  if (!(size > 0)) return origin;
  int power = 0;
  const double step = std::ldexp(1.0, std::frexp(size, &power) == 0.5 ? power - 1 : power);
  for (size_t a = 0; a < 3; ++a)
    if (std::abs(median[a]) > kNearBy * size) origin[a] = step * std::round(median[a] / step);
  return origin;
}

Vec3 toWorld(const Matrix& m, Vec3 p, const std::array<double, 3>& origin, const std::string& place) {
  Vec3 out;
  for (int r = 0; r < 3; ++r) {
    const auto row = static_cast<size_t>(r);
    const double v = m[row] * double{p.x} + m[row + 4] * double{p.y} + m[row + 8] * double{p.z} + m[row + 12];
    if (!(std::fabs(v) <= kFarthest)) refuse(place, "a world coordinate is beyond 1e9 m", "scale the scene to metres");
    out[r] = static_cast<float>(v - origin[row]);
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

Matrix rootOf(const ImportLimits& limits) {
  const double s = limits.scale;
  const Matrix metres = limits.z_up ? Matrix{s, 0, 0, 0, 0, 0, -s, 0, 0, s, 0, 0, 0, 0, 0, 1} : Matrix{s, 0, 0, 0, 0, s, 0, 0, 0, 0, s, 0, 0, 0, 0, 1};
  return multiply(limits.placed, metres);
}

class Builder {
 public:
  Builder(const Document& document, const ImportLimits& limits, Budget& budget, Scene& scene)
      : document_(document), limits_(limits), budget_(budget), scene_(scene),
        materials_(document, scene, budget, kDecodedTimes * limits.max_memory_bytes) {}

  // Mesh by mesh, so that each is decoded once and only one is held.
  void build() {
    scene_.node_names = document_.objects.node_names;
    scene_.mesh_names = document_.objects.mesh_names;
    std::vector<Instance> lights;
    auto instances = listInstances(document_, rootOf(limits_), budget_, lights);
    scene_.left_alone = document_.lights.left_alone;
    addLights(lights);
    for (size_t m = 0; m < instances.size(); ++m) {
      keepOnce(static_cast<uint32_t>(m), instances[m]);
      all_ += instances[m].size() * document_.model.meshes[m].primitives.size();
    }
    warnOfRepeats();
    for (size_t m = 0; m < instances.size(); ++m) {
      if (instances[m].empty()) continue;
      const auto& primitives = document_.model.meshes[m].primitives;
      for (size_t p = 0; p < primitives.size(); ++p)
        addPrimitive(primitives[p], static_cast<uint32_t>(m), instances[m], "mesh " + std::to_string(m) + " primitive " + std::to_string(p));
    }
    if (limits_.progress) limits_.progress(all_, all_);
    if (scene_.triangles.empty()) scene_.warnings.push_back("the scene holds no triangles");
  }

 private:
  // Instances at the very same place count once, before millions of them take memory; bake/cleanup/coincident.h finds what differs by rounding.
  void keepOnce(uint32_t mesh, std::vector<Instance>& instances) {
    std::unordered_set<std::string_view> seen;
    size_t kept = 0, listed = 0;
    int first = -1;
    // In place: what is kept moves to the front, where the views of what was seen stay valid.
    for (size_t i = 0; i < instances.size(); ++i) {
      if (!document_.objects.nodes[static_cast<size_t>(instances[i].node)].include.value_or(true)) continue;
      ++listed;
      const auto bytes = [&](size_t k) {
        return std::string_view(reinterpret_cast<const char*>(instances[k].to_world.data()), sizeof(Matrix));
      };
      if (seen.count(bytes(i))) {
        if (first < 0) first = instances[i].node;
        continue;
      }
      instances[kept] = instances[i];
      seen.insert(bytes(kept++));
    }
    instances.resize(kept);
    if (first < 0) return;
    const std::string& name = document_.objects.mesh_names[mesh];  // several may have it
    const auto known = std::find_if(repeats_.begin(), repeats_.end(), [&](const Repeat& r) {
      return !name.empty() && name == document_.objects.mesh_names[r.mesh];
    });
    if (known != repeats_.end())
      known->instances += listed - kept;
    else
      repeats_.push_back({listed - kept, mesh, static_cast<uint32_t>(first)});
  }

  // Of all meshes in one line, the commonest first.
  void warnOfRepeats() {
    if (repeats_.empty()) return;
    std::stable_sort(repeats_.begin(), repeats_.end(), [](const Repeat& a, const Repeat& b) { return a.instances > b.instances; });
    constexpr size_t kNamed = 3;
    uint64_t all = 0;
    std::string named;
    const auto name = [](const char* kind, const std::vector<std::string>& names, size_t i) {
      return kind + (names[i].empty() ? std::to_string(i) : "\"" + names[i] + "\"");
    };
    for (size_t i = 0; i < repeats_.size(); ++i) {
      all += repeats_[i].instances;
      if (i < kNamed)
        named += (i > 0 ? ", " : "") + std::to_string(repeats_[i].instances) + " of " + name("mesh ", document_.objects.mesh_names, repeats_[i].mesh) +
                 " (first: " + name("node ", document_.objects.node_names, repeats_[i].node) + ")";
    }
    if (repeats_.size() > kNamed) named += " and those of " + std::to_string(repeats_.size() - kNamed) + (repeats_.size() == kNamed + 1 ? " more mesh" : " more meshes");
    scene_.warnings.push_back(std::to_string(all) + (all == 1 ? " instance stands where another does and counts once: " : " instances stand where others do and count once: ") + named);
  }

  void addLights(const std::vector<Instance>& nodes) {
    for (const Instance& at : nodes) {
      Matrix to_scene = at.to_world;
      for (size_t a = 0; a < 3; ++a) to_scene[12 + a] -= scene_.origin[a];
      auto light = placed(document_.lights.of_node.at(static_cast<uint32_t>(at.node)), to_scene, "node " + std::to_string(at.node), scene_.warnings);
      if (light) {
        light->range_m *= static_cast<float>(limits_.scale * std::cbrt(std::abs(determinant(limits_.placed))));
        scene_.lights.push_back(std::move(*light));
      }
    }
  }

  void addPrimitive(const tinygltf::Primitive& primitive, uint32_t mesh, const std::vector<Instance>& instances,
                    const std::string& place) {
    const uint32_t material = materials_.number(primitive.material);
    const Material& look = scene_.materials[material];
    if (look.transmission == 1 || (look.blend && look.alpha == 0)) return;  // stops no light
    const Surface surface = readSurface(document_, primitive, materials_.base(material), materials_.emission(material),
                                        place, budget_, scene_.warnings);
    const uint64_t vertices = surface.positions.size() * uint64_t{instances.size()};
    const uint64_t triangles = surface.triangles.size() * uint64_t{instances.size()};
    if (triangles > limits_.max_triangles - scene_.triangles.size())
      refuse(place, "more than " + std::to_string(limits_.max_triangles) + " triangles",
             "split the scene or raise the limit");
    if (vertices > 0xfffffffeu - scene_.positions.size())
      refuse(place, "more than 4294967294 vertices", "split the scene");
    budget_.take(vertices * sizeof(Vec3) + triangles * sizeof(Triangle) + instances.size() * sizeof(Object), place);
    for (const Instance& instance : instances) {
      const Objects& objects = document_.objects;
      Traits traits = merged(objects.nodes[static_cast<size_t>(instance.node)], objects.meshes[mesh]);
      if (primitive.material >= 0) traits = merged(traits, objects.materials[static_cast<size_t>(primitive.material)]);
      if (!traits.include.value_or(true)) continue;
      scene_.objects.push_back({static_cast<uint32_t>(scene_.triangles.size()), static_cast<uint32_t>(instance.node), mesh});
      addInstance(surface, instance, material, traits);
      if (limits_.progress && ++added_ % 64 == 0) limits_.progress(std::min(added_, all_), all_);
    }
  }

  void addInstance(const Surface& surface, const Instance& instance, uint32_t material, const Traits& traits) {
    const auto first = static_cast<uint32_t>(scene_.positions.size());
    const std::string place = "node " + std::to_string(instance.node);
    for (const Vec3 p : surface.positions) scene_.positions.push_back(toWorld(instance.to_world, p, scene_.origin, place));
    addPerVertex(scene_.uv0, surface.uv0, first);
    addPerVertex(scene_.uv1, surface.uv1, first);
    addPerVertex(scene_.colors, surface.colors, first);
    const bool mirrored = isMirror(instance.to_world);
    for (size_t t = 0; t < surface.triangles.size(); ++t) {
      std::array<uint32_t, 3> v = surface.triangles[t];
      for (uint32_t& i : v) i += first;
      if (mirrored) std::swap(v[1], v[2]);
      if (isDegenerate(scene_.positions[v[0]], scene_.positions[v[1]], scene_.positions[v[2]])) {
        leaveOut(scene_.positions[v[0]], instance.node);
        continue;
      }
      scene_.triangles.push_back({v, materials_.with(material, traits)});
    }
  }

  void leaveOut(Vec3 at, int node) {
    ++scene_.without_area;
    if (scene_.without_area_at.size() == kMaxPlaces) return;
    const std::string& name = scene_.node_names[static_cast<size_t>(node)];
    FoundPlace& place = scene_.without_area_at.emplace_back();
    place.at = inWorld(scene_, at);
    place.name = name.empty() ? "node " + std::to_string(node) : "node \"" + name + "\"";
  }

  // The array starts with the first surface that needs it; surfaces without values get the neutral ones.
  template <class T>
  void addPerVertex(PagedVector<T>& all, const PagedVector<T>& values, uint32_t first) {
    if (values.empty() && all.empty()) return;
    budget_.take((scene_.positions.size() - all.size()) * sizeof(T), "vertex attributes");
    all.resize(first);
    all.insert(all.end(), values.begin(), values.end());
    all.resize(scene_.positions.size());
  }

  struct Repeat {
    size_t instances;
    uint32_t mesh, node;  // node: of the first that was left out
  };

  const Document& document_;
  const ImportLimits& limits_;
  Budget& budget_;
  Scene& scene_;
  Materials materials_;
  std::vector<Repeat> repeats_;
  uint64_t added_ = 0, all_ = 0;
};

class Hasher {
 public:
  Hasher() { XXH3_128bits_reset(&state_); }
  void add(const void* bytes, size_t size) {
    if (size) XXH3_128bits_update(&state_, bytes, size);
  }
  void add(const std::string& text) { add(text.data(), text.size()); }
  void add(uint64_t n) { add(&n, sizeof n); }
  template <class T, class Allocator>
  void add(const std::vector<T, Allocator>& v) {
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

// Warnings, what is left alone and names other than lamp groups' and lights' do not count: they do not change a bake.
std::array<uint8_t, 16> contentHash(const Scene& scene) {
  const auto hasher = std::make_unique<Hasher>();
  hasher->add(scene.origin.data(), sizeof scene.origin);
  hasher->add(scene.positions);
  hasher->add(scene.triangles);
  hasher->add(scene.uv0);
  hasher->add(scene.uv1);
  hasher->add(scene.colors);
  hasher->add(uint64_t{scene.materials.size()});
  for (const Material& m : scene.materials) {
    const float numbers[] = {m.base_color.x, m.base_color.y, m.base_color.z, m.alpha,       m.metallic,
                             m.emission.x,   m.emission.y,   m.emission.z,   m.alpha_cutoff,
                             m.specular.x,   m.specular.y,   m.specular.z,   m.transmission};
    const uint32_t words[] = {m.base_image, m.emission_image, m.repeat, m.double_sided, m.cutout, m.blend, m.occlude_only};
    hasher->add(&m.density, sizeof m.density);
    if (!(m.emission == Vec3{})) hasher->add((m.lamp_group.empty() ? m.name : m.lamp_group) + '\0');  // worlds list them
    hasher->add(numbers, sizeof numbers);
    hasher->add(words, sizeof words);
  }
  hasher->add(uint64_t{scene.images.size()});
  for (const Image& image : scene.images) {
    hasher->add(uint64_t{image.width} << 32 | image.height);
    hasher->add(image.rgba);
  }
  hasher->add(uint64_t{scene.lights.size()});
  for (const formats::Light& l : scene.lights) {
    const float numbers[] = {l.color_intensity.x, l.color_intensity.y, l.color_intensity.z, l.position.x,
                             l.position.y,        l.position.z,        l.direction.x,       l.direction.y,
                             l.direction.z,       l.range_m,           l.inner_angle,       l.outer_angle};
    hasher->add(uint64_t{l.kind});
    hasher->add(numbers, sizeof numbers);
    hasher->add(uint64_t{l.name.size()});
    hasher->add(l.name.data(), l.name.size());
  }
  return hasher->digest();
}

}  // namespace

Result<Scene> importGltf(const std::string& path, const ImportLimits& limits) {
  try {
    if (!(limits.scale > 0 && limits.scale <= kFarthest))
      return Error{ErrorCode::kUsage, path, "", "the scale must be positive", "0.01 for a file in centimetres"};
    const size_t slash = path.rfind('/');
    const auto build = [&](const std::array<double, 3>& origin) {
      Scene scene;
      scene.name = slash == std::string::npos ? path : path.substr(slash + 1);
      scene.origin = origin;
      Budget budget(limits.max_memory_bytes);
      const Document document = loadDocument(path, budget, scene.warnings);
      Builder(document, limits, budget, scene).build();
      return scene;
    };
    Scene scene = build({});
    if (const auto origin = originOf(scene); origin != std::array<double, 3>{}) scene = build(origin);
    scene.content_hash = contentHash(scene);
    return scene;
  } catch (ImportError& fault) {
    fault.error.file = path;
    return fault.error;
  } catch (const std::bad_alloc&) {
    return Error{ErrorCode::kInvalidFile, path, "", "needs more memory than there is", "split the scene"};
  } catch (const std::exception& e) {
    return Error{ErrorCode::kInvalidFile, path, "", printable(e.what()), "re-export the file"};
  }
}

}  // namespace ff::bake
