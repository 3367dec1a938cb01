// Light of flat emitters in closed form: the truth where nothing stands between them and the surface.
#pragma once
#include <vector>

#include "bake/scene.h"
#include "formats/read/whole_world.h"

namespace ff::chart {

class AreaLight {
 public:
  // Every triangle of the scene that emits, from its front alone and by its material's factor, without textures.
  explicit AreaLight(const bake::Scene& scene);

  // Irradiance of a point whose surface faces along the unit `normal`, W/m2, shadows left out: exact for each triangle, which is
  // cut at the point's horizon. Lambert. Photometria. 1760; Baum, Rushmeier, Winget. Improving Radiosity Solutions Through
  // the Use of Analytically Determined Form-Factors. 1989, equation 6.
  Vec3 irradianceAt(Vec3 point, Vec3 normal) const;
  // Its mean over each patch's drawing geometry, by midpoints of pieces that are small beside their distance from the
  // nearest emitter. Errors: unreadable geometry.
  Result<std::vector<Vec3>> irradianceOfPatches(const formats::WholeWorld& world) const;

 private:
  struct Emitter {
    Vec3 corner[3], normal, radiance;
  };
  std::vector<Emitter> emitters_;
};

}  // namespace ff::chart
