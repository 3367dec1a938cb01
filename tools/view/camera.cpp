#include "tools/view/camera.h"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

namespace ff::view {
namespace {

using nlohmann::json;

std::optional<Vec3> triple(const json& object, const char* key, const std::array<double, 3>& origin = {}) {
  const auto it = object.find(key);
  if (it == object.end() || !it->is_array() || it->size() != 3) return std::nullopt;
  Vec3 v;
  for (int i = 0; i < 3; ++i) {
    const json& x = (*it)[static_cast<size_t>(i)];
    if (!x.is_number() || !std::isfinite(x.get<float>())) return std::nullopt;
    v[i] = static_cast<float>(x.get<double>() - origin[static_cast<size_t>(i)]);
  }
  return v;
}

}  // namespace

runtime::Sky skyOf(Vec3 l0, Vec3 zenith) {
  return {l0, {{0, zenith.x, 0}, {0, zenith.y, 0}, {0, zenith.z, 0}}};
}

View CameraPath::at(double t) const {
  size_t i = 0;
  while (i + 2 < keys.size() && keys[i + 1].t <= t) ++i;
  const CameraKey &a = keys[i], &b = keys[std::min(i + 1, keys.size() - 1)];
  const float f = b.t > a.t ? static_cast<float>(std::clamp((t - a.t) / (b.t - a.t), 0.0, 1.0)) : 0.0f;
  View v;
  v.eye = a.eye + (b.eye - a.eye) * f;
  v.target = a.target + (b.target - a.target) * f;
  return v;
}

Vec3 CameraPath::velocityAt(double t) const {
  const double step = 0.05, from = std::max(start(), t - step), to = std::min(end(), t + step);
  return to > from ? (at(to).eye - at(from).eye) / static_cast<float>(to - from) : Vec3{};
}

Result<CameraPath> readCamera(const std::string& path, const std::array<double, 3>& origin) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return Error{ErrorCode::kIo, path, "", "cannot be read", "name a camera path (JSON)"};
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  const auto invalid = [&](std::string place, std::string message) {
    return Error{ErrorCode::kInvalidFile, path, std::move(place), std::move(message), ""};
  };
  const json j = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!j.is_object()) return invalid("", "is not a JSON object");
  CameraPath camera;
  if (j.contains("fps")) {
    if (!j["fps"].is_number() || !(j["fps"].get<double>() > 0)) return invalid("fps", "is not a positive number");
    camera.fps = j["fps"].get<double>();
  }
  if (!j.contains("keys") || !j["keys"].is_array() || j["keys"].empty()) return invalid("keys", "there are none");
  for (const json& k : j["keys"]) {
    const std::string place = "key " + std::to_string(camera.keys.size());
    if (!k.is_object() || !k.contains("t") || !k["t"].is_number()) return invalid(place, "has no time t");
    const auto eye = triple(k, "eye", origin), target = triple(k, "target", origin);
    if (!eye || !target) return invalid(place, "needs eye and target, three numbers each");
    const CameraKey key{k["t"].get<double>(), *eye, *target};
    if (!camera.keys.empty() && key.t < camera.keys.back().t) return invalid(place, "goes back in time");
    camera.keys.push_back(key);
  }
  if (j.contains("sun") && !j["sun"].is_null()) {
    if (!j["sun"].is_object()) return invalid("sun", "is not an object");
    const auto direction = triple(j["sun"], "direction"), irradiance = triple(j["sun"], "irradiance");
    if (!direction || !irradiance || length(*direction) == 0)
      return invalid("sun", "needs direction and irradiance, three numbers each");
    camera.sun = Sun{normalized(*direction), *irradiance};
  }
  if (j.contains("sky") && !j["sky"].is_null()) {
    if (!j["sky"].is_object()) return invalid("sky", "is not an object");
    const auto l0 = triple(j["sky"], "l0");
    if (!l0) return invalid("sky", "needs l0, three numbers");
    camera.sky = skyOf(*l0, triple(j["sky"], "zenith").value_or(Vec3{}));
  }
  return camera;
}

}  // namespace ff::view
