#include "bake/plan/ray_units.h"

#include <tbb/combinable.h>
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
#include "bake/plan/kept_trail.h"
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

}  // namespace

struct RayUnits::Group {
  KeptTrail trail;
  bool clean = false;             // its rows
  GroupRows cast;                 // of a clean one; the light of lamps where it is `lit`
  KeptTrail lamp_trail;           // keptBeyond() `trail`
  uint64_t all_lamps = 0;         // LampDigests::all()
  std::vector<uint64_t> lamps;    // LampDigests::of(), by patch
  std::vector<uint8_t> lit;       // by patch: its light of lamps is clean, too
  size_t litPatches() const { return static_cast<size_t>(std::count(lit.begin(), lit.end(), 1)); }
  bool isLit() const { return clean && litPatches() == lit.size(); }
};

CachedRays& CachedRays::operator+=(const CachedRays& more) {
  for (const auto part : {&CachedRays::rows, &CachedRays::lamps}) {
    (this->*part).clean += (more.*part).clean;
    (this->*part).stale += (more.*part).stale;
    (this->*part).missing += (more.*part).missing;
  }
  clean_rays += more.clean_rays;
  by_others += more.by_others;
  return *this;
}

RayUnits::RayUnits(const Scene& scene, const PatchSet& set, const RayCaster& caster, RayBudget budget, uint64_t seed, BakeCache& cache)
    : scene_(scene), set_(set), caster_(caster), budget_(budget), seed_(seed), cache_(cache), contents_(scene, set), lamps_(scene, set, caster),
      lamp_digests_(lamps_, set, contents_), start_(castRanges(set)), keys_(units()) {
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
    for (const Digest& d : {settings_, contents_.surface(start_[u], start_[u + 1])}) key.u64(d[0]), key.u64(d[1]);
    keys_[u] = digestOf(key.data());
  });
}

namespace {

// The parts of a unit's file, group after group. Columns are patches of the whole set, ascending, so that those of one cube of 2^kMetLog cells
// follow each other: runs, within which patches count from the first of their cube.
constexpr size_t kParts = 8;
enum UnitPart { kTrails, kSights, kRuns, kIndex, kHits, kLampTrails, kLampKeys, kLampRays };

using Ranges = std::vector<std::pair<uint32_t, uint32_t>>;
Ranges rangesOf(const Contents& contents, std::span<const uint64_t> met) {
  Ranges ranges;
  for (const uint64_t key : met) ranges.push_back(contents.rangeOf(key));
  return ranges;
}

void putRows(std::array<ByteWriter, kParts>& out, const HitRows& rows, const Ranges& ranges) {
  putSeen(out[kSights], rows);
  for (size_t i = 0; i < rows.patches(); ++i) {
    putVarint(out[kRuns], rows.start[i + 1] - rows.start[i]);
    size_t range = 0, last_range = 0;
    for (uint64_t k = rows.start[i]; k < rows.start[i + 1];) {
      while (rows.column[k] >= ranges[range].second) ++range;
      uint64_t end = k;
      while (end < rows.start[i + 1] && rows.column[end] < ranges[range].second) ++end;
      putVarint(out[kRuns], range - last_range);
      putVarint(out[kRuns], end - k);
      last_range = range;
      for (uint32_t last = ranges[range].first; k < end; ++k) {
        putVarint(out[kIndex], rows.column[k] - last);
        last = rows.column[k];
        putHits(out[kHits], rows, k);
      }
    }
  }
}

// A unit's file, read.
struct UnitFile {
  std::array<Raw, kParts> raw;
  std::vector<ByteReader> in;  // of the parts
  bool ok() const { return std::all_of(in.begin(), in.end(), [](const ByteReader& r) { return r.ok(); }); }
};

// What putRows() wrote. ranges: null where patches may have changed since: what comes out is of no use then. False where it is not what putRows()
// writes.
bool takeRows(UnitFile& file, const Ranges* ranges, HitRows& rows) {
  if (!takeSeen(file.in[kSights], file.raw[kSights], rows)) return false;
  rows.start.push_back(0);
  for (size_t i = 0; i < rows.patches(); ++i) {
    const uint64_t entries = takeVarint(file.in[kRuns]);
    for (uint64_t k = 0, range = 0; k < entries;) {
      range += takeVarint(file.in[kRuns]);
      const uint64_t in_run = takeVarint(file.in[kRuns]);
      if (in_run == 0 || in_run > entries - k || (ranges && range >= ranges->size())) return false;
      const auto [first, end] = ranges ? (*ranges)[range] : std::pair(0u, kNone);
      uint64_t column = first;
      for (uint64_t e = 0; e < in_run; ++e, ++k) {
        column += takeVarint(file.in[kIndex]);
        if (column >= end || !file.in[kIndex].ok()) return false;
        rows.column.push_back(static_cast<uint32_t>(column));
        takeHits(file.in[kHits], rows);
      }
    }
    rows.start.push_back(rows.column.size());
  }
  return file.ok();
}

void putLampRays(ByteWriter& out, const GroupRows& cast) {
  const HitRows& rows = cast.rows;
  auto entry = cast.to_lamps.entry.begin();
  auto ray = cast.to_lamps.ray.begin();
  for (size_t i = 0; i < rows.patches(); ++i) {
    const auto end = std::lower_bound(entry, cast.to_lamps.entry.end(), rows.start[i + 1]);
    putVarint(out, static_cast<uint64_t>(end - entry));
    for (uint64_t last = rows.start[i]; entry != end; last = *entry++) {
      putVarint(out, *entry - last);
      uint16_t last_ray = 0;
      for (const auto last_of_it = ray + rows.count[*entry]; ray != last_of_it; last_ray = *ray++) putVarint(out, uint64_t{*ray} - last_ray);
    }
  }
}

// What putLampRays() wrote. False where it is not that.
bool takeLampRays(ByteReader& in, GroupRows& cast) {
  const HitRows& rows = cast.rows;
  for (size_t i = 0; i < rows.patches(); ++i) {
    uint64_t entry = rows.start[i];
    for (uint64_t left = takeVarint(in); left > 0; --left) {
      entry += takeVarint(in);
      if (entry >= rows.start[i + 1] || !in.ok()) return false;
      cast.to_lamps.entry.push_back(entry);
      uint64_t ray = 0;
      for (uint32_t of_entry = rows.count[entry]; of_entry > 0; --of_entry) {
        ray += takeVarint(in);
        if (ray >= rows.rays[i]) return false;
        cast.to_lamps.ray.push_back(static_cast<uint16_t>(ray));
      }
    }
  }
  return in.ok();
}

// Whether rays of rows end on a patch that has begun to emit.
bool meetsNewLamp(const GroupRows& cast, const LampTree& lamps) {
  if (lamps.empty()) return false;
  auto known = cast.to_lamps.entry.begin();
  for (uint64_t k = 0; k < cast.rows.column.size(); ++k) {
    if (known != cast.to_lamps.entry.end() && *known == k) ++known;
    else if (lamps.leafOf(cast.rows.column[k]) != kNone) return true;
  }
  return false;
}

bool isClean(std::span<const RayUnits::Group> groups) {
  return !groups.empty() && std::all_of(groups.begin(), groups.end(), [](const RayUnits::Group& g) { return g.isLit(); });
}

HitRows rowsOf(std::vector<RayUnits::Group> groups, float cell_m) {
  std::vector<HitRows> rows;
  for (RayUnits::Group& g : groups) rows.push_back(std::move(g.cast.rows));
  return rowsOfRange(std::move(rows), cell_m);
}

}  // namespace

std::vector<uint64_t> RayUnits::lampDigests(uint32_t first, const GroupRows& cast) const {
  std::vector<uint64_t> digests;
  std::vector<uint32_t> met;
  auto entry = cast.to_lamps.entry.begin();
  for (size_t i = 0; i < cast.rows.patches(); ++i) {
    met.clear();
    for (; entry != cast.to_lamps.entry.end() && *entry < cast.rows.start[i + 1]; ++entry) met.push_back(cast.rows.column[*entry]);
    digests.push_back(lamp_digests_.of(first + static_cast<uint32_t>(i), met));
  }
  return digests;
}

std::vector<RayUnits::Group> RayUnits::load(size_t unit) const {
  const auto bytes = cache_.load(kRays, keys_[unit]);
  if (!bytes) return {};
  ByteReader record(*bytes);
  UnitFile file;
  for (size_t part = 0; part < kParts; ++part) {
    auto taken = takePart(record, *bytes);
    if (!taken) return {};
    file.raw[part] = std::move(*taken);
    file.in.emplace_back(file.raw[part]);
  }
  const std::vector<uint32_t> start = castGroups(set_, start_[unit], start_[unit + 1]);
  std::vector<KeptTrail> trails = takeTrails(file.in[kTrails], start.size() - 1), lamp_trails = takeTrails(file.in[kLampTrails], start.size() - 1);
  if (trails.empty() || lamp_trails.empty()) return {};
  std::vector<Group> groups(trails.size());
  for (size_t g = 0; g < groups.size(); ++g) {
    Group& group = groups[g];
    const size_t n = start[g + 1] - start[g];
    group.trail = std::move(trails[g]);
    group.lamp_trail = std::move(lamp_trails[g]);
    group.clean = isAsItWas(group.trail, contents_);
    const Ranges ranges = rangesOf(contents_, group.trail.met);
    if (!takeRows(file, group.clean ? &ranges : nullptr, group.cast.rows) || group.cast.rows.patches() != n || !takeLampRays(file.in[kLampRays], group.cast)) return {};
    file.in[kLampKeys].u64(group.all_lamps);
    takeValues(file.in[kLampKeys], file.raw[kLampKeys], n, group.lamps);
    if (!file.ok()) return {};
    group.clean = group.clean && !meetsNewLamp(group.cast, lamps_);
    group.lit.assign(n, 0);
    if (!group.clean) {
      group.cast = {};
    } else if (isAsItWas(group.lamp_trail, contents_)) {
      if (group.all_lamps == lamp_digests_.all()) group.lit.assign(n, 1);
      else std::ranges::transform(lampDigests(start[g], group.cast), group.lamps, group.lit.begin(), std::equal_to());
    }
  }
  return groups;
}

void RayUnits::store(size_t unit, std::span<const Group> groups) const {
  std::array<ByteWriter, kParts> parts;
  std::vector<const KeptTrail*> trails, lamp_trails;
  for (const Group& group : groups) {
    trails.push_back(&group.trail);
    lamp_trails.push_back(&group.lamp_trail);
    putRows(parts, group.cast.rows, rangesOf(contents_, group.trail.met));
    putLampRays(parts[kLampRays], group.cast);
    parts[kLampKeys].u64(group.all_lamps);
    putValues(parts[kLampKeys], group.lamps);
  }
  putTrails(parts[kTrails], trails);
  putTrails(parts[kLampTrails], lamp_trails);
  ByteWriter record;
  for (ByteWriter& part : parts) putPart(record, part.data());
  cache_.store(kRays, keys_[unit], record.data());
}

void RayUnits::count(size_t unit, std::span<const Group> groups, CachedRays& found) const {
  if (groups.empty()) {
    found.rows.missing += start_[unit + 1] - start_[unit];
    found.lamps.missing += start_[unit + 1] - start_[unit];
  }
  const std::vector<uint32_t> start = castGroups(set_, start_[unit], start_[unit + 1]);
  for (size_t g = 0; g < groups.size(); ++g) {
    const size_t n = start[g + 1] - start[g], lit = groups[g].litPatches();
    (groups[g].clean ? found.rows.clean : found.rows.stale) += n;
    found.lamps.clean += lit;
    found.lamps.stale += n - lit;
    found.clean_rays = std::accumulate(groups[g].cast.rows.rays.begin(), groups[g].cast.rows.rays.end(), found.clean_rays);
  }
}

// Casts what is not clean of units, and keeps it in the cache.
class RayUnits::Casting {
 public:
  explicit Casting(const RayUnits& units)
      : units_(units), caster_(units.scene_, units.set_, units.caster_, units.lamps_, units.budget_, units.seed_), trails_([&] { return Trails(units.contents_.box()); }) {}

  HitRows cast(size_t unit, WorkCount& done) {
    const std::vector<uint32_t> start = castGroups(units_.set_, units_.start_[unit], units_.start_[unit + 1]);
    std::vector<Group> groups = units_.load(unit);
    groups.resize(start.size() - 1);
    for (size_t g = 0; g < groups.size(); ++g) {
      if (!groups[g].clean) castAll(start[g], start[g + 1], groups[g], done);
      else {
        if (!groups[g].isLit()) castLamps(start[g], groups[g]);
        done.add(start[g + 1] - start[g]);
      }
    }
    units_.store(unit, groups);
    return rowsOf(std::move(groups), units_.set_.cell_m);
  }

 private:
  struct Trails {
    explicit Trails(const CubeBox& box) : rows(box), lamps(box) {}
    RayTrail rows, lamps;
  };

  void castAll(uint32_t first, uint32_t end, Group& group, WorkCount& done) {
    Trails& trails = trails_.local();
    trails.rows.clear();
    trails.lamps.clear();
    group.cast = caster_.cast(first, end, &trails.rows, &trails.lamps, done);
    group.trail = keptTrail(trails.rows, group.cast.rows, units_.set_, units_.contents_);
    group.lamp_trail = keptBeyond(group.trail, trails.lamps, nullptr, units_.contents_);
    keepLampDigests(first, group);
  }

  void castLamps(uint32_t first, Group& group) {
    const bool same_box = group.lamp_trail.box == units_.contents_.box();
    if (!same_box) std::ranges::fill(group.lit, 0);  // else its trail and that of today could not be one
    std::vector<uint32_t> again;
    for (uint32_t i = 0; i < group.lit.size(); ++i)
      if (!group.lit[i]) again.push_back(first + i);
    RayTrail& trail = trails_.local().lamps;
    trail.clear();
    caster_.castLamps(first, again, &trail, group.cast);
    group.lamp_trail = keptBeyond(group.trail, trail, again.size() < group.lit.size() ? &group.lamp_trail : nullptr, units_.contents_);
    keepLampDigests(first, group);
  }

  void keepLampDigests(uint32_t first, Group& group) const {
    group.all_lamps = units_.lamp_digests_.all();
    group.lamps = units_.lampDigests(first, group.cast);
  }

  const RayUnits& units_;
  const RowCaster caster_;
  tbb::enumerable_thread_specific<Trails> trails_;
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

void RayUnits::cast(WorkCount& done, CachedRays& found, const TakeRows& take, Ranks* ranks) {
  tbb::combinable<CachedRays> counts;
  std::vector<uint8_t> clean(units());
  tbb::parallel_for(size_t{0}, units(), [&](size_t u) {  // all of them first: what is left of the cache then may be trimmed
    std::vector<Group> groups = load(u);
    count(u, groups, counts.local());
    if (!isClean(groups)) return;
    clean[u] = true;
    take(start_[u], rowsOf(std::move(groups), set_.cell_m));
    done.add(start_[u + 1] - start_[u]);
  });
  counts.combine_each([&](const CachedRays& of) { found += of; });
  std::vector<uint32_t> rest;
  for (uint32_t u = 0; u < units(); ++u)
    if (!clean[u]) rest.push_back(u);
  Handout handout(std::move(rest));
  if (ranks) ranks->serve([&] { return handout.others(); }, [&](uint32_t unit) { handout.isDone(unit); });
  const auto ended = [](Ranks* r) { if (r) r->endUnits(); };
  const std::unique_ptr<Ranks, decltype(ended)> end(ranks, ended);  // before the handout goes
  Casting casting(*this);
  std::atomic<uint64_t> by_others{0};
  onAllThreads([&] {
    for (Handout::Work work = handout.own(); work.unit != kNoUnit; work = handout.own()) {
      const uint32_t first = start_[work.unit], patches = start_[work.unit + 1] - first;
      std::vector<Group> groups;
      if (work.in_cache) groups = load(work.unit);
      if (isClean(groups)) {
        by_others += patches;
        done.add(patches);
        take(first, rowsOf(std::move(groups), set_.cell_m));
      } else {
        take(first, casting.cast(work.unit, done));
      }
    }
  });
  found.by_others = by_others;
  cache_.store(kContents, settings_, contents_.encoded());
}

void RayUnits::help(WorkCount& done, Ranks& ranks) {
  Casting casting(*this);
  onAllThreads([&] {
    for (uint32_t unit = ranks.ask(kNoUnit); unit < units(); unit = ranks.ask(unit)) casting.cast(unit, done);
  });
}

CachedRays RayUnits::status(WorkCount& done, std::vector<Vec3>& changed) {
  tbb::combinable<CachedRays> counts;
  tbb::parallel_for(size_t{0}, units(), [&](size_t u) {
    count(u, load(u), counts.local());
    done.add(start_[u + 1] - start_[u]);
  });
  changed.clear();
  if (const auto before = cache_.load(kContents, settings_)) changed = contents_.changesSince(*before);
  CachedRays found;
  counts.combine_each([&](const CachedRays& of) { found += of; });
  return found;
}

}  // namespace ff::bake
