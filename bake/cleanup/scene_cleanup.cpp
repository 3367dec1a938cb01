#include "bake/cleanup/scene_cleanup.h"

#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <tuple>

#include "bake/cleanup/coincident.h"
#include "bake/cleanup/scene_names.h"
#include "bake/cleanup/sky_dome.h"
#include "bake/rays/surface_sampling.h"
#include "bake/surface/fineness.h"

namespace ff::bake {
namespace {

constexpr double kWorthALine = 1e-3;  // of the surface; panes of glass count nothing

// A scene that is copied once something is to change.
class Cleaner {
 public:
  explicit Cleaner(const Scene& whole) : whole_(whole) {}
  const Scene& scene() const { return changed_ ? *changed_ : whole_; }
  std::optional<Scene> take() { return std::move(changed_); }

  Result<std::vector<bool>> chosen(const std::string& pattern) const {
    auto match = matching(scene(), pattern);
    if (std::find(match.begin(), match.end(), true) == match.end())
      return Error{ErrorCode::kUsage, whole_.name, "", "no triangle has a node, mesh or material named \"" + pattern + "\"",
                   "see the file's names; * stands for any text"};
    return match;
  }

  void leaveOut(const std::vector<bool>& which) {
    Scene& s = edit();
    uint32_t kept = 0;
    size_t object = 0;
    for (uint32_t t = 0; t < which.size(); ++t) {
      for (; object < s.objects.size() && s.objects[object].first_triangle <= t; ++object) s.objects[object].first_triangle = kept;
      if (!which[t]) s.triangles[kept++] = s.triangles[t];
    }
    for (; object < s.objects.size(); ++object) s.objects[object].first_triangle = kept;
    s.triangles.resize(kept);
  }

  // Gives the chosen triangles their materials as `change` makes them.
  template <class Change>
  void remake(const std::vector<bool>& which, const Change& change) {
    Scene& s = edit();
    std::map<uint32_t, uint32_t> made;
    for (uint32_t t = 0; t < which.size(); ++t) {
      if (!which[t]) continue;
      const uint32_t old = s.triangles[t].material;
      const auto [at, added] = made.try_emplace(old, static_cast<uint32_t>(s.materials.size()));
      if (added) {
        Material material = s.materials[old];
        change(material);
        s.materials.push_back(std::move(material));
      }
      s.triangles[t].material = at->second;
    }
  }

  Scene& edit() {
    if (!changed_) changed_ = whole_;
    return *changed_;
  }

 private:
  const Scene& whole_;
  std::optional<Scene> changed_;
};

// Densities that are no power of two, each.
void noteRounding(const Scene& scene, std::vector<Finding>& findings) {
  struct Rounded {
    PlaceSums places;
    uint64_t triangles = 0;
    double m2 = 0;
  };
  std::map<float, Rounded> rounded;
  double all = 0;
  for (uint32_t t = 0; t < scene.triangles.size(); ++t) {
    const float density = scene.materials[scene.triangles[t].material].density;
    const auto m2 = static_cast<double>(triangleArea(scene, t));
    all += m2;
    if (density == std::ldexp(1.0f, finenessOf(density))) continue;
    Rounded& r = rounded.try_emplace(density, Rounded{PlaceSums(scene)}).first->second;
    r.places.add(t, m2);
    ++r.triangles;
    r.m2 += m2;
  }
  for (const auto& [density, r] : rounded) {
    char text[80];
    std::snprintf(text, sizeof text, "a density of %g is rounded to %g, a power of two", static_cast<double>(density), std::ldexp(1.0, finenessOf(density)));
    findings.push_back({"density", text, r.triangles, "triangles", r.m2 / all, "surface"});
    r.places.putInto(findings.back());
  }
}

void sign(Scene& s) {
  std::vector<float> numbers;
  for (const Material& m : s.materials) numbers.insert(numbers.end(), {m.occlude_only ? 1.0f : 0.0f, m.density, m.double_sided ? 1.0f : 0.0f});
  numbers.push_back(static_cast<float>(s.backs));
  XXH128_hash_t hash = XXH3_128bits_withSeed(s.triangles.data(), s.triangles.size() * sizeof(Triangle), 0);
  std::vector<unsigned char> bytes(s.content_hash.size() + sizeof hash + numbers.size() * sizeof(float));
  std::memcpy(bytes.data(), s.content_hash.data(), s.content_hash.size());
  std::memcpy(bytes.data() + s.content_hash.size(), &hash, sizeof hash);
  std::memcpy(bytes.data() + s.content_hash.size() + sizeof hash, numbers.data(), numbers.size() * sizeof(float));
  XXH128_canonical_t digest;
  XXH128_canonicalFromHash(&digest, XXH3_128bits(bytes.data(), bytes.size()));
  std::memcpy(s.content_hash.data(), digest.digest, s.content_hash.size());
}

}  // namespace

Result<Cleanup> cleanUp(const Scene& whole, const CleanupSettings& settings) {
  Cleaner cleaner(whole);
  std::vector<Finding> findings;
  for (const std::string& pattern : settings.exclude) {
    auto match = cleaner.chosen(pattern);
    if (!match) return match.error();
    cleaner.leaveOut(*match);
  }
  for (const std::string& pattern : settings.occlude_only) {
    auto match = cleaner.chosen(pattern);
    if (!match) return match.error();
    cleaner.remake(*match, [](Material& m) { m.occlude_only = true; });
  }
  for (const auto& [pattern, density] : settings.density) {
    if (!(density >= 1 / kLargestDensity && density <= kLargestDensity))
      return Error{ErrorCode::kUsage, whole.name, "", "the density of \"" + pattern + "\" must be 0.0625 to 16", "2 has patches half as large"};
    auto match = cleaner.chosen(pattern);
    if (!match) return match.error();
    cleaner.remake(*match, [d = density](Material& m) { m.density = d; });
  }
  if (!settings.keep_sky_dome) {
    if (const auto dome = findSkyDome(cleaner.scene()); !dome.empty()) {
      PlaceSums places(cleaner.scene());
      uint64_t count = 0;
      for (uint32_t t = 0; t < dome.size(); ++t)
        if (dome[t]) {
          ++count;
          places.add(t);
        }
      findings.push_back({"sky_dome", "left out a sky dome of " + counted(count, "triangle"), count, "triangles"});
      places.putInto(findings.back());
      findings.back().remedy = "--keep-sky-dome keeps it";
      cleaner.leaveOut(dome);
    }
  }
  {
    const auto duplicate = findDuplicates(cleaner.scene());
    PlaceSums places(cleaner.scene());
    uint64_t count = 0;
    double twice = 0, all = 0;
    bool emits = false;
    for (uint32_t t = 0; t < duplicate.size(); ++t) {
      const Scene& s = cleaner.scene();
      const double area = isHole(s, t, 1 / 3.0f, 1 / 3.0f) ? 0 : static_cast<double>(triangleArea(s, t));
      all += area;
      if (!duplicate[t]) continue;
      ++count;
      twice += area;
      emits = emits || !(s.materials[s.triangles[t].material].emission == Vec3{});
      places.add(t, area);
    }
    if (count > 0) {
      if (emits || twice > kWorthALine * all) {
        findings.push_back({"duplicates", counted(count, "triangle") + (count == 1 ? " lies" : " lie") + " where another does and " + (count == 1 ? "is" : "are") + " left out",
                            count, "triangles", all > 0 ? twice / all : 0, "surface"});
        places.putInto(findings.back());
      }
      cleaner.leaveOut(duplicate);
    }
  }
  if (settings.backs != Backs::kAbsorb) {
    Scene& s = cleaner.edit();
    s.backs = settings.backs;
    if (settings.backs == Backs::kReflect)
      for (Material& m : s.materials) m.double_sided = true;
  }
  noteRounding(cleaner.scene(), findings);
  Cleanup out{cleaner.take(), std::move(findings)};
  if (out.scene) sign(*out.scene);
  return out;
}

}  // namespace ff::bake
