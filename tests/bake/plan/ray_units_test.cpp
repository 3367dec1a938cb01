// A bake that takes what it can from the cache is, byte for byte, the bake that casts all rays.
#include "bake/plan/ray_units.h"

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>

#include <cstring>
#include <filesystem>
#include <iostream>
#include <random>

#include "bake/bake.h"
#include "tests/support/analytic_scenes.h"
#include "tests/support/random_world.h"
#include "tests/support/town_scene.h"

namespace ff::bake {
namespace {

constexpr uint32_t kFewRays = 64;
const RayBudget kAsked{1024, 0.05f};  // many groups need more than the least

bool equal(const HitRows& a, const HitRows& b) {
  const auto same_bytes = [](const auto& x, const auto& y) { return x.size() == y.size() && (x.empty() || std::memcmp(x.data(), y.data(), x.size() * sizeof x[0]) == 0); };
  if (a.lamps.size() != b.lamps.size()) return false;
  for (size_t i = 0; i < a.lamps.size(); ++i) {
    if (a.lamps[i].size() != b.lamps[i].size()) return false;
    for (size_t k = 0; k < a.lamps[i].size(); ++k)
      if (a.lamps[i][k].group != b.lamps[i][k].group || a.lamps[i][k].rgb != b.lamps[i][k].rgb) return false;
  }
  return a.rays == b.rays && a.start == b.start && a.column == b.column && a.count == b.count && a.estimate == b.estimate && a.whole == b.whole && a.sky == b.sky && a.absorbed == b.absorbed &&
         a.buried == b.buried && a.narrow == b.narrow && same_bytes(a.sky_fraction, b.sky_fraction) && same_bytes(a.square_error, b.square_error) && same_bytes(a.sky_means, b.sky_means) && same_bytes(a.leaks, b.leaks);
}

struct Cast {
  CachedRays counts;
  HitRows rows;
};

// From the cache what is there; compared with all rays cast.
Cast castBoth(const Scene& scene, float cell_m, BakeCache& cache, const std::string& what, RayBudget budget = kFewRays) {
  const auto caster = RayCaster::create(scene);
  EXPECT_TRUE(caster);
  const auto set = makePatches(scene, {.cell_m = cell_m}, &*caster);
  EXPECT_TRUE(set) << set.error().line();
  WorkCount done;
  Cast cast;
  RayUnits units(scene, *set, *caster, budget, 1, cache);
  std::vector<Vec3> changed;
  const CachedRays before = units.status(done, changed);
  cast.rows = gathered([&](const TakeRows& take) { units.cast(done, cast.counts, take); });
  EXPECT_EQ(before.rows.clean, cast.counts.rows.clean);
  EXPECT_EQ(before.rows.stale, cast.counts.rows.stale);
  EXPECT_EQ(before.lamps.clean, cast.counts.lamps.clean);
  EXPECT_EQ(before.lamps.stale, cast.counts.lamps.stale);
  EXPECT_TRUE(equal(cast.rows, castRows(scene, *set, *caster, budget, 1, done))) << what;
  CachedRays again;
  EXPECT_TRUE(equal(cast.rows, gathered([&](const TakeRows& take) { units.cast(done, again, take); }))) << what << ", again";
  EXPECT_EQ(again.rows.clean, again.patches()) << what;
  EXPECT_EQ(again.lamps.clean, again.patches()) << what;
  return cast;
}

std::unique_ptr<BakeCache> cacheIn(const std::string& folder, uint64_t limit = uint64_t{1} << 30) {
  auto cache = BakeCache::open(folder, limit);
  EXPECT_TRUE(cache) << cache.error().line();
  return std::move(*cache);
}

// What may have changed since the last bake, and must not go unnoticed.
void edit(Scene& scene, const Box& all, std::mt19937& random, std::string& what) {
  const auto place = [&](float beyond) {
    std::uniform_real_distribution<float> part(-beyond, 1 + beyond);
    return Vec3{all.lo.x + part(random) * (all.hi.x - all.lo.x), all.lo.y + part(random) * (all.hi.y - all.lo.y), all.lo.z + part(random) * (all.hi.z - all.lo.z)};
  };
  const auto some = [&] { return static_cast<uint32_t>(random() % scene.triangles.size()); };
  const Vec3 at = place(0);
  const auto someMaterial = [&] { return static_cast<uint32_t>(random() % scene.materials.size()); };
  switch (random() % 11) {
    case 0: what = "a sheet"; test::addTriangle(scene, at, at + Vec3{3, 0, 1}, at + Vec3{0, 2, 2}, 0); break;
    case 1: what = "a hair's breadth of a sheet"; test::addTriangle(scene, at, at + Vec3{0.01f, 0, 0}, at + Vec3{0, 0, 6}, 0); break;
    case 2: what = "something outside of the world"; { const Vec3 far = place(0.5f); test::addTriangle(scene, far, far + Vec3{9, 0, 0}, far + Vec3{0, 9, 9}, 0); } break;
    case 3: what = "a triangle less"; scene.triangles.erase(scene.triangles.begin() + some()); break;
    case 4: what = "a corner moved"; scene.positions[scene.triangles[some()].v[random() % 3]].y += 0.4f; break;
    case 5: what = "another order"; std::swap(scene.triangles[some()], scene.triangles[some()]); break;
    case 6: what = "another emission"; scene.materials[someMaterial()].emission = place(0); break;
    case 7: what = "no emission"; for (Material& m : scene.materials) if (random() % 2) m.emission = {}; break;
    case 8: what = "a lamp"; scene.materials[someMaterial()].emission = {1, 2, 3}; [[fallthrough]];
    case 9: what += "a block"; test::addBlock(scene, at, at + Vec3{.4f, .4f, .4f}, someMaterial()); break;
    default:
      what = "a veil";
      scene.materials.push_back(scene.materials[0]);
      scene.materials.back().cutout = scene.materials.back().blend = scene.materials.back().double_sided = true;
      scene.materials.back().alpha = 0.5f;
      test::addTriangle(scene, at, at + Vec3{5, 0, 0}, at + Vec3{0, 5, 1}, static_cast<uint32_t>(scene.materials.size()) - 1);
  }
}

TEST(RayUnits, AfterAnyEditGiveWhatAllRaysWouldFind) {
  const formats::TemporaryFolder folder;
  Scene scene = test::townScene(folder, 3000);
  Box all;
  for (const Vec3 p : scene.positions) all.add(p);
  const auto cache = cacheIn(folder.file("cache"));
  EXPECT_EQ(castBoth(scene, 1, *cache, "the first bake").counts.rows.clean, 0u);
  std::mt19937 random(3);
  uint64_t clean = 0, stale = 0, lit = 0, patches = 0;
  for (int round = 0; round < 24; ++round) {
    const RayBudget budget = round < 20 ? RayBudget(kFewRays) : kAsked;
    std::string what;
    Scene edited = scene;
    edit(edited, all, random, what);
    const CachedRays counts = castBoth(edited, 1, *cache, what, budget).counts;
    clean += counts.rows.clean;
    stale += counts.rows.stale;
    lit += counts.lamps.clean;
    patches += counts.patches();
    if (round % 3 == 0) scene = std::move(edited);  // or back again
  }
  std::cout << clean << " patches of " << patches << " were clean, " << stale << " stale; the light of lamps of " << lit << " was\n";
  EXPECT_GT(clean, patches / 8);
  EXPECT_GT(stale, 0u);
}

// What rays stand for goes by all of a patch that they meet, also where they do not come.
TEST(RayUnits, AfterAChangeAtTheFarEndOfALargePatchGiveWhatAllRaysWouldFind) {
  const formats::TemporaryFolder folder;
  const auto scene = [](bool whole) {
    Scene s;
    const uint32_t ground = test::addMaterial(s, {.5f, .5f, .5f}), hood = test::addMaterial(s, {.5f, .5f, .5f});
    s.materials[ground].density = 0.125f;  // patches of 8 cells
    test::addQuad(s, {1, 0, 0}, {1, 0, 8}, {8, 0, 8}, {8, 0, 0}, ground);
    if (whole) test::addQuad(s, {0, 0, 0}, {0, 0, 8}, {1, 0, 8}, {1, 0, 0}, ground);
    const auto p = [](int x, int y, int z) { return Vec3{x ? 6.9f : 5.1f, y ? 1.0f : 0.15f, z ? 6.9f : 5.1f}; };  // above the ground, higher than what parts it, seen from inside
    test::addQuad(s, p(0, 1, 0), p(1, 1, 0), p(1, 1, 1), p(0, 1, 1), hood);
    test::addQuad(s, p(0, 0, 0), p(0, 1, 0), p(0, 1, 1), p(0, 0, 1), hood);
    test::addQuad(s, p(1, 0, 0), p(1, 0, 1), p(1, 1, 1), p(1, 1, 0), hood);
    test::addQuad(s, p(0, 0, 0), p(1, 0, 0), p(1, 1, 0), p(0, 1, 0), hood);
    test::addQuad(s, p(0, 0, 1), p(0, 1, 1), p(1, 1, 1), p(1, 0, 1), hood);
    return s;
  };
  const auto cache = cacheIn(folder.file("cache"));
  const Cast before = castBoth(scene(true), 1, *cache, "whole ground");
  EXPECT_GT(std::count_if(before.rows.estimate.begin(), before.rows.estimate.end(), [](uint32_t e) { return e > 0; }), 0);
  const Cast after = castBoth(scene(false), 1, *cache, "less ground");
  EXPECT_EQ(before.rows.rays.size(), after.rows.rays.size());
  EXPECT_EQ(after.counts.rows.missing, 1u);  // the ground itself
}

TEST(RayUnits, CastAgainOnlyTheGroupsThatAnEditMeets) {
  const formats::TemporaryFolder folder;
  Scene scene;
  const uint32_t ground = test::addMaterial(scene, {.5f, .5f, .5f});
  test::addQuad(scene, {0, 0, 0}, {0, 0, 16}, {16, 0, 16}, {16, 0, 0}, ground);  // one unit: 256 patches, 16 groups
  const auto cache = cacheIn(folder.file("cache"));
  EXPECT_EQ(castBoth(scene, 1, *cache, "open ground", 32).counts.rows.missing, 256u);
  test::addTriangle(scene, {-20, 3, -20}, {-19, 3, -20}, {-20, 3, -19}, ground);
  const CachedRays counts = castBoth(scene, 1, *cache, "a kite", 32).counts;
  std::cout << counts.rows.stale << " of 256 patches were stale\n";
  EXPECT_EQ(counts.rows.stale % 16, 0u);
  EXPECT_GT(counts.rows.stale, 0u);
  EXPECT_LT(counts.rows.stale, 200u);
  EXPECT_GE(counts.rows.clean, 56u);
}

TEST(RayUnits, NoticeWhatComesToStandWhereTheirRaysLeftTheWorld) {
  const formats::TemporaryFolder folder;
  Scene scene;
  const uint32_t ground = test::addMaterial(scene, {.5f, .5f, .5f});
  test::addQuad(scene, {0, 0, 0}, {0, 0, 20}, {20, 0, 20}, {20, 0, 0}, ground);
  const auto cache = cacheIn(folder.file("cache"));
  castBoth(scene, 1, *cache, "open ground");
  test::addQuad(scene, {0, 300, 0}, {30, 300, 0}, {30, 300, 30}, {0, 300, 30}, ground);
  const CachedRays counts = castBoth(scene, 1, *cache, "a roof far above").counts;
  EXPECT_EQ(counts.rows.clean, 0u);
  EXPECT_GT(counts.rows.stale, 0u);
}

TEST(RayUnits, KeepRaysThatLeftAWorldBySidesWhereItHasNotGrown) {
  const formats::TemporaryFolder folder;
  Scene shed = test::closedBox({.5f, .5f, .5f}, {});
  shed.triangles.resize(shed.triangles.size() - 2);  // open towards z
  const auto cache = cacheIn(folder.file("cache"));
  const auto withBlockAt = [&](Vec3 at) {
    Scene scene = shed;
    test::addBlock(scene, at, at + Vec3{1, 1, 1}, 0);
    return castBoth(scene, 0.25f, *cache, "a block far off").counts;
  };
  const CachedRays first = castBoth(shed, 0.25f, *cache, "a shed").counts;
  EXPECT_EQ(first.rows.missing, 80u);
  EXPECT_EQ(withBlockAt({0, 0, -40}).rows.clean, 80u);  // behind it
  EXPECT_GE(withBlockAt({40, 0, 0}).rows.clean, 20u);   // beside it: those deep inside
  EXPECT_GE(withBlockAt({0, 0, 40}).rows.stale, 60u);
}

TEST(RayUnits, NoticeWhatVeilsAreMadeOf) {
  const formats::TemporaryFolder folder;
  Scene scene = test::closedBox({.5f, .5f, .5f}, {});
  const uint32_t lamp = test::addMaterial(scene, {.5f, .5f, .5f}, {1, 1, 1}), veil = test::addMaterial(scene, {.5f, .5f, .5f});
  scene.materials[veil].cutout = scene.materials[veil].blend = true;
  scene.materials[veil].alpha = 0.25f;
  test::addQuad(scene, {.4f, .9f, .4f}, {.6f, .9f, .4f}, {.6f, .9f, .6f}, {.4f, .9f, .6f}, lamp);
  test::addQuad(scene, {.2f, .5f, .2f}, {.2f, .5f, .8f}, {.8f, .5f, .8f}, {.8f, .5f, .2f}, veil);
  const auto cache = cacheIn(folder.file("cache"));
  const auto expectClean = [&](const char* what, bool clean) {
    const CachedRays counts = castBoth(scene, 0.1f, *cache, what).counts;
    EXPECT_GT(counts.patches(), 1u);
    EXPECT_EQ(counts.rows.clean, clean ? counts.patches() : 0) << what;
    EXPECT_EQ(counts.lamps.clean, clean ? counts.patches() : 0) << what;
  };
  expectClean("the first", false);
  scene.materials[0].base_color = {.9f, .2f, .2f};
  expectClean("another colour", true);
  scene.materials[veil].alpha = 0.75f;
  expectClean("another veil", false);
  scene.backs = Backs::kPass;
  expectClean("other backs", false);
}

// Two rooms of 4 m, 40 m apart: what changes in the first one leaves the rows of the second as they are.
struct Rooms {
  Vec3 lamp_at{1, 1.5f, 1};
  Vec3 radiance{1, 1, 1};
  bool second_lamp = true;  // in the first room
  Vec3 table_radiance{};
};
Scene scene(const Rooms& rooms) {
  Scene s;
  const uint32_t walls = test::addMaterial(s, {.5f, .5f, .5f}), table = test::addMaterial(s, {.5f, .5f, .5f}, rooms.table_radiance),
                 far_lamp = test::addMaterial(s, {.5f, .5f, .5f}, {1, 1, 1}), near_lamp = test::addMaterial(s, {.5f, .5f, .5f}, rooms.radiance);
  for (const float x : {0.0f, 40.0f}) {
    test::addRoom(s, {x, 0, 0}, {x + 4, 3, 4}, walls, walls);
    test::addBlock(s, {x + 2.5f, 0, 2.5f}, {x + 3.5f, 1, 3.5f}, x > 0 ? walls : table, false);
  }
  const auto addLamp = [&](Vec3 at, uint32_t material) { test::addQuad(s, at, at + Vec3{.5f, 0, 0}, at + Vec3{.5f, 0, .5f}, at + Vec3{0, 0, .5f}, material); };  // shines down
  addLamp(rooms.lamp_at, near_lamp);
  if (rooms.second_lamp) addLamp({3, 1.5f, 1}, near_lamp);
  addLamp({41, 1.5f, 1}, far_lamp);
  return s;
}

TEST(RayUnits, KeepRowsThatNoChangeOfALampMeets) {
  const formats::TemporaryFolder folder;
  const auto cache = cacheIn(folder.file("cache"));
  const uint64_t patches = castBoth(scene(Rooms{}), 0.5f, *cache, "as it was").counts.patches();
  // From one to the next. rows: those of the first room are clean, too. up: what has changed shines upwards as well.
  const auto expect = [&](const char* what, const Rooms& rooms, bool clean, bool up = false) {
    SCOPED_TRACE(what);
    const CachedRays counts = castBoth(scene(rooms), 0.5f, *cache, what).counts;
    std::cout << what << ": of " << counts.patches() << " patches the rows of " << counts.rows.clean << " were clean, the light of lamps of " << counts.lamps.clean << "\n";
    if (clean) {
      EXPECT_EQ(counts.rows.clean, patches);
    } else {
      EXPECT_LT(counts.rows.clean, counts.patches());
      EXPECT_GE(2 * counts.rows.clean, patches - 8);  // lamps have patches, too
    }
    EXPECT_LT(counts.lamps.clean, counts.patches());
    EXPECT_GE(counts.lamps.clean, up ? 0 : patches / 8);  // of what lies above the lamps
  };
  expect("another colour", {.radiance = {1, 2, 1}}, true);
  expect("switched off", {.radiance = {}}, true);
  expect("switched on", {}, true);
  expect("moved", {.lamp_at = {1.5f, 1.5f, 1}}, false);
  expect("moved back", {}, false);
  expect("one removed", {.second_lamp = false}, false);
  expect("one added", {}, false);
  expect("a table that begins to emit", {.table_radiance = {1, 1, 1}}, false, true);
  expect("and ceases to", {}, true, true);
}

TEST(RayUnits, NoticeWhatComesToStandBetweenAPatchAndALamp) {
  const formats::TemporaryFolder folder;
  const auto cache = cacheIn(folder.file("cache"));
  Scene s;
  const uint32_t ground = test::addMaterial(s, {.5f, .5f, .5f}), lamp = test::addMaterial(s, {.5f, .5f, .5f}, {100, 100, 100});
  test::addQuad(s, {0, 0, 0}, {0, 0, 4}, {4, 0, 4}, {4, 0, 0}, ground);
  test::addBlock(s, {80, 60, 80}, {81, 61, 81}, lamp);  // few rays of rows go there
  castBoth(s, 1, *cache, "a lamp far off", 1);
  test::addBlock(s, {39, 29, 39}, {42, 33, 42}, ground);
  const CachedRays counts = castBoth(s, 1, *cache, "half way there", 1).counts;
  EXPECT_GT(counts.rows.clean, counts.lamps.clean);
}

TEST(RayUnits, AreCastAgainWhereTheCacheIsDamaged) {
  const formats::TemporaryFolder folder;
  const Scene scene = test::closedBox({.5f, .5f, .5f}, {1, 1, 1});
  const auto cache = cacheIn(folder.file("cache"));
  const CachedRays first = castBoth(scene, 0.1f, *cache, "the first").counts;
  std::filesystem::copy(folder.file("cache"), folder.file("removed"));
  std::mt19937 random(5);
  size_t files = 0, damaged = 0;
  for (const auto& file : std::filesystem::directory_iterator(folder.file("cache"))) {
    const std::string path = file.path().string();
    if (file.path().filename().string().starts_with("contents")) continue;
    std::vector<std::byte> bytes = formats::readFile(path);
    if (files++ == 0) continue;
    const int kind = static_cast<int>(1 + random() % 3);
    if (kind == 1) bytes.resize(random() % bytes.size());
    if (kind == 2) bytes[random() % bytes.size()] ^= std::byte{4};
    if (kind == 3) bytes.assign(bytes.size(), std::byte{0});
    formats::writeFile(path, bytes);
    std::filesystem::remove(std::filesystem::path(folder.file("removed")) / file.path().filename());
    ++damaged;
  }
  EXPECT_GT(damaged, 2u);
  const CachedRays second = castBoth(scene, 0.1f, *cache, "after damage").counts;
  EXPECT_EQ(second.rows.stale, 0u);
  EXPECT_EQ(second.rows.missing, castBoth(scene, 0.1f, *cacheIn(folder.file("removed")), "after removal").counts.rows.missing);
  EXPECT_GT(second.rows.clean, 0u);
  EXPECT_EQ(second.rows.missing + second.rows.clean, first.patches());
}

// Ranks of one process: what others ask, a thread of the test answers by what rank 0 was told to serve.
class TestRanks final : public Ranks {
 public:
  int rank() const override { return 0; }
  int size() const override { return 4; }
  void serve(std::function<uint32_t()> next, std::function<void(uint32_t)> done) override {
    const std::lock_guard lock(mutex_);
    next_ = std::move(next);
    done_ = std::move(done);
    serving_.notify_all();
  }
  void endUnits() override {
    const std::lock_guard lock(mutex_);
    next_ = {};
    ended_ = true;
    serving_.notify_all();
  }
  uint32_t ask(uint32_t done) override {
    std::unique_lock lock(mutex_);
    serving_.wait(lock, [&] { return next_ || ended_; });
    if (ended_) return kNoUnit;
    if (done != kNoUnit) done_(done);
    return next_();
  }

 private:
  std::mutex mutex_;
  std::condition_variable serving_;
  std::function<uint32_t()> next_;
  std::function<void(uint32_t)> done_;
  bool ended_ = false;
};

// Another rank: asks as often as `most` says, and is gone then with the unit that it was given.
struct Mortal final : Ranks {
  Mortal(Ranks& of, uint32_t asks) : all(of), most(asks) {}
  int rank() const override { return 1; }
  int size() const override { return 4; }
  void serve(std::function<uint32_t()>, std::function<void(uint32_t)>) override {}
  void endUnits() override {}
  uint32_t ask(uint32_t done) override {
    const uint32_t unit = all.ask(done);
    if (most-- == 0) throw Stopped{};
    return unit;
  }
  Ranks& all;
  std::atomic<uint32_t> most;
};

TEST(RayUnits, AreTheSameWhoeverCastsThemAndWhoeverIsGone) {
  const formats::TemporaryFolder folder;
  const Scene scene = test::townScene(folder, 3000);
  const auto caster = RayCaster::create(scene);
  ASSERT_TRUE(caster);
  const auto set = makePatches(scene, {.cell_m = 1}, &*caster);
  ASSERT_TRUE(set);
  WorkCount done;
  const HitRows alone = castRows(scene, *set, *caster, kFewRays, 1, done);
  for (const char* kind : {"all help", "two are gone", "another folder"}) {
    SCOPED_TRACE(kind);
    const bool gone = kind == std::string("two are gone"), elsewhere = kind == std::string("another folder");
    TestRanks ranks;
    const auto cache = cacheIn(folder.file(kind)), other = cacheIn(folder.file(elsewhere ? "elsewhere" : kind));
    std::vector<std::thread> others;
    for (uint32_t r = 1; r < 4; ++r)
      others.emplace_back([&, r] {
        Mortal self(ranks, gone && r < 3 ? r : kNoUnit);
        WorkCount count;
        try {
          RayUnits(scene, *set, *caster, kFewRays, 1, *other).help(count, self);
        } catch (const Stopped&) {
        }
      });
    RayUnits units(scene, *set, *caster, kFewRays, 1, *cache);
    CachedRays counts;
    EXPECT_TRUE(equal(alone, gathered([&](const TakeRows& take) { units.cast(done, counts, take, &ranks); })));
    for (std::thread& t : others) t.join();
    EXPECT_EQ(counts.rows.clean, 0u);
    if (elsewhere) {
      EXPECT_EQ(counts.by_others, 0u);
    } else {
      EXPECT_GT(counts.by_others, 0u);
    }
  }
}

}  // namespace
}  // namespace ff::bake
