#include "tools/chart/page/front.h"

#include <algorithm>
#include <cmath>

namespace ff::chart {

Figure costOf(const Setting& s, Cost cost) {
  switch (cost) {
    case Cost::kRelightMs: return s.relight_ms;
    case Cost::kMemoryMiB: return {s.memory_bytes / 1048576};
    case Cost::kDiskMiB: return {s.disk_bytes / 1048576};
    case Cost::kBakeSeconds: return {s.bake_seconds};
  }
  return {};
}

std::vector<std::string> lightsOf(const Report& report) {
  std::vector<std::string> lights;
  for (const Setting& s : report.settings)
    for (const Accuracy& a : s.accuracy)
      if (std::find(lights.begin(), lights.end(), a.light) == lights.end()) lights.push_back(a.light);
  return lights;
}

const Accuracy* accuracyIn(const Setting& s, const std::string& light) {
  for (const Accuracy& a : s.accuracy)
    if (a.light == light) return &a;
  return nullptr;
}

namespace {

// Null unless every light has its figure.
const Accuracy* worst(const Report& report, const Setting& s) {
  const Accuracy* most = nullptr;
  for (const std::string& light : lightsOf(report)) {
    const Accuracy* a = accuracyIn(s, light);
    if (!a || !std::isfinite(a->rel_l2.value)) return nullptr;
    if (!most || a->rel_l2.value > most->rel_l2.value) most = a;
  }
  return most;
}

}  // namespace

Figure errorOf(const Report& report, const Setting& s, const std::string& light) {
  const Accuracy* a = light.empty() ? worst(report, s) : accuracyIn(s, light);
  return a && std::isfinite(a->rel_l2.value) ? a->rel_l2 : Figure{};
}

std::string worstLight(const Report& report, const Setting& s) {
  const Accuracy* a = worst(report, s);
  return a ? a->light : "";
}

std::vector<size_t> front(const Report& report, const std::string& light, Cost cost) {
  struct Entry {
    double cost, error;
    size_t setting;
  };
  std::vector<Entry> entries;
  for (size_t i = 0; i < report.settings.size(); ++i) {
    const Entry e{costOf(report.settings[i], cost).value, errorOf(report, report.settings[i], light).value, i};
    if (std::isfinite(e.cost) && std::isfinite(e.error)) entries.push_back(e);
  }
  std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return a.cost != b.cost ? a.cost < b.cost : a.error < b.error;
  });
  std::vector<size_t> on_front;
  const Entry* last = nullptr;
  for (const Entry& e : entries) {
    // Of the same figures, all.
    if (last && e.error >= last->error && !(e.error == last->error && e.cost == last->cost)) continue;
    on_front.push_back(e.setting);
    last = &e;
  }
  return on_front;
}

void markFront(Report& report, const std::string& light) {
  for (Setting& s : report.settings) s.on_front = false;
  for (const size_t i : front(report, light, Cost::kRelightMs)) report.settings[i].on_front = true;
}

}  // namespace ff::chart
