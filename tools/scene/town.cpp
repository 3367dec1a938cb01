#include "tools/scene/town.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "tools/scene/building.h"
#include "tools/scene/kinds.h"
#include "tools/scene/random.h"

namespace ff::tools {
namespace {

constexpr int kPitch = 24;   // a street and a lot
constexpr int kStreet = 6;   // one voxel of pavement on each side
constexpr int kLot = kPitch - kStreet;
constexpr int kGround = 8;   // air layer above the streets: room for a cellar below
constexpr int kHeight = 52;

// How large the town is: lots, and rings of countryside shared out over its four sides.
struct Extent {
  int lots_x = 1, lots_z = 1;
  int rows = 0;  // rows of countryside in all; negative ones crop the outer streets

  int margin(int side) const { return (rows + 40 + side) / 4 - 10; }  // west, east, north, south; floor division
  int townX() const { return lots_x * kPitch + kStreet; }
  int townZ() const { return lots_z * kPitch + kStreet; }
  Int3 size() const { return {townX() + margin(0) + margin(1), kHeight, townZ() + margin(2) + margin(3)}; }
};
constexpr int kFewestRows = -20;

double smooth(double t) { return t * t * (3 - 2 * t); }

// Value noise in [0, 1): random numbers at the corners of a grid, smoothly interpolated.
double valueNoise(uint64_t seed, double x, double z) {
  const double fx = std::floor(x), fz = std::floor(z);
  const auto corner = [&](int dx, int dz) {
    return static_cast<double>(hash(seed, static_cast<int64_t>(fx) + dx, static_cast<int64_t>(fz) + dz) >> 11) * 0x1p-53;
  };
  const double u = smooth(x - fx), v = smooth(z - fz);
  const double north = corner(0, 0) + u * (corner(1, 0) - corner(0, 0));
  const double south = corner(0, 1) + u * (corner(1, 1) - corner(0, 1));
  return north + v * (south - north);
}

class TownMaker {
 public:
  // `cottages`: so small a town that only small houses fit the budget.
  TownMaker(uint64_t seed, const Extent& extent, bool cottages)
      : seed_(mix(seed)), extent_(extent), cottages_(cottages), at_({extent.margin(0), 0, extent.margin(2)}),
        town_{Voxels(extent.size()), {}, kGround, 1, 0, 0, {}, {}, {}} {}

  Town make() {
    const Int3 size = town_.voxels.size();
    for (int z = 0; z < size.z; ++z)
      for (int x = 0; x < size.x; ++x) column(x, z);
    for (int z = 0; z < size.z; ++z)
      for (int x = 0; x < size.x; ++x) wildTree(x, z);
    for (int j = 0; j < extent_.lots_z; ++j)
      for (int i = 0; i < extent_.lots_x; ++i) lot(i, j);
    streetLamps();
    town_.origin = {-(size.x / 2), -kGround, -(size.z / 2)};
    const int z = at_.z + (extent_.lots_z / 2) * kPitch + 3;
    town_.street_from = {std::clamp(at_.x + 2, 1, size.x - 2), kGround + 2, z};
    town_.street_to = {std::clamp(at_.x + extent_.townX() - 3, 1, size.x - 2), kGround + 2, z};
    town_.faces = town_.voxels.exposedFaces();
    town_.lamps = town_.voxels.count(kLampKinds);
    return std::move(town_);
  }

 private:
  // Distance to the town's rectangle, 0 inside: hills rise from its edge.
  double outside(int x, int z) const {
    const int dx = std::max({at_.x - x, x - (at_.x + extent_.townX() - 1), 0});
    const int dz = std::max({at_.z - z, z - (at_.z + extent_.townZ() - 1), 0});
    return std::sqrt(static_cast<double>(dx * dx + dz * dz));
  }

  int surface(int x, int z) const {
    const double d = outside(x, z);
    if (d == 0) return kGround;
    const double u = x - at_.x, w = z - at_.z;
    const double hills = 16 * valueNoise(seed_ + 1, u / 21, w / 21) + 5 * valueNoise(seed_ + 2, u / 7, w / 7) - 6;
    return std::clamp(kGround + static_cast<int>(std::floor(hills * smooth(std::min(1.0, d / 18)))), 2, kHeight - 16);
  }

  void column(int x, int z) {
    const int top = surface(x, z);
    Voxels& v = town_.voxels;
    uint8_t cover = kGrass;
    if (outside(x, z) == 0) {
      const int u = (x - at_.x) % kPitch, w = (z - at_.z) % kPitch;
      if (u < kStreet || w < kStreet) {
        const bool road = (u > 0 && u < kStreet - 1) || (w > 0 && w < kStreet - 1);
        cover = road ? kAsphalt : kPavement;
      }
    } else if (top > kGround + 8) {
      cover = kRock;
    } else if (top < kGround - 2) {
      cover = kSand;
    }
    v.fill({x, 0, z}, {x, top - 2, z}, top > kGround + 4 ? kRock : kDirt);
    v.set({x, top - 1, z}, cover);
  }

  void tree(Random& random, Int3 foot) {
    const int height = random.between(3, 5), r = random.between(1, 2);
    const uint8_t leaves = random.chance(20) ? kAutumnLeaves : kLeaves;
    for (int y = -r; y <= r; ++y)
      for (int z = -r; z <= r; ++z)
        for (int x = -r; x <= r; ++x) {
          const int d2 = x * x + y * y + z * z;
          const Int3 p = foot + Int3{x, height + y, z};
          if (d2 <= r * r + 1 && !(d2 >= r * r && random.chance(35)) && town_.voxels.air(p)) town_.voxels.set(p, leaves);
        }
    town_.voxels.fill(foot, foot + Int3{0, height - 1, 0}, kTrunk);
  }

  // At most one tree in a 6 x 6 field of the countryside.
  void wildTree(int x, int z) {
    const int u = x - at_.x + 6000, w = z - at_.z + 6000;
    Random random(hash(seed_ + 3, u / 6, w / 6));
    const int tree_x = random.below(6), tree_z = random.below(6);
    if (outside(x, z) < 3 || u % 6 != tree_x || w % 6 != tree_z || !random.chance(40)) return;
    const Int3 size = town_.voxels.size();
    if (x < 3 || z < 3 || x > size.x - 4 || z > size.z - 4) return;
    const int y = surface(x, z);
    if (y > kGround - 2 && y < kGround + 9) tree(random, {x, y, z});
  }

  void lot(int i, int j) {
    Random random(hash(seed_ + 4, i, j));
    const Int3 at{at_.x + i * kPitch + kStreet, kGround, at_.z + j * kPitch + kStreet};
    const int what = random.below(100);
    const bool first = i == 0 && j == 0;  // always a house: the camera has a door to enter
    if (cottages_ && first) return house(random, at, true);
    if (cottages_ || first || what < 26) return house(random, at, cottages_);
    if (what < 48) return towerBlock(random, at);
    if (what < 62) return arcade(random, at);
    if (what < 74) return courtyard(random, at);
    if (what < 83) return hall(random, at);
    if (what < 93) return park(random, at);
    hillWithTunnel(random, at);
  }

  uint8_t facade(Random& random) {
    static constexpr uint8_t kFacades[] = {kBrick, kPlaster, kOchre, kBlueWall, kGreenWall, kBrick};
    return kFacades[random.below(6)];
  }

  int side(Random& random) {
    static constexpr int kSides[] = {0, 1, 4, 5};
    return kSides[random.below(4)];
  }

  void house(Random& random, Int3 at, bool cottage) {
    BuildingPlan plan;
    plan.width = cottage ? random.between(8, 9) : random.between(9, 13);
    plan.depth = cottage ? random.between(8, 9) : random.between(9, 12);
    plan.corner = at + Int3{random.between(2, kLot - 2 - plan.width), 0, random.between(2, kLot - 2 - plan.depth)};
    plan.floors = cottage ? 1 : random.between(1, 3);
    plan.wall = facade(random);
    plan.roof = Roof::kGable;
    plan.cellar = cottage || random.chance(50);
    plan.open_cellar = random.chance(50);
    plan.door_side = side(random);
    for (int k = 0; k < (cottage ? 1 : 4); ++k) {
      const Int3 p = at + Int3{random.between(1, kLot - 2), 0, random.between(1, kLot - 2)};
      const bool clear = p.x < plan.corner.x - 3 || p.z < plan.corner.z - 3 || p.x > plan.corner.x + plan.width + 2 ||
                         p.z > plan.corner.z + plan.depth + 2;
      if (clear) tree(random, p);
    }
    build(town_.voxels, random, plan, town_.entrances);
  }

  void towerBlock(Random& random, Int3 at) {
    BuildingPlan plan;
    plan.width = random.between(13, kLot);
    plan.depth = random.between(13, kLot);
    plan.corner = at + Int3{(kLot - plan.width) / 2, 0, (kLot - plan.depth) / 2};
    plan.floors = random.between(3, 7);
    plan.wall = random.chance(40) ? uint8_t{kConcrete} : facade(random);
    plan.cellar = random.chance(40);
    plan.open_cellar = random.chance(60);
    plan.door_side = side(random);
    pave(at);
    build(town_.voxels, random, plan, town_.entrances);
  }

  // A row of columns along the street carries a roof; shops behind it.
  void arcade(Random& random, Int3 at) {
    BuildingPlan plan;
    plan.corner = at + Int3{0, 0, 4};
    plan.width = kLot;
    plan.depth = kLot - 4;
    plan.floors = random.between(2, 4);
    plan.wall = facade(random);
    plan.door_side = 4;
    pave(at);
    build(town_.voxels, random, plan, town_.entrances);
    Voxels& v = town_.voxels;
    v.fill(at + Int3{0, 3, 0}, at + Int3{kLot - 1, 3, 3}, kConcrete);
    for (int x = 0; x < kLot; x += 3)
      if (x != 9) v.fill(at + Int3{x, 0, 0}, at + Int3{x, 2, 0}, kPlaster);
    for (int x = 3; x < kLot; x += 6) v.set(at + Int3{x, 2, 2}, kWarmLamp);
  }

  // Four wings around a court, with a vaulted passage through one of them.
  void courtyard(Random& random, Int3 at) {
    BuildingPlan wing;
    wing.wall = facade(random);
    wing.floors = random.between(2, 4);
    pave(at);
    const auto put = [&](int x, int z, int width, int depth, int door) {
      BuildingPlan p = wing;
      p.corner = at + Int3{x, 0, z};
      p.width = width;
      p.depth = depth;
      p.door_side = door;
      build(town_.voxels, random, p, town_.entrances);
    };
    put(0, 5, 6, 8, 0);
    put(12, 5, 6, 8, 1);
    put(0, 0, kLot, 6, -1);
    put(0, 12, kLot, 6, 5);
    Voxels& v = town_.voxels;
    v.fill(at + Int3{7, 0, 0}, at + Int3{10, 3, 5}, wing.wall);
    v.fill(at + Int3{8, 0, 0}, at + Int3{9, 2, 5}, kAir);
    v.set(at + Int3{8, 2, 3}, kWarmLamp);
    v.set(at + Int3{8, 0, 8}, kLeaves);
  }

  void hall(Random& random, Int3 at) {
    Voxels& v = town_.voxels;
    const int height = random.between(6, 8);
    const uint8_t wall = random.chance(50) ? kBrick : kConcrete;
    pave(at);
    v.fill(at + Int3{1, -1, 2}, at + Int3{kLot - 2, height, kLot - 3}, wall);
    v.fill(at + Int3{2, 0, 3}, at + Int3{kLot - 3, height - 1, kLot - 4}, kAir);
    v.fill(at + Int3{2, -1, 3}, at + Int3{kLot - 3, -1, kLot - 4}, kTileFloor);
    v.fill(at + Int3{1, height, 2}, at + Int3{kLot - 2, height, kLot - 3}, kSlate);
    for (int z = 6; z < kLot - 4; z += 5)
      for (int x = 5; x < kLot - 4; x += 4) {
        v.fill(at + Int3{x, 0, z}, at + Int3{x, height - 1, z}, kOchre);
        v.set(at + Int3{x + 2, height - 1, z}, kCoolLamp);
      }
    for (int k = 0; k < 8; ++k) {
      const Int3 p = at + Int3{random.between(3, kLot - 4), 0, random.between(4, kLot - 5)};
      v.fill(p, p + Int3{0, random.below(2), 0}, random.chance(50) ? kRedCloth : kOak);
    }
    for (int x = 3; x < kLot - 3; x += 3) v.set(at + Int3{x, height - 2, 2}, kAir);  // high windows
    const int gate = kLot / 2;
    for (int z : {2, kLot - 3}) v.fill(at + Int3{gate - 1, 0, z}, at + Int3{gate, 2, z}, kAir);
  }

  void park(Random& random, Int3 at) {
    Voxels& v = town_.voxels;
    v.fill(at + Int3{0, -1, 8}, at + Int3{kLot - 1, -1, 9}, kSand);
    v.fill(at + Int3{2, -1, 2}, at + Int3{6, -1, 6}, kAir);
    v.fill(at + Int3{2, -2, 2}, at + Int3{6, -2, 6}, kWater);
    for (int k = 0; k < 7; ++k) {
      const Int3 p = at + Int3{random.between(2, kLot - 3), 0, random.between(11, kLot - 3)};
      tree(random, p);
    }
    tree(random, at + Int3{13, 0, 4});
    v.fill(at + Int3{9, 0, 6}, at + Int3{10, 0, 6}, kOak);
  }

  void hillWithTunnel(Random& random, Int3 at) {
    Voxels& v = town_.voxels;
    const int middle = kLot / 2, top = random.between(6, 9);
    for (int z = 0; z < kLot; ++z)
      for (int x = 0; x < kLot; ++x) {
        const double dx = x - middle + 0.5, dz = z - middle + 0.5;
        const int h = static_cast<int>(top - (dx * dx + dz * dz) * top / 81.0 +
                                       2 * valueNoise(seed_ + 5, at.x - at_.x + x * 0.4, at.z - at_.z + z * 0.4));
        if (h <= 0) continue;
        v.fill(at + Int3{x, 0, z}, at + Int3{x, h - 1, z}, kRock);
        v.set(at + Int3{x, h - 1, z}, h > 6 ? kRock : kGrass);
      }
    v.fill(at + Int3{0, -1, middle - 2}, at + Int3{kLot - 1, -1, middle + 1}, kAsphalt);
    v.fill(at + Int3{0, 0, middle - 2}, at + Int3{kLot - 1, 2, middle + 1}, kAir);
    for (int x = 5; x < kLot; x += 8)
      if (!v.air(at + Int3{x, 3, middle})) v.set(at + Int3{x, 2, middle}, kWarmLamp);
  }

  void pave(Int3 at) { town_.voxels.fill(at + Int3{0, -1, 0}, at + Int3{kLot - 1, -1, kLot - 1}, kPavement); }

  void streetLamps() {
    const auto lamp = [&](int u, int w) {
      const Int3 foot{at_.x + u, kGround, at_.z + w};
      for (int y = 0; y < 5; ++y)
        if (!town_.voxels.air(foot + Int3{0, y, 0})) return;
      town_.voxels.fill(foot, foot + Int3{0, 3, 0}, kSlate);
      town_.voxels.set(foot + Int3{0, 4, 0}, kStreetLamp);
    };
    for (int j = 0; j <= extent_.lots_z; ++j)
      for (int i = 0; i <= extent_.lots_x; ++i) {
        if (j < extent_.lots_z) lamp(i * kPitch, j * kPitch + kStreet + 4);
        if (i < extent_.lots_x) lamp(i * kPitch + kStreet + 12, j * kPitch + kStreet - 1);
      }
  }

  uint64_t seed_;
  Extent extent_;
  bool cottages_;
  Int3 at_;  // voxel of the town's corner
  Town town_;
};

}  // namespace

Result<Town> makeTown(const TownOptions& options) {
  if (options.patches < kMinTownPatches || options.patches > kMaxTownPatches)
    return Error{ErrorCode::kUsage, "", "", "a town of " + std::to_string(options.patches) + " patches cannot be built",
                 "ask for " + std::to_string(kMinTownPatches) + " to " + std::to_string(kMaxTownPatches)};
  const bool cottages = options.patches < 9'000;
  const auto faces = [&](Extent e) { return TownMaker(options.seed, e, cottages).make().faces; };
  // Lots as a growing near-square, as many as fit with a belt of countryside; more countryside fills the rest.
  const int belt = cottages ? 8 : options.patches < 30'000 ? 32 : 72;
  const auto lots = [belt](int k) { return Extent{k / 2 + 1, (k + 1) / 2, belt}; };
  int fits = 1, too_many = 2;
  while (faces(lots(too_many)) <= options.patches) {
    fits = too_many;
    too_many *= 2;
  }
  while (too_many - fits > 1) {
    const int k = (fits + too_many) / 2;
    (faces(lots(k)) <= options.patches ? fits : too_many) = k;
  }
  Extent extent = lots(fits);
  int low = kFewestRows, high = belt;
  const auto withRows = [&](int rows) { return Extent{extent.lots_x, extent.lots_z, rows}; };
  while (faces(withRows(high)) < options.patches) {
    low = high;
    high += 64;
  }
  while (high - low > 1) {
    const int rows = (low + high) / 2;
    (faces(withRows(rows)) < options.patches ? low : high) = rows;
  }
  Town below = TownMaker(options.seed, withRows(low), cottages).make();
  Town above = TownMaker(options.seed, withRows(high), cottages).make();
  const auto miss = [&](const Town& t) {
    return t.faces > options.patches ? t.faces - options.patches : options.patches - t.faces;
  };
  Town town = miss(below) < miss(above) ? std::move(below) : std::move(above);
  town.cell_m = options.cell_m;
  return town;
}

SceneModel townModel(const Town& town, bool merge) {
  SceneModel model;
  model.name = "town";
  model.materials = townMaterials();
  model.nodes = meshVoxels(town.voxels, {town.origin, merge, 64});
  model.scale = town.cell_m;
  model.integer_grid = true;
  return model;
}

}  // namespace ff::tools
