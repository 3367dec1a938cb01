// KHR_lights_punctual: definitions, and the nodes that hold them. Private to this folder.
//
// Units: the extension's candela and lux are taken as W/sr and W/m2, one for one, as the candela per m2 of
// KHR_materials_emissive_strength are taken as W/(m2 sr): lights and emissive surfaces of one file keep their ratio.
#pragma once
#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "bake/import/json.h"
#include "formats/model.h"

namespace ff::bake::gltf {

struct Lights {
  std::map<uint32_t, formats::Light> of_node;  // named, in the node's own coordinates: at the origin, towards -z
  std::vector<std::string> left_alone;         // see Scene::left_alone
};

// Refuses what is malformed; a light of an unknown kind is left alone.
Lights readLights(const Item& file, std::vector<std::string>& warnings);

// The light of a node where it stands (column-major matrix, last row 0 0 0 1): scale does not count. Refuses a place
// beyond 1e9 m. Nothing, and a warning: a scale of 0 has made away with its direction.
std::optional<formats::Light> placed(formats::Light light, const std::array<double, 16>& to_world, const std::string& place,
                                     std::vector<std::string>& warnings);

}  // namespace ff::bake::gltf
