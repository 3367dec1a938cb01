#include "runtime/probes/facet_scene.h"

#include <algorithm>
#include <chrono>
#include <deque>
#include <functional>
#include <new>
#include <numeric>
#include <optional>
#include <system_error>
#include <tuple>

#include "stream/start_threads.h"

namespace ff::runtime {
namespace {

constexpr float kNever = 3e38f;
constexpr uint32_t kLeafFacets = 4;
constexpr float kBackHandicapCells = 4e-3f;
// A new scene every so often while tiles are being loaded.
constexpr auto kPublishEvery = std::chrono::milliseconds(50);
// Cells that the observer moves before the choice of tiles is looked at again.
constexpr float kReaimCells = 4;
constexpr size_t kTilesTogether = 32;  // whose triangles are asked for at once

// Level-0 tiles, the nearest first, by a descent that visits only tiles that are as near and their siblings. What cannot be read is left out.
class NearestTiles {
 public:
  NearestTiles(const formats::World& world, const stream::Observers& observers, const formats::ReadOptions& options)
      : world_(world), observers_(observers), options_(options) {
    for (uint32_t k = 0; k < world.root()->children.size(); ++k)
      if (auto chunk = world.child(world.root(), k, options_)) offer(*chunk, 0, static_cast<uint32_t>((*chunk)->tiles.size()));
  }
  struct Place {
    float distance_m = 0;
    formats::TileRef tile;
    // The farther first, for a heap whose front is the nearest; the finer where it is the same.
    friend bool operator<(const Place& a, const Place& b) { return a.key() > b.key(); }
    std::tuple<float, uint32_t, uint32_t> key() const { return {distance_m, formats::kMaxLevels - tile.id().level, tile.id().tile}; }
  };
  std::optional<Place> next() {
    while (!heap_.empty()) {
      std::ranges::pop_heap(heap_, std::less());
      Place place = std::move(heap_.back());
      heap_.pop_back();
      if (place.tile.id().level == 0) return place;
      if (auto below = world_.childTiles(place.tile, options_)) offer(below->chunk, below->first, below->end);
    }
    return std::nullopt;
  }
  // The same; over a network, triangles that are not in `loaded` are asked for some tiles at a time.
  template <class Loaded>
  std::optional<Place> nextWithout(const Loaded& loaded) {
    if (brought_.empty()) {
      std::vector<formats::Extent> extents;
      while (brought_.size() < kTilesTogether) {
        std::optional<Place> place = next();
        if (!place) break;
        const formats::TileRef& tile = place->tile;
        if (!loaded.contains(tile.id().tile) && !tile.chunk->geometry.empty()) extents.push_back(tile.chunk->geometry[tile.index].strip);
        brought_.push_back(std::move(*place));
      }
      world_.bring(extents, options_);
    }
    if (brought_.empty()) return std::nullopt;
    std::optional<Place> first = std::move(brought_.front());
    brought_.pop_front();
    return first;
  }
  // That the descent went through.
  std::vector<formats::ChunkPtr> takeChunks() { return std::move(chunks_); }

 private:
  void offer(const formats::ChunkPtr& chunk, uint32_t first, uint32_t end) {
    if (chunks_.empty() || chunks_.back() != chunk) chunks_.push_back(chunk);
    for (uint32_t t = first; t < end; ++t) {
      heap_.push_back({observers_.distance(chunk->tiles[t].bounds), {chunk, t}});
      std::ranges::push_heap(heap_, std::less());
    }
  }
  const formats::World& world_;
  const stream::Observers observers_;
  const formats::ReadOptions options_;
  std::vector<formats::ChunkPtr> chunks_;
  std::vector<Place> heap_;
  std::deque<Place> brought_;
};

}  // namespace

// Möller and Trumbore. Fast, Minimum Storage Ray/Triangle
// Intersection. 1997. Neighbouring tiles' corners are quantised differently: the borders overlap by a thousandth.
float distanceTo(const Facet& facet, const RayLine& ray, bool& front) {
  constexpr float kOverlap = 1e-3f;
  const Vec3 p = cross(ray.direction, facet.to_third);
  const float det = dot(facet.to_second, p);
  if (std::abs(det) < 1e-20f) return kNever;
  front = det > 0;
  const float inverse = 1 / det;
  const Vec3 s = ray.origin - facet.corner;
  const float u = dot(s, p) * inverse;
  if (u < -kOverlap || u > 1 + kOverlap) return kNever;
  const Vec3 q = cross(s, facet.to_second);
  const float v = dot(ray.direction, q) * inverse;
  if (v < -kOverlap || u + v > 1 + kOverlap) return kNever;
  return dot(facet.to_third, q) * inverse;
}

FacetScene::Hit FacetScene::nearest(const RayLine& ray) const {
  Hit best;
  const float slack = back_handicap_m / 4;
  tree.walk(ray, slack, best.distance_m, [&](uint32_t first, uint32_t last) {
    for (uint32_t t = first; t < last; ++t) {
      const TileFacets& tile = *tiles[tree.order()[t]];
      tile.tree.walk(ray, slack, best.distance_m, [&](uint32_t from, uint32_t to) {
        for (uint32_t f = from; f < to; ++f) {
          bool front = true;
          const float distance = distanceTo(tile.facets[f], ray, front), handicap = front ? 0 : back_handicap_m;
          if (distance > handicap && distance + handicap < best.distance_m)
            best = {&tile, &tile.facets[f], front, distance + handicap};
        }
      });
    }
  });
  return best;
}

const TileFacets* FacetScene::facetsOf(uint32_t tile) const {
  const auto at = std::ranges::lower_bound(tiles, tile, {}, [](const auto& facets) { return facets->tile.id().tile; });
  return at != tiles.end() && (*at)->tile.id().tile == tile ? at->get() : nullptr;
}

FacetScenes::FacetScenes(const formats::World& world, uint64_t memory_bytes)
    : world_(world), memory_bytes_(memory_bytes) {
  if (!world.hasGeometry() || memory_bytes == 0) return;
  try {
    thread_ = stream::startThread([this] { work(); });
  } catch (const std::system_error&) {
    starved_ = true;
  }
}

FacetScenes::~FacetScenes() {
  if (!thread_.joinable()) return;
  stop_ = true;
  aim_.fetch_add(1);
  aim_.notify_all();
  thread_.join();
}

void FacetScenes::moveTo(const stream::Observers& observers) {
  if (!thread_.joinable() || (aimed_ && !observers.movedBy(kReaimCells * world_.info().cell_m, aimed_at_))) return;
  aimed_ = true;
  aimed_at_ = observers;
  {
    const std::lock_guard lock(mutex_);
    observers_ = observers;
  }
  aim_.fetch_add(1);
  aim_.notify_all();
}

bool FacetScenes::update() {
  if (!fresh_.load()) return false;
  const std::lock_guard lock(mutex_);
  // The old scene goes back to the thread. It has fetched the one before by the time it publishes again.
  returned_.swap(scene_);
  scene_.swap(published_);
  fresh_ = false;
  return true;
}

void FacetScenes::settle() {
  if (!thread_.joinable()) return;
  for (uint32_t done = done_.load(); done != aim_.load(); done = done_.load()) done_.wait(done);
  update();
}

void FacetScenes::work() {
  // Out of memory, it goes on with the triangles that it has, and tries again at the observer's next place.
  const auto attempt = [this](const auto& what) {
    try {
      what();
      return true;
    } catch (const std::bad_alloc&) {
      starved_ = true;
      return false;
    }
  };
  for (uint32_t served = 0; !stop_;) {
    const uint32_t aim = aim_.load();
    if (aim == served) {
      aim_.wait(served);
      continue;
    }
    stream::Observers observers;
    {
      const std::lock_guard lock(mutex_);
      observers = observers_;
    }
    bool moved_on = false;
    attempt([&] { moved_on = !loadAround(observers); });
    if (moved_on) continue;
    served = aim;
    done_ = aim;
    done_.notify_all();
  }
}

bool FacetScenes::loadAround(const stream::Observers& observers) {
  const uint32_t aim = aim_.load();
  using Place = std::pair<float, uint32_t>;  // distance, level-0 tile
  std::vector<Place> far;                    // what is here, the farthest last
  for (const auto& [tile, facets] : loaded_) far.emplace_back(observers.distance(facets->tile.info().bounds), tile);
  std::ranges::sort(far);
  NearestTiles nearest(world_, observers, {.cancelled = &stop_});
  auto published = std::chrono::steady_clock::now();
  while (const std::optional<NearestTiles::Place> next = nearest.nextWithout(loaded_)) {
    if (stop_ || aim_.load() != aim) break;
    const uint32_t number = next->tile.id().tile;
    if (loaded_.contains(number)) continue;
    auto tile = load(next->tile);
    if (!tile) continue;
    while (bytes_ + tile->bytes() > memory_bytes_ && !far.empty() && far.back() > Place{next->distance_m, number}) {
      const auto farthest = loaded_.find(far.back().second);
      bytes_ -= farthest->second->bytes();
      loaded_.erase(farthest);
      far.pop_back();
    }
    if (bytes_ + tile->bytes() > memory_bytes_) break;
    bytes_ += tile->bytes();
    loaded_.emplace(number, std::move(tile));
    unpublished_ = true;
    if (std::chrono::steady_clock::now() - published < kPublishEvery) continue;
    publish();
    published = std::chrono::steady_clock::now();
  }
  chunks_ = nearest.takeChunks();
  if (unpublished_ || published_count_ == 0) publish();
  return !stop_ && aim_.load() == aim;
}

// Null: unreadable; its area stays with the planes of the cut (ffinspect verify names what is wrong with a file).
std::shared_ptr<const TileFacets> FacetScenes::load(const formats::TileRef& tile) const {
  const auto geometry = world_.geometry(tile, {.cancelled = &stop_});
  if (!geometry) return nullptr;
  auto out = std::make_shared<TileFacets>();
  out->tile = tile;
  std::vector<Box> boxes(geometry->patch.size());
  for (size_t t = 0; t < boxes.size(); ++t) {
    for (size_t k = 0; k < 3; ++k) boxes[t].add(geometry->positions[3 * t + k]);
    out->bounds.add(boxes[t]);
  }
  out->tree = BoxTree(boxes, kLeafFacets);
  out->facets.reserve(boxes.size());
  for (const uint32_t t : out->tree.order()) {
    const Vec3* corner = &geometry->positions[size_t{3} * t];
    out->facets.push_back({corner[0], corner[1] - corner[0], corner[2] - corner[0], geometry->patch[t]});
  }
  out->start_of_patch.assign(formats::kTileNodes + 1, 0);
  for (const Facet& f : out->facets) ++out->start_of_patch[f.patch + 1u];
  std::partial_sum(out->start_of_patch.begin(), out->start_of_patch.end(), out->start_of_patch.begin());
  out->by_patch.resize(out->facets.size());
  std::vector<uint32_t> next(out->start_of_patch.begin(), out->start_of_patch.end() - 1);
  for (uint32_t f = 0; f < out->facets.size(); ++f) out->by_patch[next[out->facets[f].patch]++] = f;
  return out;
}

void FacetScenes::publish() {
  auto scene = std::make_unique<FacetScene>();
  scene->back_handicap_m = kBackHandicapCells * world_.info().cell_m;
  std::vector<Box> boxes;
  std::vector<formats::TileRef> covered, above;  // of one level
  for (const auto& [tile, facets] : loaded_) {
    scene->tiles.push_back(facets);
    boxes.push_back(facets->bounds);
    covered.push_back(facets->tile);
  }
  scene->tree = BoxTree(boxes, 1);
  scene->complete = loaded_.size() == world_.levels()[0].tiles;
  // A tile is covered if all of its child tiles are: they follow each other in the order of tiles.
  for (; !covered.empty(); covered.swap(above)) {
    above.clear();
    uint32_t here = 0;
    for (size_t k = 0; k < covered.size(); ++k) {
      const formats::TileRef& tile = covered[k];
      scene->covered.insert(tile.id());
      if (tile.chunk->isTop()) continue;
      here = k > 0 && covered[k - 1].info().parent_tile == tile.info().parent_tile ? here + 1 : 1;
      formats::TileRef parent = tile.parent();
      if (here == parent.info().end_child - parent.info().first_child) above.push_back(std::move(parent));
    }
  }
  ScenePtr old_published, old_returned, made = std::move(scene);
  {
    const std::lock_guard lock(mutex_);
    old_published = std::move(published_);
    old_returned = std::move(returned_);
    published_ = std::move(made);
    fresh_ = true;
  }
  unpublished_ = false;
  ++published_count_;
}

}  // namespace ff::runtime
