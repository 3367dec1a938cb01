// Scenes whose light is known in closed form. Lengths in metres; surfaces are single-sided and face the air they enclose.
#pragma once
#include "tools/scene/model.h"

namespace ff::tools {

// A closed unit cube seen from inside. Radiosity everywhere: emission / (1 - albedo).
SceneModel furnaceBox(float albedo, float emission_w_m2);

// Unit squares that face each other, `gap` apart: F = 0.199824895698 at gap 1. Howell. A Catalog of Radiation Heat
// Transfer Configuration Factors. C-11.
SceneModel parallelPlates(float gap, float albedo, float emission_w_m2);

// Unit squares with a common edge at a right angle: F = 0.200043776075. Howell, C-14.
SceneModel perpendicularPlates(float albedo, float emission_w_m2);

// Coaxial discs of radius 1 that face each other: F = 0.381966011250 at gap 1. Howell, C-41. The polygons have the area of
// the disc, so the error shrinks with the square of `segments`. The first plate or disc shines.
SceneModel coaxialDiscs(float gap, int segments, float albedo, float emission_w_m2);

// A cap of the unit sphere around the axis +y, seen from inside: every point sees the cap with F = (1 - cos(half angle)) / 2.
SceneModel sphericalCap(float half_angle_degrees, int segments, float albedo, float emission_w_m2);

// Two closed rooms of 4 x 3 x 4 m on both sides of a wall `wall_m` thick; only the first has a lamp in its ceiling. Whatever
// light reaches the second has leaked.
SceneModel twoRooms(float wall_m, float albedo, float emission_w_m2);

// A closed corridor of 2 x 2 x 20 m; one end shines.
SceneModel corridor(float albedo, float emission_w_m2);

}  // namespace ff::tools
