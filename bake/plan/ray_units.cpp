#include "bake/plan/ray_units.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <numeric>
#include <optional>
#include <set>

#include "bake/all_threads.h"
#include "bake/bake_code.h"
#include "bake/packing.h"
#include "formats/codec/bytes.h"

namespace ff::bake {
namespace {

using formats::ByteReader, formats::ByteWriter;
using Raw = std::vector<std::byte>;

constexpr std::string_view kRays = "rays", kContents = "contents";

// A part of a record: its size, that of its zstd frame, the frame. One that memory ran out for will not be read.
void putPart(ByteWriter& out, const Raw& raw) {
  const Raw frame = packed(raw);
  out.u64(raw.size());
  out.u64(frame.size());
  out.data().insert(out.data().end(), frame.begin(), frame.end());
}

std::optional<Raw> takePart(ByteReader& in, std::span<const std::byte> record) {
  uint64_t size = 0, frame = 0;
  in.u64(size);
  in.u64(frame);
  const size_t at = in.position();
  in.unused(frame);
  return in.ok() ? unpacked(record.subspan(at, frame), size) : std::nullopt;
}

void putDigest(ByteWriter& out, const Digest& d) { out.u64(d[0]), out.u64(d[1]); }

// Where a unit's rays went, and what it was that they met. Cubes are by number in a box, which may not be today's.
struct Trail {
  CubeBox box;
  bool left = false;
  std::vector<CubesOfBlock> passed;
  std::vector<uint64_t> met;  // cubes of 2^kMetLog cells that patches lie in which were hit, by Hilbert key, ascending
  Digest seen{};              // of all of it
};

Digest seenNow(const Contents& contents, const CubeBox& box, std::span<const CubesOfBlock> passed, std::span<const uint64_t> met) {
  std::vector<Digest> all;
  for (const auto& [block, cubes] : passed) contents.append(box.cube(64 * block), cubes, uint64_t{64} * block, all);
  for (const uint64_t key : met) all.push_back(contents.patchesIn(key));
  return digestOf(std::as_bytes(std::span(all)));
}

void putBox(ByteWriter& out, const CubeBox& box) {
  out.f32(box.edge_m);
  for (const auto* corner : {&box.lo, &box.size})
    for (const int32_t x : *corner) out.u32(static_cast<uint32_t>(x));
}

CubeBox takeBox(ByteReader& in) {
  CubeBox box;
  in.f32(box.edge_m);
  for (auto* corner : {&box.lo, &box.size})
    for (int32_t& x : *corner) {
      uint32_t value = 0;
      in.u32(value);
      x = static_cast<int32_t>(value);
    }
  return box;
}

Raw encodeTrail(const Contents& contents, const RayTrail& trail, std::span<const uint64_t> met) {
  ByteWriter out;
  const std::vector<CubesOfBlock> passed = trail.passed();
  putDigest(out, seenNow(contents, contents.box(), passed, met));
  putBox(out, contents.box());
  out.u8(trail.left());
  putVarint(out, passed.size());
  uint32_t last = 0;
  for (const CubesOfBlock& of : passed) {
    putVarint(out, of.block - last);
    last = of.block;
  }
  for (const CubesOfBlock& of : passed) out.u64(of.cubes);
  putVarint(out, met.size());
  uint64_t key = 0;
  for (const uint64_t m : met) {
    putVarint(out, m - key);
    key = m;
  }
  return std::move(out.data());
}

std::optional<Trail> decodeTrail(std::span<const std::byte> raw) {
  ByteReader in(raw);
  Trail trail;
  in.u64(trail.seen[0]);
  in.u64(trail.seen[1]);
  trail.box = takeBox(in);
  uint8_t left = 0;
  in.u8(left);
  trail.left = left != 0;
  for (const int32_t x : trail.box.size) if (x < 1 || x % CubeBox::kBlock != 0) return {};
  uint64_t block = 0;
  for (uint64_t left_over = takeVarint(in); left_over > 0 && in.ok(); --left_over) {
    block += takeVarint(in);
    if (block >= trail.box.blocks()) return {};
    trail.passed.push_back({static_cast<uint32_t>(block), 0});
  }
  for (CubesOfBlock& of : trail.passed) in.u64(of.cubes);
  uint64_t key = 0;
  for (uint64_t left_over = takeVarint(in); left_over > 0 && in.ok(); --left_over) trail.met.push_back(key += takeVarint(in));
  return in.ok() ? std::optional(std::move(trail)) : std::nullopt;
}

// Whether nothing has changed where rays went. What stands outside of the box now was not there when they left it.
bool isSeenStill(const Contents& contents, const Trail& trail) {
  const CubeBox& now = contents.box();
  if (trail.box.edge_m != now.edge_m) return false;
  for (size_t a = 0; trail.left && a < 3; ++a)
    if (now.lo[a] < trail.box.lo[a] || now.lo[a] + now.size[a] > trail.box.lo[a] + trail.box.size[a]) return false;
  return seenNow(contents, trail.box, trail.passed, trail.met) == trail.seen;
}

}  // namespace

RayUnits::RayUnits(const Scene& scene, const PatchSet& set, RayBudget budget, uint64_t seed, BakeCache& cache)
    : scene_(scene), set_(set), budget_(budget), seed_(seed), cache_(cache), contents_(scene, set), start_(castRanges(set)), keys_(units()) {
  ByteWriter b;
  b.u32(kBakeCode);
  b.u32(budget.rays);
  b.f32(budget.target_error);
  b.u64(seed);
  b.f32(set.cell_m);
  b.u8(static_cast<uint8_t>(scene.backs));
  for (const double x : scene.origin) b.f64(x);
  settings_ = digestOf(b.data());
  tbb::parallel_for(size_t{0}, units(), [&](size_t u) {
    ByteWriter key;
    for (const Digest& d : {settings_, contents_.lamps(), contents_.surface(start_[u], start_[u + 1])}) putDigest(key, d);
    keys_[u] = digestOf(key.data());
  });
}

// Columns are patches of the whole set, ascending, so that those of one cube of 2^kMetLog cells follow each other: runs, within which patches
// count from the first of their cube.
std::vector<std::byte> RayUnits::encode(const HitRows& rows, const RayTrail& trail) const {
  const size_t n = rows.rays.size();
  std::vector<uint64_t> met;
  for (const uint32_t j : rows.column) {
    const uint64_t key = hilbertAncestor(set_.patches[j].key, kMetLog);
    if (met.empty() || met.back() != key) met.push_back(key);
  }
  std::sort(met.begin(), met.end());
  met.erase(std::unique(met.begin(), met.end()), met.end());
  std::vector<std::pair<uint32_t, uint32_t>> ranges;
  for (const uint64_t key : met) ranges.push_back(contents_.rangeOf(key));

  ByteWriter raw, runs, index, counts;
  putSeen(raw, rows);
  for (size_t i = 0; i < n; ++i) {
    putVarint(runs, rows.start[i + 1] - rows.start[i]);
    size_t range = 0, last_range = 0;
    for (uint64_t k = rows.start[i]; k < rows.start[i + 1];) {
      while (rows.column[k] >= ranges[range].second) ++range;
      uint64_t end = k;
      while (end < rows.start[i + 1] && rows.column[end] < ranges[range].second) ++end;
      putVarint(runs, range - last_range);
      putVarint(runs, end - k);
      last_range = range;
      for (uint32_t last = ranges[range].first; k < end; ++k) {
        putVarint(index, rows.column[k] - last);
        last = rows.column[k];
        putVarint(counts, rows.count[k]);
      }
    }
  }
  ByteWriter record;
  putPart(record, encodeTrail(contents_, trail, met));
  for (ByteWriter* part : {&raw, &runs, &index, &counts}) putPart(record, part->data());
  return std::move(record.data());
}

namespace {

// Rows of `patches` patches; nothing where the record is not what encode() writes.
std::optional<HitRows> decodeRows(ByteReader& record, std::span<const std::byte> bytes, const Contents& contents, const Trail& trail, size_t patches) {
  std::array<Raw, 4> parts;
  for (Raw& part : parts) {
    auto taken = takePart(record, bytes);
    if (!taken) return {};
    part = std::move(*taken);
  }
  ByteReader raw(parts[0]), runs(parts[1]), index(parts[2]), counts(parts[3]);
  HitRows rows;
  if (!takeSeen(raw, parts[0], rows) || rows.patches() != patches) return {};
  std::vector<std::pair<uint32_t, uint32_t>> ranges;
  for (const uint64_t key : trail.met) ranges.push_back(contents.rangeOf(key));
  rows.start.push_back(0);
  for (size_t i = 0; i < patches; ++i) {
    const uint64_t entries = takeVarint(runs);
    for (uint64_t k = 0, range = 0; k < entries;) {
      range += takeVarint(runs);
      const uint64_t in_run = takeVarint(runs);
      if (range >= ranges.size() || in_run == 0 || in_run > entries - k) return {};
      uint64_t column = ranges[range].first;
      for (uint64_t e = 0; e < in_run; ++e, ++k) {
        column += takeVarint(index);
        if (column >= ranges[range].second) return {};
        rows.column.push_back(static_cast<uint32_t>(column));
        rows.count.push_back(static_cast<uint16_t>(takeVarint(counts)));
      }
    }
    rows.start.push_back(rows.column.size());
  }
  if (!(raw.ok() && runs.ok() && index.ok() && counts.ok())) return {};
  return rows;
}

UnitCounts countsOf(std::span<const UnitState> states) {
  UnitCounts counts;
  for (const UnitState s : states) ++(s == UnitState::kClean ? counts.clean : s == UnitState::kStale ? counts.stale : counts.missing);
  return counts;
}

}  // namespace

UnitState RayUnits::load(size_t unit, HitRows* rows) const {
  const auto bytes = cache_.load(kRays, keys_[unit]);
  if (!bytes) return UnitState::kMissing;
  ByteReader record(*bytes);
  const auto raw = takePart(record, *bytes);
  const auto trail = raw ? decodeTrail(*raw) : std::nullopt;
  if (!trail) return UnitState::kMissing;
  if (!isSeenStill(contents_, *trail)) return UnitState::kStale;
  if (!rows) return UnitState::kClean;
  auto decoded = decodeRows(record, *bytes, contents_, *trail, start_[unit + 1] - start_[unit]);
  if (!decoded) return UnitState::kMissing;
  *rows = std::move(*decoded);
  return UnitState::kClean;
}

// Casts units and keeps their hits in the cache.
class RayUnits::Casting {
 public:
  Casting(const RayUnits& units, const RayCaster& caster)
      : units_(units), caster_(units.scene_, units.set_, caster, units.budget_, units.seed_), trails_([&] { return RayTrail(units.contents_.box()); }) {}

  HitRows cast(size_t unit, WorkCount& done) {
    RayTrail& trail = trails_.local();
    trail.clear();
    HitRows rows = caster_.cast(units_.start_[unit], units_.start_[unit + 1], &trail, done);
    units_.cache_.store(kRays, units_.keys_[unit], units_.encode(rows, trail));
    return rows;
  }

 private:
  const RayUnits& units_;
  const RowCaster caster_;
  tbb::enumerable_thread_specific<RayTrail> trails_;
};

namespace {

// Who casts which unit. Thread-safe.
class Handout {
 public:
  explicit Handout(std::vector<uint32_t> units) : units_(std::move(units)) {}

  // For this rank: what another has done comes first, then what nobody has begun; in the end what others have begun is cast here as well, lest they
  // be gone.
  struct Work {
    uint32_t unit = kNoUnit;
    bool in_cache = false;
  };
  Work own() {
    const std::lock_guard lock(mutex_);
    if (!done_.empty()) return {takeFirst(done_), true};
    if (next_ < units_.size()) return {units_[next_++], false};
    return {begun_.empty() ? kNoUnit : takeFirst(begun_), false};
  }
  // For another.
  uint32_t others() {
    const std::lock_guard lock(mutex_);
    if (next_ == units_.size()) return kNoUnit;
    begun_.insert(units_[next_]);
    return units_[next_++];
  }
  // It is in the cache. Too late where it is cast here already.
  void isDone(uint32_t unit) {
    const std::lock_guard lock(mutex_);
    if (begun_.erase(unit)) done_.insert(unit);
  }

 private:
  static uint32_t takeFirst(std::set<uint32_t>& units) { return units.extract(units.begin()).value(); }

  const std::vector<uint32_t> units_;
  std::mutex mutex_;
  size_t next_ = 0;
  std::set<uint32_t> begun_, done_;  // by others
};

}  // namespace

void RayUnits::cast(const RayCaster& caster, WorkCount& done, UnitCounts& counts, const TakeRows& take, Ranks* ranks) {
  std::vector<UnitState> states(units());
  std::atomic<uint64_t> clean_rays{0};
  tbb::parallel_for(size_t{0}, units(), [&](size_t u) {  // all of them first: what is left of the cache then may be trimmed
    HitRows rows;
    states[u] = load(u, &rows);
    if (states[u] != UnitState::kClean) return;
    clean_rays += std::accumulate(rows.rays.begin(), rows.rays.end(), uint64_t{0});
    take(start_[u], std::move(rows));
    done.add(start_[u + 1] - start_[u]);
  });
  counts = countsOf(states);
  counts.clean_rays = clean_rays;
  std::vector<uint32_t> missing;
  for (uint32_t u = 0; u < units(); ++u)
    if (states[u] != UnitState::kClean) missing.push_back(u);
  Handout handout(std::move(missing));
  if (ranks) ranks->serve([&] { return handout.others(); }, [&](uint32_t unit) { handout.isDone(unit); });
  const auto ended = [](Ranks* r) { if (r) r->endUnits(); };
  const std::unique_ptr<Ranks, decltype(ended)> end(ranks, ended);  // before the handout goes
  Casting casting(*this, caster);
  std::atomic<uint64_t> by_others{0};
  onAllThreads([&] {
    for (Handout::Work work = handout.own(); work.unit != kNoUnit; work = handout.own()) {
      HitRows rows;
      if (work.in_cache && load(work.unit, &rows) == UnitState::kClean) {
        ++by_others;
        done.add(start_[work.unit + 1] - start_[work.unit]);
      } else {
        rows = casting.cast(work.unit, done);
      }
      take(start_[work.unit], std::move(rows));
    }
  });
  counts.by_others = by_others;
  cache_.store(kContents, settings_, contents_.encoded());
}

void RayUnits::help(const RayCaster& caster, WorkCount& done, Ranks& ranks) {
  Casting casting(*this, caster);
  onAllThreads([&] {
    for (uint32_t unit = ranks.ask(kNoUnit); unit < units(); unit = ranks.ask(unit)) casting.cast(unit, done);
  });
}

UnitCounts RayUnits::status(WorkCount& done, std::vector<Vec3>& changed) {
  std::vector<UnitState> states(units());
  tbb::parallel_for(size_t{0}, units(), [&](size_t u) {
    states[u] = load(u, nullptr);
    done.add(start_[u + 1] - start_[u]);
  });
  changed.clear();
  if (const auto before = cache_.load(kContents, settings_)) changed = contents_.changesSince(*before);
  return countsOf(states);
}

}  // namespace ff::bake
