#include "bake/import/objects.h"

#include "bake/scene.h"

namespace ff::bake::gltf {
namespace {

Traits readTraits(const Item& item) {
  Traits traits;
  if (!item.has("extras") || !item.json()["extras"].is_object()) return traits;  // anything may stand there
  const auto ours = item.object("extras")->object("formfield");
  if (!ours) return traits;
  const std::string place = item.place() + " extras.formfield";
  for (const auto& [key, value] : ours->json().items())
    if (key != "include" && key != "occlude_only" && key != "density" && key != "lamp")
      refuse(place, "\"" + printable(key) + "\" is unknown", "it knows include, occlude_only, density and lamp");
  if (ours->has("include")) traits.include = ours->flag("include");
  if (ours->has("occlude_only")) traits.occlude_only = ours->flag("occlude_only");
  if (ours->has("lamp")) traits.lamp = ours->text("lamp");
  if (const auto density = ours->number("density")) {
    constexpr double kMost = static_cast<double>(kLargestDensity);
    if (!(*density >= 1 / kMost && *density <= kMost)) refuse(place, "density must be 1/16 to 16");
    traits.density = static_cast<float>(*density);
  }
  return traits;
}

}  // namespace

Traits merged(const Traits& over, const Traits& under) {
  return {over.include ? over.include : under.include, over.occlude_only ? over.occlude_only : under.occlude_only,
          over.density ? over.density : under.density, over.lamp ? over.lamp : under.lamp};
}

Objects readObjects(const Item& file) {
  Objects out;
  for (const Item& item : file.items("materials", "material")) {
    out.materials.push_back(readTraits(item));
    out.unlit.push_back(item.extension("KHR_materials_unlit").has_value());
  }
  for (const Item& item : file.items("meshes", "mesh")) {
    out.meshes.push_back(readTraits(item));
    out.mesh_names.push_back(printable(item.has("name") ? item.text("name") : ""));
  }
  const auto nodes = file.items("nodes", "node");
  std::vector<std::vector<uint32_t>> children;
  std::vector<bool> is_child(nodes.size());
  for (const Item& item : nodes) {
    out.nodes.push_back(readTraits(item));
    out.node_names.push_back(printable(item.has("name") ? item.text("name") : ""));
    children.push_back(item.references("children", nodes.size(), "node"));
    for (const uint32_t child : children.back()) is_child[child] = true;
  }
  std::vector<uint32_t> stack;
  for (uint32_t i = 0; i < nodes.size(); ++i)
    if (!is_child[i]) stack.push_back(i);
  while (!stack.empty()) {
    const uint32_t parent = stack.back();
    stack.pop_back();
    for (const uint32_t child : children[parent]) {
      out.nodes[child] = merged(out.nodes[child], out.nodes[parent]);
      stack.push_back(child);
    }
  }
  return out;
}

}  // namespace ff::bake::gltf
