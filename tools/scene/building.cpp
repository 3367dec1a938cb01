#include "tools/scene/building.h"

#include <algorithm>
#include <optional>

#include "tools/scene/kinds.h"

namespace ff::tools {
namespace {

// Rooms are rectangles of air, ends included.
struct Room {
  int x0, z0, x1, z1;
  int width() const { return x1 - x0 + 1; }
  int depth() const { return z1 - z0 + 1; }
};

struct Door {
  Int3 at;
  bool through_x;  // the wall it pierces is crossed along x
};

class Builder {
 public:
  Builder(Voxels& voxels, Random& random, const BuildingPlan& plan)
      : v_(voxels), random_(random), plan_(plan), window_style_(random.below(3)) {}

  std::optional<Entrance> run() {
    const int x1 = plan_.corner.x + plan_.width - 1, z1 = plan_.corner.z + plan_.depth - 1;
    if (plan_.cellar) cellar(x1, z1);
    for (int s = 0; s < plan_.floors; ++s) storey(s, x1, z1);
    for (int s = plan_.open_cellar && plan_.cellar ? -1 : 0; s + 1 < plan_.floors; ++s) stairs(s);
    roof(x1, z1);
    return frontDoor(x1, z1);
  }

 private:
  int feet(int storey) const { return plan_.corner.y + storey * kStoreyHeight; }

  // Stairs alternate between the two ends of the house, so that one flight never ends in the next one's opening.
  int stairX(int storey) const {
    return storey % 2 == 0 ? plan_.corner.x + 1 : plan_.corner.x + plan_.width - 2;
  }
  int stairZ() const { return plan_.corner.z + 1; }
  bool hasStairs() const { return plan_.depth >= 8 && plan_.width >= 6; }
  bool keptFree(int x, int z) const {
    return hasStairs() && (x == stairX(0) || x == stairX(1)) && z <= stairZ() + 4;
  }

  void shell(int y_slab, int x1, int z1, uint8_t wall) {
    const Int3 c = plan_.corner;
    v_.fill({c.x, y_slab, c.z}, {x1, y_slab + kStoreyHeight, z1}, wall);
    v_.fill({c.x + 1, y_slab + 1, c.z + 1}, {x1 - 1, y_slab + kStoreyHeight - 1, z1 - 1}, kAir);
  }

  void storey(int s, int x1, int z1) {
    const Int3 c = plan_.corner;
    const int y = feet(s);
    shell(y - 1, x1, z1, plan_.wall);
    v_.fill({c.x + 1, y + 3, c.z + 1}, {x1 - 1, y + 3, z1 - 1}, s + 1 == plan_.floors ? kConcrete : kCream);
    static constexpr uint8_t kInner[] = {kCream, kRose, kTeal, kPlaster};
    std::vector<Room> rooms;
    std::vector<Door> doors;
    split({c.x + 1, c.z + 1, x1 - 1, z1 - 1}, y, kInner[random_.below(4)], rooms, doors);
    for (const Room& room : rooms) furnish(room, y, x1, z1);
    for (const Door& door : doors)
      for (int d = -1; d <= 1; ++d) {
        const Int3 p = door.at + (door.through_x ? Int3{d, 0, 0} : Int3{0, 0, d});
        v_.fill({p.x, y, p.z}, {p.x, y + 1, p.z}, kAir);
      }
  }

  // Inner walls by binary space partition; every wall gets a door, so all rooms of a storey are connected.
  void split(const Room& r, int y, uint8_t wall, std::vector<Room>& rooms, std::vector<Door>& doors) {
    const bool along_x = r.width() > r.depth() || (r.width() == r.depth() && random_.chance(50));
    const int extent = along_x ? r.width() : r.depth();
    if (extent < 7 || (extent < 10 && random_.chance(25))) {
      rooms.push_back(r);
      return;
    }
    const int at = random_.between(3, extent - 4);
    Room a = r, b = r;
    Door door{{0, y, 0}, along_x};
    if (along_x) {
      v_.fill({r.x0 + at, y, r.z0}, {r.x0 + at, y + 2, r.z1}, wall);
      a.x1 = r.x0 + at - 1;
      b.x0 = r.x0 + at + 1;
      door.at = {r.x0 + at, y, random_.between(r.z0, r.z1)};
    } else {
      v_.fill({r.x0, y, r.z0 + at}, {r.x1, y + 2, r.z0 + at}, wall);
      a.z1 = r.z0 + at - 1;
      b.z0 = r.z0 + at + 1;
      door.at = {random_.between(r.x0, r.x1), y, r.z0 + at};
    }
    doors.push_back(door);
    split(a, y, wall, rooms, doors);
    split(b, y, wall, rooms, doors);
  }

  void furnish(const Room& room, int y, int x1, int z1) {
    static constexpr uint8_t kFloors[] = {kWoodFloor, kTileFloor, kCarpet, kWoodFloor};
    static constexpr uint8_t kThings[] = {kOak, kRedCloth, kBlueCloth, kOak};
    v_.fill({room.x0, y - 1, room.z0}, {room.x1, y - 1, room.z1}, kFloors[random_.below(4)]);
    const bool windows = !random_.chance(20);
    if (windows) {
      for (int z = room.z0; z <= room.z1; ++z) {
        if (room.x0 == plan_.corner.x + 1) window({plan_.corner.x, y, z}, z - room.z0, room.z1 - z);
        if (room.x1 == x1 - 1) window({x1, y, z}, z - room.z0, room.z1 - z);
      }
      for (int x = room.x0; x <= room.x1; ++x) {
        if (room.z0 == plan_.corner.z + 1) window({x, y, plan_.corner.z}, x - room.x0, room.x1 - x);
        if (room.z1 == z1 - 1) window({x, y, z1}, x - room.x0, room.x1 - x);
      }
    }
    const int pieces = random_.between(1, 2 + room.width() * room.depth() / 12);
    for (int i = 0; i < pieces; ++i) {
      const int x = random_.between(room.x0, room.x1), z = random_.between(room.z0, room.z1);
      const int height = random_.chance(30) ? 1 : 0;
      const uint8_t kind = kThings[random_.below(4)];
      const int long_x = random_.below(2), long_z = 1 - long_x;
      for (int k = 0; k < 2; ++k) {
        const Int3 p{std::min(x + k * long_x, room.x1), y, std::min(z + k * long_z, room.z1)};
        if (!keptFree(p.x, p.z)) v_.fill(p, p + Int3{0, height, 0}, kind);
      }
    }
    const Int3 lamp{(room.x0 + room.x1) / 2, y + 2, (room.z0 + room.z1) / 2};
    if (keptFree(lamp.x, lamp.z) || (windows && !random_.chance(60) && y != plan_.corner.y)) return;
    v_.set(lamp, random_.chance(75) ? kWarmLamp : kCoolLamp);
    if (y == plan_.corner.y) ground_lamps_.push_back(lamp);
  }

  void window(Int3 p, int from_start, int from_end) {
    const int d = std::min(from_start, from_end);
    if (window_style_ == 0 && d >= 1) v_.set(p + Int3{0, 1, 0}, kAir);
    if (window_style_ == 1 && from_start % 3 == 1) v_.fill(p + Int3{0, 1, 0}, p + Int3{0, 2, 0}, kAir);
    if (window_style_ == 2 && from_start % 4 != 3 && d >= 1) v_.fill(p + Int3{0, 1, 0}, p + Int3{0, 2, 0}, kAir);
  }

  void cellar(int x1, int z1) {
    const Int3 c = plan_.corner;
    const int y = feet(-1);
    shell(y - 1, x1, z1, random_.chance(50) ? kConcrete : kBrick);
    v_.fill({c.x + 1, y - 1, c.z + 1}, {x1 - 1, y - 1, z1 - 1}, kTileFloor);
    const int middle = c.x + plan_.width / 2;
    v_.fill({middle, y, c.z + 1}, {middle, y + 2, z1 - 1}, random_.chance(50) ? kRose : kTeal);
    v_.fill({middle, y, c.z + plan_.depth / 2}, {middle, y + 1, c.z + plan_.depth / 2}, kAir);
    v_.set({c.x + plan_.width / 4, y + 2, c.z + plan_.depth / 2}, kWarmLamp);
    v_.set({x1 - plan_.width / 4, y + 2, c.z + plan_.depth / 2}, random_.chance(50) ? kWarmLamp : kCoolLamp);
    v_.fill({x1 - 1, y, z1 - 1}, {x1 - 1, y + 1, z1 - 1}, kOak);
  }

  void stairs(int s) {
    if (!hasStairs()) return;
    const int x = stairX(s), z = stairZ(), y = feet(s);
    v_.fill({x, y, z}, {x, y + 2, z + 4}, kAir);
    v_.fill({x, y + 3, z + 1}, {x, y + 3, z + 3}, kAir);
    v_.fill({x, y + 4, z}, {x, y + 6, z + 4}, kAir);
    for (int k = 0; k < 3; ++k) v_.fill({x, y, z + 1 + k}, {x, y + k, z + 1 + k}, kOak);
  }

  void roof(int x1, int z1) {
    const Int3 c = plan_.corner;
    const int y = feet(plan_.floors);
    if (plan_.roof == Roof::kFlat) {
      for (int x = c.x; x <= x1; ++x)
        for (int z = c.z; z <= z1; ++z)
          if (x == c.x || z == c.z || x == x1 || z == z1) v_.set({x, y, z}, plan_.wall);
      return;
    }
    const uint8_t tiles = random_.chance(70) ? kRoofTile : kSlate;
    const bool ridge_along_x = plan_.width >= plan_.depth;
    const int half = ((ridge_along_x ? plan_.depth : plan_.width) + 1) / 2;
    for (int k = 0; k <= half; ++k) {
      if (ridge_along_x)
        v_.fill({c.x - 1, y - 1 + k, c.z - 1 + k}, {x1 + 1, y - 1 + k, z1 + 1 - k}, tiles);
      else
        v_.fill({c.x - 1 + k, y - 1 + k, c.z - 1}, {x1 + 1 - k, y - 1 + k, z1 + 1}, tiles);
    }
  }

  std::optional<Entrance> frontDoor(int x1, int z1) {
    const Int3 c = plan_.corner;
    Int3 at{c.x + plan_.width / 2, c.y, c.z + plan_.depth / 2};
    if (plan_.door_side == 0) at.x = c.x;
    else if (plan_.door_side == 1) at.x = x1;
    else if (plan_.door_side == 4) at.z = c.z;
    else if (plan_.door_side == 5) at.z = z1;
    else return std::nullopt;
    const Int3 out = kFaceNormals[static_cast<size_t>(plan_.door_side)];
    const Int3 inside{at.x - out.x, at.y, at.z - out.z}, outside = at + out;
    for (const Int3& p : {outside, at, inside}) v_.fill(p, p + Int3{0, 1, 0}, kAir);
    v_.set(at + Int3{0, -1, 0}, kOak);
    if (ground_lamps_.empty()) return std::nullopt;
    const auto distance = [&](Int3 p) { return std::abs(p.x - inside.x) + std::abs(p.z - inside.z); };
    const Int3 lamp = *std::ranges::min_element(ground_lamps_, {}, distance);
    return Entrance{outside, inside, lamp};
  }

  Voxels& v_;
  Random& random_;
  const BuildingPlan& plan_;
  int window_style_;
  std::vector<Int3> ground_lamps_;
};

}  // namespace

void build(Voxels& voxels, Random& random, const BuildingPlan& plan, std::vector<Entrance>& entrances) {
  if (const auto entrance = Builder(voxels, random, plan).run()) entrances.push_back(*entrance);
}

}  // namespace ff::tools
