// The drawing triangles of the level-0 tiles nearest to the observer, for the rays of probes: loaded, and arranged in
// trees, by a thread of their own, as many as a budget of memory holds. The frame thread gets finished scenes.
#pragma once
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "formats/read/reader.h"
#include "runtime/probes/box_tree.h"
#include "stream/observers.h"
#include "stream/tile_map.h"

namespace ff::runtime {

// A triangle, counter-clockwise seen from the front.
struct Facet {
  Vec3 corner, to_second, to_third;  // m
  uint8_t patch = 0;                 // of its tile
};

// Distance along the ray to the facet, 3e38 if it misses; front: from which side.
float distanceTo(const Facet& facet, const RayLine& ray, bool& front);

struct TileFacets {
  formats::TileRef tile;
  std::vector<Facet> facets;  // in the order of the tree
  BoxTree tree;
  Box bounds;
  std::vector<uint32_t> by_patch, start_of_patch;  // numbers of facets, patch by patch
  std::span<const uint32_t> ofPatch(uint32_t patch) const {
    return std::span(by_patch).subspan(start_of_patch[patch], start_of_patch[patch + 1] - start_of_patch[patch]);
  }
  uint64_t bytes() const {
    return sizeof(*this) + facets.size() * sizeof(Facet) + tree.bytes() + (by_patch.size() + start_of_patch.size()) * sizeof(uint32_t);
  }
};

// Immutable.
struct FacetScene {
  std::vector<std::shared_ptr<const TileFacets>> tiles;  // by number, ascending
  BoxTree tree;                  // over tiles
  stream::TileSet covered;       // of all levels: all patches beneath are in `tiles`
  bool complete = false;         // all of the world is in `tiles`
  float back_handicap_m = 0;

  struct Hit {
    const TileFacets* tile = nullptr;
    const Facet* facet = nullptr;
    bool front = true;
    float distance_m = 3e38f;  // this: nothing
  };
  // Nearest triangle. Of two in one place, a double-sided surface's, the one that faces the ray is met; back faces
  // nearer than the handicap are the surface that the origin lies on.
  Hit nearest(const RayLine& ray) const;
  // Of a level-0 tile by number; null: it is not here.
  const TileFacets* facetsOf(uint32_t tile) const;
};

class FacetScenes {
 public:
  // memory_bytes: of the scene's tiles.
  FacetScenes(const formats::World& world, uint64_t memory_bytes);
  ~FacetScenes();

  // The owner's calls, of one thread. They allocate and free nothing and never wait; the lock that they take guards
  // only swaps.
  void moveTo(const stream::Observers& observers);
  // Null: none yet. The same until update() says true.
  const FacetScene* scene() const { return scene_.get(); }
  bool update();
  uint32_t tiles() const { return scene_ ? static_cast<uint32_t>(scene_->tiles.size()) : 0; }

  // Whether memory or a thread for it was lacking at some time: probes then meet planes where triangles could not be loaded. Any thread.
  bool starved() const { return starved_.load(); }
  // Blocks until the scene for the last observers is here.
  void settle();
  bool settled() const { return done_.load() == aim_.load(); }

 private:
  using ScenePtr = std::unique_ptr<const FacetScene>;
  void work();
  bool loadAround(const stream::Observers& observers);  // false: they have moved on
  std::shared_ptr<const TileFacets> load(const formats::TileRef& tile) const;
  void publish();

  const formats::World& world_;
  const uint64_t memory_bytes_;
  // The owner's.
  ScenePtr scene_, next_;
  stream::Observers aimed_at_;
  bool aimed_ = false;
  // Handed over.
  std::mutex mutex_;
  stream::Observers observers_;
  ScenePtr published_, returned_;
  std::atomic<uint32_t> aim_{0}, done_{0};  // number of the last observers, and of the last that were served
  std::atomic<bool> fresh_{false}, stop_{false}, starved_{false};
  std::atomic<uint32_t> published_count_{0};
  // The thread's.
  std::map<uint32_t, std::shared_ptr<const TileFacets>> loaded_;  // by level-0 tile
  std::vector<formats::ChunkPtr> chunks_;  // that the last choice of tiles went through: the next one will, too
  uint64_t bytes_ = 0;
  bool unpublished_ = false;  // tiles were loaded since the last scene
  std::thread thread_;
};

}  // namespace ff::runtime
