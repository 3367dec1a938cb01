#include <algorithm>
#include <cmath>
#include <utility>

#include "bake/import/validate.h"

namespace ff::bake::gltf {
namespace {

constexpr double kUnitTolerance = 0.01;  // of a quaternion's squared length; it is normalised within
constexpr uint32_t kNoNode = 0xffffffffu;

GpuInstancing validateInstancing(const Item& instancing, const std::vector<AccessorFacts>& accessors) {
  const auto attributes = instancing.object("attributes");
  if (!attributes) refuse(instancing.place(), "attributes is missing");
  GpuInstancing kept;
  uint64_t count = 0;
  for (const auto& [name, kept_as] : {std::pair{"TRANSLATION", &kept.translation}, {"ROTATION", &kept.rotation}, {"SCALE", &kept.scale}}) {
    const auto accessor = attributes->reference(name, accessors.size(), "accessor");
    if (!accessor) continue;
    const AccessorFacts& f = accessors[*accessor];
    const bool rotation = name[0] == 'R';
    const bool fits = f.type == (rotation ? "VEC4" : "VEC3") &&
                      (f.component_type == 5126 ||
                       (rotation && f.normalized && (f.component_type == 5120 || f.component_type == 5122)));
    if (!fits)
      refuse(instancing.place(), std::string(name) + ": accessor " + std::to_string(*accessor) + " has type " + f.type +
                                     " of component type " + std::to_string(f.component_type));
    if (!f.has_data)
      refuse(instancing.place(), std::string(name) + ": accessor " + std::to_string(*accessor) + " has no data");
    if (count && f.count != count) refuse(instancing.place(), "attributes of different counts");
    count = f.count;
    *kept_as = static_cast<int>(*accessor);
  }
  if (kept.translation < 0 && kept.rotation < 0 && kept.scale < 0) refuse(instancing.place(), "has neither TRANSLATION nor ROTATION nor SCALE");
  return kept;
}

// Parents are unique by now, so that walking up from any node either ends at a root or runs into a cycle.
void refuseCycles(const std::vector<uint32_t>& parent) {
  std::vector<uint32_t> seen_from(parent.size(), kNoNode);
  for (uint32_t start = 0; start < parent.size(); ++start)
    for (uint32_t node = start; node != kNoNode && seen_from[node] != start; node = parent[node]) {
      if (seen_from[node] != kNoNode) break;  // joins a path that is known to end
      seen_from[node] = start;
      if (parent[node] != kNoNode && seen_from[parent[node]] == start)
        refuse("node " + std::to_string(node), "is part of a cycle of children");
    }
}

}  // namespace

Matrix validateTransform(const Item& item) {
  if (const auto matrix = item.numbers("matrix", 16); !matrix.empty()) {
    for (const char* key : {"translation", "rotation", "scale"})
      if (item.has(key)) refuse(item.place(), "has both matrix and " + std::string(key));
    if (matrix[3] != 0 || matrix[7] != 0 || matrix[11] != 0 || matrix[15] != 1)
      refuse(item.place(), "the last row of matrix must be 0, 0, 0, 1");
    Matrix m;
    std::copy(matrix.begin(), matrix.end(), m.begin());
    return m;
  }
  auto t = item.numbers("translation", 3), q = item.numbers("rotation", 4), s = item.numbers("scale", 3);
  if (t.empty()) t = {0, 0, 0};
  if (s.empty()) s = {1, 1, 1};
  if (q.empty()) {
    q = {0, 0, 0, 1};
  } else {
    const double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if (!(std::fabs(squared - 1) < kUnitTolerance)) refuse(item.place(), "rotation must be a unit quaternion");
    for (double& x : q) x /= std::sqrt(squared);
  }
  return compose(t.data(), q.data(), s.data());
}

std::vector<NodeFacts> validateNodes(const Item& file, const std::vector<AccessorFacts>& accessors, size_t mesh_count,
                   std::vector<uint32_t>& roots) {
  const auto items = file.items("nodes", "node");
  std::vector<uint32_t> parent(items.size(), kNoNode);
  std::vector<NodeFacts> out(items.size());
  for (uint32_t i = 0; i < items.size(); ++i) {
    const Item& item = items[i];
    NodeFacts& node = out[i];
    node.local = validateTransform(item);
    if (const auto mesh = item.reference("mesh", mesh_count, "mesh")) node.mesh = static_cast<int>(*mesh);
    auto children = item.references("children", items.size(), "node");
    for (const uint32_t child : children) {
      if (child == i) refuse(item.place(), "is its own child");
      if (parent[child] != kNoNode)
        refuse("node " + std::to_string(child),
               "is a child twice, of node " + std::to_string(parent[child]) + " and of node " + std::to_string(i));
      parent[child] = i;
    }
    node.children = std::move(children);
    if (const auto instancing = item.extension("EXT_mesh_gpu_instancing"))
      node.instancing = validateInstancing(*instancing, accessors);
    if (const auto visibility = item.extension("KHR_node_visibility"))
      if (visibility->has("visible")) node.visible = visibility->flag("visible");
  }
  refuseCycles(parent);

  const auto scenes = file.items("scenes", "scene");
  const auto chosen = file.reference("scene", scenes.size(), "scene");
  std::vector<std::vector<uint32_t>> lists;
  std::vector<size_t> listed_by(items.size(), 0);
  for (const Item& scene : scenes) {
    lists.push_back(scene.references("nodes", items.size(), "node"));
    std::vector<uint32_t>& list = lists.back();
    for (const uint32_t node : list) {
      if (parent[node] != kNoNode)
        refuse(scene.place(),
               "lists node " + std::to_string(node) + ", which is a child of node " + std::to_string(parent[node]));
      if (listed_by[node] == lists.size()) refuse(scene.place(), "lists node " + std::to_string(node) + " twice");
      listed_by[node] = lists.size();
    }
  }
  if (!lists.empty()) {
    roots = lists[chosen.value_or(0)];
  } else {
    for (uint32_t i = 0; i < items.size(); ++i)
      if (parent[i] == kNoNode) roots.push_back(i);
  }
  return out;
}

}  // namespace ff::bake::gltf
