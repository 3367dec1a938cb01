#include "tools/inspect/recorded_path.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "formats/storage/storage.h"

namespace ff::tools {
namespace {

using nlohmann::json;

double numberOf(const json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : std::nan("");
}

// [x, y, z] or [x, y, z, vx, vy, vz].
bool readObserver(const json& from, FormfieldObserver& to) {
  if (!from.is_array() || (from.size() != 3 && from.size() != 6)) return false;
  to = {};
  for (size_t k = 0; k < from.size(); ++k) {
    if (!from[k].is_number() || !std::isfinite(from[k].get<float>())) return false;
    if (k < 3) to.position[k] = from[k].get<double>();
    else to.velocity[k - 3] = from[k].get<float>();
  }
  return true;
}

}  // namespace

Result<std::vector<RecordedFrame>> readRecordedPath(const std::string& path) {
  const auto bytes = formats::readWholeFile(*formats::posixStorage(), path);
  if (!bytes) return bytes.error();
  const auto invalid = [&](const std::string& where, std::string message) {
    return Error{ErrorCode::kInvalidFile, path, where, std::move(message), "record it with formfieldWriteTrace of this version, or see tools/README.md"};
  };
  const char* text = reinterpret_cast<const char*>(bytes->data());
  const json file = json::parse(text, text + bytes->size(), nullptr, false);
  if (!file.is_object() || !file.contains("traceEvents") || !file["traceEvents"].is_array()) return invalid("", "is no trace: there is no list of traceEvents");
  std::map<double, RecordedFrame> frames;  // by time, us
  size_t number = 0;
  for (const json& event : file["traceEvents"]) {
    const std::string where = "traceEvents[" + std::to_string(number++) + "]";
    if (!event.is_object() || event.value("name", json()) != "stream" || !event.contains("args") || !event["args"].is_object() || !event["args"].contains("observers")) continue;
    const double at = numberOf(event, "ts");
    if (!std::isfinite(at)) return invalid(where, "ts is not a time");
    const json& observers = event["args"]["observers"];
    RecordedFrame frame;
    if (!observers.is_array() || observers.empty() || observers.size() > FORMFIELD_MAX_OBSERVERS) return invalid(where, "observers are none, or more than 16");
    for (const json& observer : observers)
      if (!readObserver(observer, frame.observers.emplace_back())) return invalid(where, "an observer is not [x, y, z] or [x, y, z, vx, vy, vz]");
    if (!frames.emplace(at, std::move(frame)).second) return invalid(where, "two frames begin at once");
  }
  if (frames.empty()) return invalid("", "there is no \"stream\" event that has args.observers");
  for (const json& event : file["traceEvents"]) {  // what the frames took
    const double at = event.is_object() ? numberOf(event, "ts") : std::nan("");
    const auto next = std::isfinite(at) ? frames.upper_bound(at) : frames.begin();
    if (next == frames.begin()) continue;
    RecordedFrame& frame = std::prev(next)->second;
    const json name = event.value("name", json());
    if (name == "stream" || name == "matrix and light" || name == "new cut, matrix and light" || name == "rest") {
      if (const double us = numberOf(event, "dur"); us >= 0) frame.ms += us / 1000;
    } else if (name == "tiles" && event.contains("args") && event["args"].is_object()) {
      if (const double late = numberOf(event["args"], "late"); late >= 0) frame.late_tiles = static_cast<uint32_t>(std::min(late, 4e9));
    }
  }
  std::vector<RecordedFrame> ordered;
  for (auto& [at, frame] : frames) {
    frame.seconds = (at - frames.begin()->first) * 1e-6;
    ordered.push_back(std::move(frame));
  }
  return ordered;
}

}  // namespace ff::tools
