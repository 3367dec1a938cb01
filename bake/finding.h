// What a bake finds odd about a scene, or leaves out of it: one kind, how much of it there is, and where.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "formats/vec3.h"

namespace ff::bake {

struct FoundPlace {
  std::optional<std::array<double, 3>> at{};  // m, in the world; nothing: nowhere
  std::string name{};                         // of what is there: its object, its material
  double share = 0;                           // of all that the finding is about; 0: not known
};

struct Finding {
  std::string kind;             // for programs: "leaks", "slivers", "duplicates", "overlaps", "open_edges", "not_modelled", "sky_dome", "density"
  std::string what;             // for people
  uint64_t count = 0;
  std::string counted{};        // what there are `count` of: "triangles"; empty: nothing is counted
  double share = 0;
  std::string share_of{};       // "surface", "light", "triangles"; empty: of nothing
  std::vector<FoundPlace> places{};  // the heaviest first: kMaxPlaces, or every material of what is not modelled
  uint64_t more_places = 0;     // that are not among them
  std::string remedy{};
};

inline constexpr size_t kMaxPlaces = 3;

// A sum, and where the heaviest part of it is: the first of those that are as heavy.
struct HeaviestPlace {
  double sum = 0, heaviest = -1;
  Vec3 at{};
  void add(double weight, Vec3 where) { add({weight, weight, where}); }
  void add(const HeaviestPlace& more) {
    sum += more.sum;
    if (!(more.heaviest > heaviest)) return;
    heaviest = more.heaviest;
    at = more.at;
  }
};

// "1.5 0 -2.25": to the millimetre, as ffinspect locate takes it.
std::string textOf(const std::array<double, 3>& at);
// "0.12 %"
std::string percent(double share);
// "1 triangle", "2 triangles"
std::string counted(uint64_t n, const char* thing);
// All of it but the kind. Names in it are the file's own and may hold any character.
std::string lineOf(const Finding& finding);

}  // namespace ff::bake
