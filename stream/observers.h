// Who looks at a world: one observer, or several that share its strips (players side by side, a server's clients, an editor's views).
#pragma once
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/result.h"
#include "formats/vec3.h"

namespace ff::stream {

struct Observer {
  Vec3 at, velocity;  // m, m/s
  friend bool operator==(const Observer&, const Observer&) = default;
};

inline constexpr size_t kMaxObservers = 16;

// Where an observer will be, other than by its velocity: a teleport, a cut scene, a spawn point.
struct Hint {
  Vec3 at;  // m
  std::chrono::steady_clock::time_point due;
};
inline constexpr std::chrono::seconds kHintStays{5};  // beyond its time
// Those that are past that are no more; whether there were any.
inline bool forgetHints(std::vector<Hint>& hints) {
  return !hints.empty() && std::erase_if(hints, [now = std::chrono::steady_clock::now()](const Hint& hint) { return now > hint.due + kHintStays; }) > 0;
}

// 1 to kMaxObservers of them; takes no memory.
class Observers {
 public:
  Observers() = default;
  Observers(const Observer& one) : list_{one} {}
  Observers(std::span<const Observer> list) : count_(list.size()) {
    FF_CHECK_LT(size_t{0}, list.size());
    FF_CHECK_LE(list.size(), kMaxObservers);
    std::ranges::copy(list, list_.begin());
  }
  const Observer* begin() const { return list_.data(); }
  const Observer* end() const { return list_.data() + count_; }
  size_t size() const { return count_; }
  const Observer& operator[](size_t i) const { return list_[i]; }
  friend bool operator==(const Observers& a, const Observers& b) { return std::ranges::equal(a, b); }

  Observers moved(Vec3 by_m) const {
    Observers moved = *this;
    for (size_t i = 0; i < count_; ++i) moved.list_[i].at += by_m;
    return moved;
  }
  // Of the nearest one, where it will be after so many seconds, m.
  float distance(const Box& bounds, float seconds = 0) const {
    float nearest = bounds.distance(list_[0].at + list_[0].velocity * seconds);
    for (size_t i = 1; i < count_; ++i) nearest = std::min(nearest, bounds.distance(list_[i].at + list_[i].velocity * seconds));
    return nearest;
  }
  float fastest() const {  // m/s
    float speed = 0;
    for (const Observer& observer : *this) speed = std::max(speed, length(observer.velocity));
    return speed;
  }
  // Whether any is farther than that from where it was, or there are more or fewer.
  bool movedBy(float distance_m, const Observers& before) const {
    if (count_ != before.count_) return true;
    for (size_t i = 0; i < count_; ++i)
      if (length(list_[i].at - before.list_[i].at) > distance_m) return true;
    return false;
  }

 private:
  std::array<Observer, kMaxObservers> list_{};
  size_t count_ = 1;
};

}  // namespace ff::stream
