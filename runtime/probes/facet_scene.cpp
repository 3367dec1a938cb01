#include "runtime/probes/facet_scene.h"

#include <algorithm>
#include <chrono>
#include <new>
#include <system_error>

namespace ff::runtime {
namespace {

constexpr float kNever = 3e38f;
constexpr uint32_t kLeafFacets = 4;
constexpr float kBackHandicapCells = 4e-3f;
// A new scene every so often while tiles are being loaded.
constexpr auto kPublishEvery = std::chrono::milliseconds(50);
// Cells that the observer moves before the choice of tiles is looked at again.
constexpr float kReaimCells = 4;

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
            best = {tile.tile, tile.facets[f].patch, front, distance + handicap};
        }
      });
    }
  });
  return best;
}

FacetScenes::FacetScenes(const formats::World& world, uint64_t memory_bytes)
    : world_(world), memory_bytes_(memory_bytes), numbers_(world), loaded_(world.tiles(0).size()) {
  if (!world.hasGeometry() || memory_bytes == 0) return;
  try {
    thread_ = std::thread([this] { work(); });
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

void FacetScenes::moveTo(Vec3 observer) {
  if (!thread_.joinable() || (aimed_ && length(observer - aimed_at_) < kReaimCells * world_.info().cell_m)) return;
  aimed_ = true;
  aimed_at_ = observer;
  {
    const std::lock_guard lock(mutex_);
    observer_ = observer;
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
  bool prepared = false;
  for (uint32_t served = 0; !stop_;) {
    const uint32_t aim = aim_.load();
    if (aim == served) {
      aim_.wait(served);
      continue;
    }
    Vec3 observer;
    {
      const std::lock_guard lock(mutex_);
      observer = observer_;
    }
    if (!prepared) prepared = attempt([&] { findDescendants(); });
    bool moved_on = false;
    if (prepared) attempt([&] { moved_on = !loadAround(observer); });
    if (moved_on) continue;
    served = aim;
    done_ = aim;
    done_.notify_all();
  }
}

// Descendants of consecutive tiles are consecutive.
void FacetScenes::findDescendants() {
  descendants_.resize(numbers_.tiles());
  for (const formats::TileInfo& info : world_.tiles(0)) descendants_[info.id.tile] = {info.id.tile, info.id.tile};
  for (uint32_t level = 1; level < world_.levels().size() && !stop_; ++level)
    for (const formats::TileInfo& info : world_.tiles(level)) {
      const auto [first, end] = world_.childTiles(info.id);
      descendants_[numbers_.of(info.id)] = {descendants_[numbers_.of({level - 1, first})].first,
                                            descendants_[numbers_.of({level - 1, end - 1})].second};
    }
}

bool FacetScenes::loadAround(Vec3 observer) {
  const uint32_t aim = aim_.load();
  std::vector<std::pair<float, uint32_t>> nearest;  // distance, tile
  for (const formats::TileInfo& info : world_.tiles(0)) nearest.emplace_back(info.bounds.distance(observer), info.id.tile);
  std::sort(nearest.begin(), nearest.end());
  auto published = std::chrono::steady_clock::now();
  size_t farthest = nearest.size();  // tiles from here on have been let go
  for (size_t i = 0; i < farthest; ++i) {
    if (stop_ || aim_.load() != aim) break;
    std::shared_ptr<const TileFacets>& place = loaded_[nearest[i].second];
    if (place) continue;
    auto tile = load(nearest[i].second);
    if (!tile) continue;
    while (bytes_ + tile->bytes() > memory_bytes_ && farthest > i + 1) {
      std::shared_ptr<const TileFacets>& far = loaded_[nearest[--farthest].second];
      if (!far) continue;
      bytes_ -= far->bytes();
      far = nullptr;
    }
    if (bytes_ + tile->bytes() > memory_bytes_) break;
    bytes_ += tile->bytes();
    place = std::move(tile);
    unpublished_ = true;
    if (std::chrono::steady_clock::now() - published < kPublishEvery) continue;
    publish();
    published = std::chrono::steady_clock::now();
  }
  if (unpublished_ || published_count_ == 0) publish();
  return !stop_ && aim_.load() == aim;
}

// Null: unreadable; its area stays with the planes of the cut (ffinspect verify names what is wrong with a file).
std::shared_ptr<const TileFacets> FacetScenes::load(uint32_t tile) const {
  const auto geometry = world_.geometry(tile);
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
  return out;
}

void FacetScenes::publish() {
  auto scene = std::make_unique<FacetScene>();
  scene->back_handicap_m = kBackHandicapCells * world_.info().cell_m;
  std::vector<Box> boxes;
  std::vector<uint32_t> missing_before(loaded_.size() + 1);  // tiles that are not loaded, before each
  for (size_t tile = 0; tile < loaded_.size(); ++tile) {
    missing_before[tile + 1] = missing_before[tile] + (loaded_[tile] ? 0 : 1);
    if (!loaded_[tile]) continue;
    scene->tiles.push_back(loaded_[tile]);
    boxes.push_back(loaded_[tile]->bounds);
  }
  scene->tree = BoxTree(boxes, 1);
  scene->complete = missing_before.back() == 0;
  for (const auto& [first, last] : descendants_)
    scene->covered.push_back(missing_before[last + 1] == missing_before[first]);
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
