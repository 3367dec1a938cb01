// A scene baked for one test, with the truth's tracer on it.
#pragma once
#include <gtest/gtest.h>

#include <memory>
#include <utility>

#include "tests/support/random_world.h"
#include "tools/chart/sweep/measured_world.h"

namespace ff::chart {

class InABakedScene : public testing::Test {
 protected:
  void open(bake::Scene scene, float cell_m, uint32_t rays) {
    scene_ = std::move(scene);
    if (scene_.name.empty()) scene_.name = "scene";
    const std::string path = folder_.file("world.ffm");
    const auto baked = bake::bakeWorld(scene_, {.cell_m = cell_m, .rays = rays, .threads = 1}, path);
    ASSERT_TRUE(baked) << baked.error().line();
    auto opened = MeasuredWorld::open(scene_, path);
    ASSERT_TRUE(opened) << opened.error().line();
    world_ = std::make_unique<MeasuredWorld>(std::move(*opened));
  }

  bake::Scene scene_;  // the tracer keeps its address
  formats::TemporaryFolder folder_;
  std::unique_ptr<MeasuredWorld> world_;
};

}  // namespace ff::chart
