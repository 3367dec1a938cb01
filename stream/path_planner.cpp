#include "stream/path_planner.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <system_error>

#include "stream/start_threads.h"
#include "stream/wanted_tiles.h"

namespace ff::stream {

using formats::TileId;
using formats::TileInfo;

namespace {

constexpr float kMaxSeconds = 3;         // a path is not foretold any farther
constexpr float kLatencies = 4;          // so many reads one after the other, beyond StreamSettings::ahead_seconds
constexpr float kFrameSeconds = 0.05f;   // the shell, beyond what is wanted for a turn: what an observer may go in two reads and a few frames, in any direction
constexpr float kMinSpeed_m_s = 0.01f;
constexpr float kMaxTurn = 3.14159265f;  // radians in all: nobody flies in circles that small for long
constexpr uint32_t kPlansKept = 600;     // a chunk that so many plans have not looked at is forgotten
constexpr float kNever = std::numeric_limits<float>::infinity();

// Rodrigues' rotation.
Vec3 rotated(Vec3 v, Vec3 axis, float angle) {
  const float c = std::cos(angle), s = std::sin(angle);
  return v * c + cross(axis, v) * s + axis * (dot(axis, v) * (1 - c));
}

}  // namespace

std::vector<Vec3> foretoldPath(Vec3 observer, Vec3 velocity, Vec3 turn, float seconds, size_t steps) {
  std::vector<Vec3> path{observer};
  const float rate = length(turn), step = seconds / static_cast<float>(steps);
  const Vec3 axis = rate > 0 ? turn / rate : Vec3{};
  float turned = 0;
  for (size_t i = 0; i < steps; ++i) {
    const float by = std::min(rate * step, kMaxTurn - turned);
    turned += by;
    velocity = rotated(velocity, axis, by / 2);
    observer += velocity * step;
    velocity = rotated(velocity, axis, by / 2);
    path.push_back(observer);
  }
  return path;
}

Vec3 TurnRate::follow(Vec3 velocity, float seconds) {
  const Vec3 before = std::exchange(velocity_, velocity);
  const float lengths = length(before) * length(velocity);
  Vec3 turn;
  if (lengths > 0 && seconds > 0) {
    const Vec3 normal = cross(before, velocity);
    const float sine = length(normal) / lengths, angle = std::atan2(sine, dot(before, velocity) / lengths);
    if (sine > 1e-6f) turn = normal / (sine * lengths) * (angle / seconds);
  }
  const Vec3 last = std::exchange(turn_, turn);
  if (dot(last, turn) <= 0) return {};
  return length(last) < length(turn) ? last : turn;
}

PathPlanner::PathPlanner(const formats::World& world, const StreamSettings& settings, std::span<const formats::ChunkPtr> top)
    : world_(world), settings_(settings), radius_m_(radiiOf(world, settings.radius_m, settings.growth)), top_(top.begin(), top.end()), ready_(std::make_unique<Plan>()) {
  try {
    thread_ = startThread([this] { work(); });
  } catch (const std::system_error&) {
  }
}

PathPlanner::~PathPlanner() {
  if (!thread_.joinable()) return;
  stop_ = true;
  aims_.fetch_add(1);
  aims_.notify_all();
  thread_.join();
}

void PathPlanner::aim(const Observers& observers, std::span<const Hint> hints, float latency_seconds, const Lead& lead) {
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    aim_.observers = observers;
    aim_.latency_seconds = latency_seconds;
    aim_.lead = lead;
    aim_.at = Clock::now();
    aim_.hint_count = hints.size();
    std::ranges::copy(hints, aim_.hints.begin());
    aims_.fetch_add(1);
  }
  aims_.notify_one();
}

void PathPlanner::take(std::unique_ptr<Plan>& plan) {
  const std::lock_guard lock(mutex_);
  std::swap(ready_, plan);
  fresh_ = false;
}

void PathPlanner::await() const {
  for (;;) {
    const uint32_t planned = planned_.load();
    if (!thread_.joinable() || planned == aims_.load()) return;
    planned_.wait(planned);
  }
}

void PathPlanner::work() {
  auto plan = std::make_unique<Plan>();
  for (uint32_t done = 0;;) {
    aims_.wait(done);
    Aim aim;
    {
      const std::lock_guard lock(mutex_);
      aim = aim_;
      done = aims_.load();
    }
    if (stop_) return;  // looked at last: the destructor's own step of aims_ is waited for by nobody
    plan->tiles.clear();
    plan->by_id.clear();
    plan->chunks.clear();
    try {
      make(aim, *plan);
    } catch (const std::bad_alloc&) {  // what is there will do
      plan->tiles.clear();
    }
    {
      const std::lock_guard lock(mutex_);
      std::swap(ready_, plan);
      fresh_ = true;
    }
    planned_ = done;
    planned_.notify_all();
  }
}

void PathPlanner::make(const Aim& aim, Plan& plan) {
  ++plans_;
  paths_.clear();
  const float since = std::chrono::duration<float>(aim.at - std::exchange(aimed_at_, aim.at)).count();
  const float seconds = std::min(settings_.ahead_seconds + kLatencies * aim.latency_seconds, kMaxSeconds);
  for (size_t i = 0; settings_.ahead_seconds > 0 && i < aim.observers.size(); ++i) {
    const Observer& observer = aim.observers[i];
    const float speed = length(observer.velocity);
    const Vec3 turn = turn_rate_[i].follow(observer.velocity, since);
    if (!(speed > kMinSpeed_m_s)) continue;
    // Half a radius a step: a tile on the way is nearer than its radius at one of them, or misses it by 3 % of that.
    const auto steps = static_cast<size_t>(std::clamp(std::ceil(speed * seconds / (0.5f * settings_.radius_m)), 4.0f, 64.0f));
    paths_.push_back({foretoldPath(observer.at, observer.velocity, turn, seconds, steps), seconds / static_cast<float>(steps),
                      speed * (2 * aim.latency_seconds + kFrameSeconds + aim.lead.turn_seconds), speed});
  }
  observers_ = aim.observers;
  margin_m_ = observers_.fastest() * aim.lead.shown_seconds;
  places_.clear();
  for (const Hint& hint : std::span(aim.hints).first(aim.hint_count))
    places_.push_back({hint.at, std::max(0.0f, std::chrono::duration<float>(hint.due - aim.at).count())});
  if (paths_.empty() && places_.empty()) return;
  do list(plan);
  while (readAbsent());
  std::sort(plan.tiles.begin(), plan.tiles.end(), [](const Ahead& a, const Ahead& b) {
    if (a.seconds != b.seconds) return a.seconds < b.seconds;
    if (a.nearness != b.nearness) return a.nearness < b.nearness;
    return a.id.level != b.id.level ? a.id.level > b.id.level : a.id.tile < b.id.tile;
  });
  if (plan.tiles.size() > kMaxTiles) plan.tiles.resize(kMaxTiles);
  for (uint32_t k = 0; k < plan.tiles.size(); ++k) plan.by_id.push_back({plan.tiles[k].id, k});
  std::ranges::sort(plan.by_id, {}, &Plan::Named::id);
  for (auto at = chunks_.begin(); at != chunks_.end();) at = plans_ - at->second.seen < kPlansKept ? std::next(at) : chunks_.erase(at);
}

// By the chunks that are here; others are put on absent_.
void PathPlanner::list(Plan& plan) {
  plan.tiles.clear();
  absent_.clear();
  for (const formats::ChunkPtr& chunk : top_)
    for (uint32_t t = 0; t < chunk->tiles.size(); ++t) visit(*chunk, t, plan);
}

// All of them at once. False: there is nothing new. What cannot be read now is left out; whoever wants it says so.
bool PathPlanner::readAbsent() {
  world_.bringChildren(absent_, {.cancelled = &stop_});
  bool any = false;
  for (const auto& [parent, child] : absent_) {
    Here& here = chunks_[{parent->level - 1, parent->firstTileOf(child)}];
    if (here.chunk || Clock::now() < here.retry_at) continue;
    auto read = world_.child(parent, child, {.cancelled = &stop_});
    any = any || read;
    if (read)
      here.chunk = std::move(*read);
    else
      here.retry_at = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<float>(settings_.retry_seconds));
  }
  return any;
}

// 0: it is wanted now. Off the path but within the shell: after all that is on the path.
float PathPlanner::secondsTo(const Path& path, const Box& bounds, uint32_t level) const {
  for (size_t k = 0; k < path.at.size(); ++k) {
    const float beyond = bounds.distance(path.at[k]) - radius_m_[level] * (k == 0 ? 1.0f : 1.03f);
    if (beyond < 0) return k == 0 ? 0 : path.step_seconds * (static_cast<float>(k) - 1);
  }
  const float beyond = bounds.distance(path.at[0]) - radius_m_[level];
  return beyond < path.shell_m ? path.step_seconds * static_cast<float>(path.at.size()) + beyond / path.speed : kNever;
}

float PathPlanner::secondsTo(const Box& bounds, uint32_t level) const {
  float soonest = kNever;
  for (const Path& path : paths_) soonest = std::min(soonest, secondsTo(path, bounds, level));
  return soonest;
}

float PathPlanner::hintedIn(const Box& bounds, uint32_t level, float& nearness) const {
  float soonest = kNever;
  for (const Place& place : places_) {
    const float away_m = bounds.distance(place.at), near = away_m / radius_m_[level];
    if (!(away_m < radius_m_[level] + margin_m_) || place.seconds > soonest) continue;
    nearness = place.seconds < soonest ? near : std::min(nearness, near);
    soonest = place.seconds;
  }
  return soonest;
}

void PathPlanner::visit(const formats::Chunk& chunk, uint32_t tile, Plan& plan) {
  const TileInfo& info = chunk.tiles[tile];
  if (info.id.level == 0) return;
  const uint32_t level = info.id.level - 1, child = chunk.childWith(info.first_child);
  float nearness = 0;
  if (secondsTo(chunk.children[child].bounds, level) == kNever && hintedIn(chunk.children[child].bounds, level, nearness) == kNever) return;
  const formats::Chunk* below = look(chunk, child, plan);
  if (!below) return;
  for (uint32_t t = info.first_child - below->firstTile(); t < info.end_child - below->firstTile(); ++t) {
    const TileInfo& of = below->tiles[t];
    Ahead ahead{secondsTo(of.bounds, level), 0, of.id, below};
    if (ahead.seconds == kNever) {
      ahead.seconds = hintedIn(of.bounds, level, ahead.nearness);
      ahead.hinted = true;
    }
    if (ahead.seconds == kNever) continue;
    ahead.bytes = residentBytesBound(world_, of);
    if (observers_.distance(of.bounds) >= radius_m_[level]) plan.tiles.push_back(ahead);  // else it is wanted now
    visit(*below, t, plan);
  }
}

// Null: it is not here.
const formats::Chunk* PathPlanner::look(const formats::Chunk& parent, uint32_t child, Plan& plan) {
  Here& here = chunks_[{parent.level - 1, parent.firstTileOf(child)}];
  if (!here.chunk && Clock::now() >= here.retry_at) absent_.push_back({parent.shared_from_this(), child});
  if (here.chunk && std::exchange(here.seen, plans_) != plans_) plan.chunks.push_back(here.chunk);
  return here.chunk.get();
}

}  // namespace ff::stream
