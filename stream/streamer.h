// Keeps the strips near the observer in memory. update() runs on the frame thread; it never waits, and allocates and frees
// nothing: it takes what has arrived, asks for what is missing and for what the observer's path will want (nearest deadline first) and
// evicts what is no longer wanted. Planning, reading, checking, decoding and freeing happen on other threads. The coarsest level is loaded by create() and never leaves.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "formats/read/reader.h"
#include "stream/observers.h"
#include "stream/rate_limit.h"
#include "stream/resident_strip.h"
#include "stream/strip_lists.h"
#include "stream/tile_source.h"

namespace ff::stream {

// Defaults for patches of 1 m, by ff_bench_cut on a town of 1M by night (RESULTS.md): coarse tiles are as wide as their radius and wider, so that
// a larger growth buys little of what an eye sees within 48 m, and a larger radius much.
struct StreamSettings {
  float radius_m = 16;                          // r_0: a level-0 tile is wanted when its bounds are nearer than this
  float growth = 1.3f;                          // g: r_l = r_0 * g^l; where max_nodes or memory_bytes run out, it is smaller first, by a third of what is above 1, and then r_0
  float hysteresis = 1.15f;                     // a tile stays wanted until its distance exceeds radius * hysteresis
  uint64_t memory_bytes = uint64_t{512} << 20;  // of decoded strips; the farthest finest tiles are not loaded past it
  uint64_t kept_bytes = uint64_t{2} << 20;      // of these, of strips that are wanted no more: for the observer's return
  uint32_t max_level0_nodes = 24576;            // likewise, for active patches
  uint32_t max_nodes = 131072;                  // of all wanted tiles together; a seventh more have room in the matrix, for what fades out,
                                                // and so that a tile that enters finds consecutive slots
  int decode_threads = 1;
  int queue_depth = 64;                         // reads at a time, or as many as the source is good for: what flies at 60 m/s wants some 200 a second, also where each
                                                // takes 0.1 s, and 32 were too few for it (RESULTS.md)
  float ahead_seconds = 0.5f;                   // what the observer's path will want in this time, and in some reads' time more, is read ahead; 0: nothing
  uint64_t ahead_bytes = uint64_t{4} << 20;     // of memory_bytes, at most, for what is read ahead
  uint64_t hint_bytes = uint64_t{16} << 20;     // of memory_bytes, at most, for what expect() names
  uint64_t read_bytes_per_second = 0;           // of strips, at most (rate_limit.h); 0: no limit. create() is not held up, and the index comes on top
  float retry_seconds = 5;                      // a strip that failed twice is tried again every so often while it is wanted
  bool background = false;                      // all but handing over is done on a thread of its own (background_streamer.h), so that update() brings
                                                // what came of the call before
};

// So long before an observer is near a tile is wanted: what whoever takes active() needs. At most so much.
inline constexpr float kMaxLead_seconds = 1.4f, kMaxShownLead_seconds = 4;
struct Lead {
  float turn_seconds = 0;    // whichever way it turns: what may be near in that time is wanted as far as budgets have room beside all else
  float active_seconds = 0;  // on its way: until a tile that is active counts. Not less
  float shown_seconds = 0;   // until patches are shown by light of their own; not less. Coarser levels, which reach farther, have less of it (wanted_tiles.cpp)
  friend bool operator==(const Lead&, const Lead&) = default;
};

// How much of what the settings ask for there was room for.
enum class Budget : uint32_t { kNone, kNodes, kPatches, kMemory };  // max_nodes, max_level0_nodes, memory_bytes
struct Reach {
  float radius_m = 0, growth = 0;     // as if these had been asked for; about, where tiles that stay by hysteresis take room
  Budget short_of = Budget::kNone;    // what ran out first; kNone: nothing
  friend bool operator==(const Reach&, const Reach&) = default;
};

struct StreamStats {
  uint64_t reads = 0, strips_read = 0;     // strips that lie beside each other share a read
  uint64_t bytes_read = 0, gap_bytes = 0;  // of strips; of what lies between them and was read, too
  uint64_t evicted = 0, cancelled = 0, failed = 0;
  uint64_t resident_bytes = 0, peak_resident_bytes = 0;
  uint64_t peak_stored_bytes = 0;  // of strips that were read and not decoded yet
  double decode_ms = 0;            // of the decoding threads' time
  uint32_t resident_tiles = 0, wanted_tiles = 0, pending_tiles = 0;
  uint64_t reads_held = 0;   // that began later than they could have, for read_bytes_per_second
  uint32_t late_tiles = 0;   // wanted by the last update() and not active
  uint32_t ahead_tiles = 0;  // that the observer's path will want: read ahead, or to be
  Reach reach;               // of the last update()
  Reach first_short;         // the first one that was short of anything,
  Vec3 first_short_at;       // and where its first observer was, m
};

class Streamer {
 public:
  // The world must outlive the streamer. source: null takes the world's own shards (io_uring, else threads; probed).
  // now: the time that read_bytes_per_second counts by; called on any thread.
  static Result<std::unique_ptr<Streamer>> create(const formats::World& world, const StreamSettings& settings,
                                                  std::unique_ptr<TileSource> source = nullptr, Now now = std::chrono::steady_clock::now);
  virtual ~Streamer() = default;
  // Within which a tile is wanted, m, by level; less where a budget runs out.
  std::span<const float> radii() const { return radii_m_; }
  // Of all wanted tiles together.
  uint32_t maxNodes() const { return max_nodes_; }

  // By an observer's velocity, and by how it turns, its path is foretold and read ahead; each keeps its number from call to call. Budgets are of all
  // together: where they run out, the same smaller radius is everybody's. Returns true if the active set has changed.
  virtual bool update(const Observers& observers) = 0;
  bool update(Vec3 observer, Vec3 velocity) { return update(Observers(Observer{observer, velocity})); }
  // Places where observers will be, kMaxObservers at most: what is wanted there is read ahead, the nearest deadline first, within hint_bytes and what memory
  // is left. Replaces those before; each is forgotten kHintStays after its time.
  virtual void expect(std::span<const Hint> hints) = 0;
  virtual std::span<const Hint> expected() const = 0;
  // From the next update() on.
  virtual void setLead(const Lead& lead) = 0;
  // Active strips, sorted by (level, tile). A level-l tile is active when it is wanted, resident, and its parent tile
  // is active, or could not be read and would be active else: so the ancestors of an active node are active too, but for those that failed. Valid until the next update();
  // the strips themselves live as long as someone holds them, and are freed by one of the streamer's threads some time
  // after the last has let go.
  std::span<const StripPtr> active() const { return *activeList(); }
  // The same list, to hold: another one whenever the set has changed.
  virtual const StripList& activeList() const = 0;
  // Blocks until nothing is pending for the last observers and their paths (tests, headless pictures), calling update() as it goes.
  virtual Result<void> settle() = 0;
  virtual StreamStats stats() const = 0;
  // The last strip that could not be read or decoded, as a line with its remedy; empty: none yet.
  virtual std::string lastFailure() const = 0;

 protected:
  Streamer(std::vector<float> radii_m, uint32_t max_nodes) : radii_m_(std::move(radii_m)), max_nodes_(max_nodes) {}

 private:
  const std::vector<float> radii_m_;
  const uint32_t max_nodes_;
};

}  // namespace ff::stream
