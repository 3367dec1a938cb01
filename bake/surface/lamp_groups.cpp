#include "bake/surface/lamp_groups.h"

#include <unordered_map>

#include "formats/model.h"

namespace ff::bake {

LampGroups groupLamps(const Scene& scene) {
  LampGroups groups;
  std::unordered_map<std::string, uint16_t> number;
  for (size_t m = 0; m < scene.materials.size(); ++m) {
    const Material& material = scene.materials[m];
    groups.of_material.push_back(formats::kNoLampGroup);
    if (material.emission == Vec3{}) continue;
    std::string name = !material.lamp_group.empty() ? material.lamp_group : material.name;
    if (name.empty()) name = "material " + std::to_string(m);
    const auto last = static_cast<uint16_t>(formats::kNoLampGroup - 1);
    const auto next = static_cast<uint16_t>(groups.name.size() < last ? groups.name.size() : last);
    const auto [found, added] = number.try_emplace(name, next);
    if (added && groups.name.size() <= last) groups.name.push_back(name);
    groups.of_material.back() = found->second;
  }
  return groups;
}

}  // namespace ff::bake
