// Which emitters are switched together: those whose materials name one lamp group, by default each material its own.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "bake/scene.h"

namespace ff::bake {

struct LampGroups {
  std::vector<std::string> name;          // in the order of the scene's materials
  std::vector<uint16_t> of_material;      // formats::kNoLampGroup: emits nothing
};

// Materials without a name are called "material N", N their number. Past 65535 groups the rest share the last one.
LampGroups groupLamps(const Scene& scene);

}  // namespace ff::bake
