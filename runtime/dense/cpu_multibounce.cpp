#include "runtime/dense/cpu_multibounce.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "runtime/clock.h"
#include "runtime/dense/bounce_planes.h"
#include "runtime/dense/places.h"

namespace ff::runtime {
namespace {

float channelOf(const Vec4& v, uint32_t c) { return c == 0 ? v.x : c == 1 ? v.y : v.z; }
Error refusal(std::string message) {
  return Error{ErrorCode::kInvalidFile, "", "", std::move(message), "store fp32, or use the gather solver"};
}

template <class Element>
class CpuMultibounce final : public BounceMatrix {
 public:
  explicit CpuMultibounce(const MultibounceSettings& settings)
      : settings_(settings),
        pool_(settings.threads),
        planes_(settings.places, settings.luminance ? 1 : 3, pool_),
        places_(settings.places),
        colour_(settings.places),
        row_sum_(settings.places, 0.0f),
        row_sum_before_(settings.places, 0.0f),
        columns_(settings.places, 0),
        changed_at_(settings.places, 0) {
    const uint32_t rows = (settings.places + kPanelRows - 1) / kPanelRows * kPanelRows;
    for (auto& f : factors_) f.assign(rows, 0);
    for (auto& e : light_) e.assign(rows, 0);
    name_ = std::string("multibounce cpu ") + (sizeof(Element) == 2 ? "fp16" : "fp32") +
            (settings.luminance ? " luminance" : "");
  }

  bool allocated() const { return planes_.allocated(); }
  uint32_t capacity() const override { return places_.capacity(); }
  uint64_t bytes() const override { return planes_.bytes(); }
  const char* name() const override { return name_.c_str(); }
  BounceStats stats() const override {
    BounceStats stats = stats_;
    stats.pending_columns = planes_.pendingColumns();
    return stats;
  }

  Result<void> insert(const EnteringBlock& block) override {
    const auto start = Clock::now();
    const auto k = static_cast<uint32_t>(block.places.size());
    FF_CHECK_LT(0u, k);
    FF_CHECK_LE(k, kMaxBlock);
    if (!hasValidFormFactors(block)) return refusal("a form factor is not a finite number >= 0");
    row_sum_before_ = row_sum_;
    take(block);
    auto entered = clamp(block);
    if (entered && !planes_.enter(block))
      entered = refusal(std::string("light would be multiplied more than ") + (sizeof(Element) == 2 ? "fp16" : "fp32") +
                        " storage can carry: I - S C is singular to its precision");
    if (!entered) {
      unseat(block);
      return entered;
    }
    stats_.entered += k;
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> remove(std::span<const uint32_t> places) override {
    const auto start = Clock::now();
    for (size_t first = 0; first < places.size(); first += kMaxBlock) {
      const auto some = places.subspan(first, std::min<size_t>(kMaxBlock, places.size() - first));
      for (uint32_t i = 0; i < some.size(); ++i) {
        FF_CHECK_EQ(places_.taken(some[i]), true);
        for (uint32_t c = 0; c < planes_.channels(); ++c)
          change_[c][i] = -static_cast<double>(planes_.albedo(c, some[i]));
      }
      if (!planes_.change(some, change_, /*leave=*/true))
        return refusal("the matrix has lost its precision: I + G C is singular; rebuild it");
      for (const uint32_t place : some) {
        places_.give(place);
        row_sum_[place] = 0;
        colour_[place] = {};
      }
      planes_.use(places_.used());
      stats_.left += some.size();
    }
    stats_.last_update_ms = msSince(start);
    return {};
  }

  Result<void> clear() override {
    planes_.clear();
    places_.clear();
    std::fill(colour_.begin(), colour_.end(), Vec4{});
    std::fill(row_sum_.begin(), row_sum_.end(), 0.0f);
    return {};
  }

  Result<uint32_t> advance(uint32_t columns) override {
    const auto start = Clock::now();
    if (planes_.pendingColumns() == 0) return 0u;
    const uint32_t left = planes_.fold(columns);
    stats_.last_update_ms = msSince(start);
    return left;
  }

  Result<void> relight(std::span<const Vec4> source, std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    places_.checkLight(source, irradiance);
    foldUnlessSliced();
    const auto at = [&](uint32_t j) { return source[j]; };
    light(at, places_.used(), [](uint32_t i) { return i; });
    if (settings_.luminance)
      for (int i = 1; i < kLuminanceProducts; ++i) reflectColours(at);
    for (uint32_t i = 0; i < irradiance.size(); ++i)
      irradiance[i] = places_.taken(i) ? Vec4{light_[0][i], light_[1][i], light_[2][i], 0} : Vec4{};
    stats_.last_relight_ms = msSince(start);
    return {};
  }

  Result<void> relightChanged(std::span<const uint32_t> places, std::span<const Vec4> difference,
                              std::span<Vec4> irradiance) override {
    const auto start = Clock::now();
    places_.checkChange(places, difference, irradiance);
    foldUnlessSliced();
    light([&](uint32_t i) { return difference[i]; }, static_cast<uint32_t>(places.size()),
          [&](uint32_t i) { return places[i]; });
    if (settings_.luminance) {
      for (uint32_t i = 0; i < places.size(); ++i) changed_at_[places[i]] = i + 1;
      const auto at = [&](uint32_t j) { return changed_at_[j] ? difference[changed_at_[j] - 1] : Vec4{}; };
      for (int i = 1; i < kLuminanceProducts; ++i) reflectColours(at);
      for (const uint32_t place : places) changed_at_[place] = 0;
    }
    for (uint32_t i = 0; i < irradiance.size(); ++i) {
      if (!places_.taken(i)) continue;
      irradiance[i].x += light_[0][i];
      irradiance[i].y += light_[1][i];
      irradiance[i].z += light_[2][i];
    }
    stats_.last_relight_ms = msSince(start);
    return {};
  }

 private:
  float planeAlbedo(const Vec4& colour, uint32_t plane) const {
    return settings_.luminance ? (colour.x + colour.y + colour.z) / 3 : channelOf(colour, plane);
  }

  void setAlbedo(uint32_t place, const Vec4& colour) {
    colour_[place] = colour;
    for (uint32_t c = 0; c < planes_.channels(); ++c) planes_.setAlbedo(c, place, planeAlbedo(colour, c));
  }

  // Light is exact with factors pending, but not as fast.
  void foldUnlessSliced() {
    if (!settings_.time_slice) planes_.fold(kMaxPlaces);
  }

  void take(const EnteringBlock& block) {
    for (uint32_t r = 0; r < block.places.size(); ++r) {
      const uint32_t place = block.places[r];
      places_.take(place);
      float sum = 0;
      for (uint32_t e = block.row_start[r]; e < block.row_start[r + 1]; ++e) sum += block.row_values[e];
      row_sum_[place] = sum;
    }
    for (size_t e = 0; e < block.receivers.size(); ++e) row_sum_[block.receivers[e]] += block.column_values[e];
    planes_.use(places_.used());
  }

  void unseat(const EnteringBlock& block) {
    row_sum_ = row_sum_before_;
    for (const uint32_t place : block.places) {
      places_.give(place);
      setAlbedo(place, {});
    }
    planes_.use(places_.used());
  }

  // Lowers albedos that would keep all light. A row holds at most a whole hemisphere, so a sum that grew past 1 over
  // the comings and goings of its columns counts as 1; only albedos above kMaxKept are ever touched.
  bool lower(Vec4& colour, float row_sum) const {
    const float whole = std::min(row_sum, 1.0f), most = whole > 0 ? kMaxKept / whole : 2.0f;
    const Vec4 before = colour;
    colour = {std::min(colour.x, most), std::min(colour.y, most), std::min(colour.z, most), 0};
    return colour.x < before.x || colour.y < before.y || colour.z < before.z;
  }

  Result<void> clamp(const EnteringBlock& block) {
    for (uint32_t r = 0; r < block.places.size(); ++r) {
      Vec4 colour = block.albedo[r];
      if (!(std::isfinite(colour.x + colour.y + colour.z) && std::min({colour.x, colour.y, colour.z}) >= 0))
        return refusal("an albedo is not a finite number >= 0");
      if (lower(colour, row_sum_[block.places[r]])) ++stats_.clamped;
      setAlbedo(block.places[r], colour);
    }
    uint32_t lowered = 0;
    for (size_t e = 0; e < block.receivers.size(); ++e) {
      const uint32_t place = block.receivers[e];
      Vec4 colour = colour_[place];
      if (lower(colour, row_sum_[place])) {
        ++stats_.clamped;
        for (uint32_t c = 0; c < planes_.channels(); ++c)
          change_[c][lowered] =
              static_cast<double>(planeAlbedo(colour, c)) - static_cast<double>(planes_.albedo(c, place));
        lowered_places_[lowered++] = place;
        setAlbedo(place, colour);
      }
      if (lowered == kMaxBlock || (lowered > 0 && e + 1 == block.receivers.size())) {
        if (!planes_.change({lowered_places_.data(), lowered}, change_, /*leave=*/false))
          return refusal("the matrix has lost its precision");
        lowered = 0;
      }
    }
    return {};
  }

  // light_ = G value, over the places named.
  template <class Value, class Place>
  void light(Value&& value, uint32_t count, Place&& place) {
    uint32_t n = 0;
    for (uint32_t i = 0; i < count; ++i) {
      const Vec4 v = value(i);
      const uint32_t at = place(i);
      if (!places_.taken(at) || (v.x == 0 && v.y == 0 && v.z == 0)) continue;
      columns_[n] = at;
      for (uint32_t c = 0; c < 3; ++c) factors_[c][n] = channelOf(v, c);
      ++n;
    }
    const float* const factors[3] = {factors_[0].data(), factors_[1].data(), factors_[2].data()};
    float* const out[3] = {light_[0].data(), light_[1].data(), light_[2].data()};
    planes_.multiply({columns_.data(), n}, factors, out);
  }

  // light_ = G (value + (C_c - C) light_): brings the channels' own albedos in (cpu_multibounce.h).
  template <class Value>
  void reflectColours(Value&& value) {
    light(
        [&](uint32_t j) {
          const Vec4 v = value(j);
          const float mean = planes_.albedo(0, j);
          return Vec4{v.x + (colour_[j].x - mean) * light_[0][j], v.y + (colour_[j].y - mean) * light_[1][j],
                      v.z + (colour_[j].z - mean) * light_[2][j], 0};
        },
        places_.used(), [](uint32_t j) { return j; });
  }

  MultibounceSettings settings_;
  WorkerPool pool_;
  BouncePlanes<Element> planes_;
  Places places_;
  std::vector<Vec4> colour_;  // per place, after clamping; 0 where free
  std::vector<float> row_sum_, row_sum_before_;
  std::vector<uint32_t> columns_, changed_at_;
  std::vector<float> factors_[3], light_[3];
  typename BouncePlanes<Element>::Change change_;
  std::array<uint32_t, kMaxBlock> lowered_places_;
  BounceStats stats_;
  std::string name_;
};

template <class Element>
Result<std::unique_ptr<BounceMatrix>> make(const MultibounceSettings& settings) {
  auto matrix = std::make_unique<CpuMultibounce<Element>>(settings);
  if (!matrix->allocated()) return tooLittleMemory(settings.places, "ask for fewer places, or for fp16 or luminance");
  return std::unique_ptr<BounceMatrix>(std::move(matrix));
}

}  // namespace

Result<std::unique_ptr<BounceMatrix>> makeCpuMultibounce(const MultibounceSettings& settings) {
  if (auto sound = checkPlaces(settings.places); !sound) return sound.error();
  return settings.storage == Storage::kFloat16 ? make<Half>(settings) : make<float>(settings);
}

}  // namespace ff::runtime
