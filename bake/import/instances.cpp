#include "bake/import/instances.h"

#include <cmath>

#include "bake/import/elements.h"

namespace ff::bake::gltf {
namespace {

// EXT_mesh_gpu_instancing: each instance's own transform comes before the node's.
void addGpuInstances(const Document& document, const GpuInstancing& instancing, const Instance& node,
                     std::vector<Instance>& out, Budget& budget) {
  const auto find = [&](int accessor) -> std::optional<Elements> {
    if (accessor < 0) return {};
    return Elements(document, accessor);
  };
  const auto translation = find(instancing.translation), rotation = find(instancing.rotation), scale = find(instancing.scale);
  const uint64_t count = translation ? translation->count() : rotation ? rotation->count() : scale->count();
  const std::string place = "node " + std::to_string(node.node);
  budget.take(count * 2 * sizeof(Instance), place);
  for (uint64_t i = 0; i < count; ++i) {
    double t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    for (uint32_t c = 0; c < 3; ++c) {
      if (translation) t[c] = translation->value(i, c);
      if (scale) s[c] = scale->value(i, c);
    }
    if (rotation) {
      double squared = 0;
      for (uint32_t c = 0; c < 4; ++c) q[c] = rotation->value(i, c), squared += q[c] * q[c];
      if (!(std::fabs(squared - 1) < 0.1))  // 8-bit quaternions are this coarse
        refuse(place, "instance " + std::to_string(i) + " has no unit quaternion");
      for (double& c : q) c /= std::sqrt(squared);
    }
    out.push_back({multiply(node.to_world, compose(t, q, s)), node.node});
  }
}

}  // namespace

std::vector<std::vector<Instance>> listInstances(const Document& document, const Matrix& root, Budget& budget,
                                                 std::vector<Instance>& lights) {
  std::vector<std::vector<Instance>> out(document.model.meshes.size());
  std::vector<Instance> stack;
  for (size_t i = document.roots.size(); i-- > 0;) stack.push_back({root, static_cast<int>(document.roots[i])});
  while (!stack.empty()) {
    const Instance parent = stack.back();
    stack.pop_back();
    const NodeFacts& node = document.nodes[static_cast<size_t>(parent.node)];
    if (!node.visible) continue;
    const Instance here{multiply(parent.to_world, node.local), parent.node};
    for (const double v : here.to_world)
      if (!std::isfinite(v)) refuse("node " + std::to_string(here.node), "its world transform overflows");
    if (document.lights.of_node.count(static_cast<uint32_t>(here.node))) lights.push_back(here);
    if (node.mesh >= 0) {
      auto& list = out[static_cast<size_t>(node.mesh)];
      if (node.instancing)
        addGpuInstances(document, *node.instancing, here, list, budget);
      else
        list.push_back(here);
    }
    for (size_t i = node.children.size(); i-- > 0;) stack.push_back({here.to_world, static_cast<int>(node.children[i])});
  }
  return out;
}

}  // namespace ff::bake::gltf
