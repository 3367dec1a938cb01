// A generated scene as the baker takes it, without the detour over a file.
#pragma once
#include "bake/scene.h"
#include "tools/scene/model.h"

namespace ff::chart {

inline bake::Scene sceneOf(const tools::SceneModel& model) {
  bake::Scene scene;
  scene.name = model.name;
  for (const tools::SceneMaterial& m : model.materials)
    scene.materials.push_back({.name = m.name, .base_color = m.base_color, .metallic = 0, .emission = m.radiance});
  for (const tools::SceneNode& node : model.nodes)
    for (const tools::ScenePart& part : node.parts) {
      const auto first = static_cast<uint32_t>(scene.positions.size());
      for (const Vec3& p : part.positions) scene.positions.push_back(p * model.scale);
      for (size_t i = 0; i + 2 < part.indices.size(); i += 3)
        scene.triangles.push_back(
            {{first + part.indices[i], first + part.indices[i + 1], first + part.indices[i + 2]}, part.material});
    }
  return scene;
}

}  // namespace ff::chart
