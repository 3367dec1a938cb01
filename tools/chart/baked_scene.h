// A scene baked for measuring: the open world and its files in a temporary folder that goes with it.
#pragma once
#include <memory>
#include <string>

#include "bake/bake.h"
#include "formats/read/whole_world.h"

namespace ff::chart {

class BakedScene {
 public:
  // Errors: those of the bake; kIo where there is no temporary folder.
  static Result<BakedScene> bake(const bake::Scene& scene, const bake::BakeSettings& settings);
  BakedScene(BakedScene&&) noexcept;
  BakedScene& operator=(BakedScene&&) noexcept;
  ~BakedScene();

  const formats::WholeWorld& world() const { return *world_; }
  const bake::BakeStats& stats() const { return stats_; }

 private:
  BakedScene() = default;
  std::string folder_;
  std::unique_ptr<formats::WholeWorld> world_;
  bake::BakeStats stats_;
};

}  // namespace ff::chart
