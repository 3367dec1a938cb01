// What there is to say of a setting, each under the name that the CSV and the JSON give it: one spelling for both.
#pragma once
#include "tools/chart/report.h"

namespace ff::chart {

// put(name, value) for words, flags, numbers and figures, in the order of the CSV's columns.
template <class Put>
void eachFigure(const Setting& s, Put&& put) {
  put("setting", s.name);
  put("varies", s.varies);
  put("is_default", s.is_default);
  put("bakes_anew", s.bakes_anew);
  put("on_front", s.on_front);
  put("relight_ms", s.relight_ms);
  put("update_ms_per_tile", s.update_ms_per_tile);
  put("disk_bytes", s.disk_bytes);
  put("memory_bytes", s.memory_bytes);
  put("bake_seconds", s.bake_seconds);
  put("patches", s.patches);
  put("active_nodes", s.active_nodes);
}

template <class Put>
void eachFigure(const Accuracy& a, Put&& put) {
  put("light", a.light);
  put("rel_l2", a.rel_l2);
  put("median", a.median);
  put("p95", a.p95);
  put("p99", a.p99);
  put("energy", a.energy);
  put("full_solve_rel_l2", a.full_solve_rel_l2);
}

}  // namespace ff::chart
