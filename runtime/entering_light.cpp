#include "runtime/entering_light.h"

#include "runtime/solver/sound_light.h"

namespace ff::runtime {

EnteringLight::EnteringLight() {
  for (Nodes* nodes : {&made_, &taken_}) {
    nodes->lamps.reserve(kMaxSlots);
    nodes->emission.reserve(kMaxSlots);
    nodes->source.reserve(kMaxSlots);
    nodes->emits.reserve(kMaxSlots / 16);
  }
}

void EnteringLight::set(const Sky& sky, const Lamps& lamps) {
  const std::lock_guard lock(mutex_);
  sky_ = sky;
  lamps_ = lamps;
  ++number_;
}

void EnteringLight::build(const MatrixAssembler& cut) {
  {
    const std::lock_guard lock(mutex_);
    sky_then_ = sky_;
    lamps_then_ = lamps_;
    made_.number = number_;
  }
  made_.is_light = true;
  for (auto* of : {&made_.emission, &made_.source}) of->clear();
  made_.lamps.clear();
  made_.emits.clear();
  for (const uint32_t tile : cut.change().entered) {
    const stream::ResidentStrip& strip = cut.strip(tile);
    const size_t first = made_.lamps.size(), nodes = cut.matrix().tiles[tile].nodes;
    made_.lamps.resize(first + nodes);
    const std::span<Vec3> lamps = std::span(made_.lamps).subspan(first);
    lamps_then_.irradiance(strip.lamps, lamps);
    bool emits = false;
    for (size_t i = 0; i < nodes; ++i) {
      const Vec3 e = lamps_then_.emission(strip.nodes[i]), m = reflectedSource(strip.nodes[i], sky_then_, {}, lamps[i]);
      made_.emission.push_back({e.x, e.y, e.z, 0});
      emits |= e != Vec3{};
      made_.source.push_back({m.x, m.y, m.z, 0});
      made_.is_light &= whyNoLight(m) == nullptr;
    }
    made_.emits.push_back(emits);
  }
}

}  // namespace ff::runtime
