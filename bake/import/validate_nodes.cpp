#include <cmath>

#include "bake/import/validate.h"

namespace ff::bake::gltf {
namespace {

constexpr double kUnitTolerance = 0.01;  // of a quaternion's squared length; it is normalised within
constexpr uint32_t kNoNode = 0xffffffffu;

Json validateInstancing(const Item& instancing, const std::vector<AccessorFacts>& accessors) {
  const auto attributes = instancing.object("attributes");
  if (!attributes) refuse(instancing.place(), "attributes is missing");
  Json kept = Json::object();
  uint64_t count = 0;
  for (const char* name : {"TRANSLATION", "ROTATION", "SCALE"}) {
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
    kept[name] = *accessor;
  }
  if (kept.empty()) refuse(instancing.place(), "has neither TRANSLATION nor ROTATION nor SCALE");
  return {{"attributes", std::move(kept)}};
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

void validateTransform(const Item& item, Json& validated) {
  if (const auto matrix = item.numbers("matrix", 16); !matrix.empty()) {
    for (const char* key : {"translation", "rotation", "scale"})
      if (item.has(key)) refuse(item.place(), "has both matrix and " + std::string(key));
    if (matrix[3] != 0 || matrix[7] != 0 || matrix[11] != 0 || matrix[15] != 1)
      refuse(item.place(), "the last row of matrix must be 0, 0, 0, 1");
    validated["matrix"] = matrix;
    return;
  }
  for (const char* key : {"translation", "scale"})
    if (const auto v = item.numbers(key, 3); !v.empty()) validated[key] = v;
  if (auto q = item.numbers("rotation", 4); !q.empty()) {
    const double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if (!(std::fabs(squared - 1) < kUnitTolerance)) refuse(item.place(), "rotation must be a unit quaternion");
    for (double& x : q) x /= std::sqrt(squared);
    validated["rotation"] = q;
  }
}

Json validateNodes(const Item& file, const std::vector<AccessorFacts>& accessors, size_t mesh_count,
                   std::vector<uint32_t>& roots) {
  const auto items = file.items("nodes", "node");
  std::vector<uint32_t> parent(items.size(), kNoNode);
  Json out = Json::array();
  for (uint32_t i = 0; i < items.size(); ++i) {
    const Item& item = items[i];
    Json validated = Json::object();
    validateTransform(item, validated);
    if (const auto mesh = item.reference("mesh", mesh_count, "mesh")) validated["mesh"] = *mesh;
    const auto children = item.references("children", items.size(), "node");
    for (const uint32_t child : children) {
      if (child == i) refuse(item.place(), "is its own child");
      if (parent[child] != kNoNode)
        refuse("node " + std::to_string(child),
               "is a child twice, of node " + std::to_string(parent[child]) + " and of node " + std::to_string(i));
      parent[child] = i;
    }
    if (!children.empty()) validated["children"] = children;
    if (const auto instancing = item.extension("EXT_mesh_gpu_instancing"))
      validated["extensions"]["EXT_mesh_gpu_instancing"] = validateInstancing(*instancing, accessors);
    if (const auto visibility = item.extension("KHR_node_visibility"))
      if (visibility->has("visible"))
        validated["extensions"]["KHR_node_visibility"]["visible"] = visibility->flag("visible");
    out.push_back(std::move(validated));
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
