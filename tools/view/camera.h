// Camera paths: from a JSON file, or found in the scene.
#pragma once
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "tools/view/renderer.h"
#include "tools/view/scene.h"

namespace ff::view {

struct CameraKey {
  double t = 0;  // s
  Vec3 eye, target;
};

struct CameraPath {
  double fps = 30;
  std::vector<CameraKey> keys;  // by time, at least one
  std::optional<Sun> sun;
  std::optional<runtime::Sky> sky;

  double start() const { return keys.front().t; }
  double end() const { return keys.back().t; }
  View at(double t) const;       // straight lines between keys
  Vec3 velocityAt(double t) const;  // m/s
};

// {"fps": .., "keys": [{"t", "eye", "target"}], "sun": {"direction", "irradiance"}, "sky": {"l0", "zenith"}}: metres,
// seconds; direction points to the sun; irradiance in W/m2 on a surface that faces it; the sky's radiance in direction w
// is l0 + zenith * w.y, W/(m2 sr). fps, sun and sky may be left out. Errors: kIo, kInvalidFile.
// origin: of the world (formats::WorldInfo::origin), from which its coordinates count; a file has those of the scene.
Result<CameraPath> readCamera(const std::string& path, const std::array<double, 3>& origin = {});

// L = l0 + zenith * w.y.
runtime::Sky skyOf(Vec3 l0, Vec3 zenith);

// Area-weighted mean fraction of sky that patches see, 0..1; patches that look at the backs of others do not count.
float openness(const ViewScene& scene);

// A path of 6 s: a few steps at eye height (1.6 m, less in models smaller than a room) over a floor large enough to stand on, in
// the lightest place with the most in view; where nobody can stand, an arc outside. by_night: there is neither sun nor sky, and what counts
// is what lamps light. Deterministic.
CameraPath findPath(const ViewScene& scene, bool by_night = false);

}  // namespace ff::view
