#include "bake/import/json.h"

#include <cmath>

namespace ff::bake::gltf {
namespace {

// Doubles hold every integer up to 2^53 exactly; larger ones written as floats are not integers of any use.
constexpr double kLargestExact = 9007199254740992.0;

uint64_t toInteger(const Json& value, const std::string& place, const char* key) {
  if (value.is_number_unsigned()) {
    const auto n = value.get<uint64_t>();
    if (n >> 63) refuse(place, std::string(key) + " " + std::to_string(n) + " is too large");
    return n;
  }
  if (value.is_number_float()) {
    const auto n = value.get<double>();
    if (n >= 0 && n <= kLargestExact && n == std::floor(n)) return static_cast<uint64_t>(n);
  }
  refuse(place, std::string(key) + " must be a non-negative integer, it is " +
                    printable(value.dump(-1, ' ', true, Json::error_handler_t::replace)));
}

double toNumber(const Json& value, const std::string& place, const char* key) {
  if (!value.is_number()) refuse(place, std::string(key) + " must hold numbers");
  const auto n = value.get<double>();
  if (!std::isfinite(n)) refuse(place, std::string(key) + " must be finite");
  return n;
}

}  // namespace

void refuse(const std::string& place, const std::string& message, const std::string& remedy) {
  throw ImportError{{ErrorCode::kInvalidFile, "", place, message, remedy.empty() ? "re-export the file" : remedy}};
}

void refuseIo(const std::string& place, const std::string& message, const std::string& remedy) {
  throw ImportError{{ErrorCode::kIo, "", place, message, remedy}};
}

std::string printable(const std::string& text) {
  constexpr size_t kLongest = 120;
  std::string out = text.substr(0, kLongest);
  for (char& c : out)
    if (c < 0x20 || c > 0x7e) c = '?';
  if (text.size() > kLongest) out += "...";
  return out;
}

void Budget::take(uint64_t bytes, const std::string& place) {
  if (bytes > left())
    refuse(place,
           "needs " + std::to_string(bytes >> 20) + " MiB beside the " + std::to_string(used_ >> 20) +
               " MiB in use, the limit is " + std::to_string(limit_ >> 20) + " MiB",
           "split the scene or raise the memory limit");
  used_ += bytes;
}

Item::Item(const Json& json, std::string place) : json_(&json), place_(std::move(place)) {
  if (!json.is_object()) refuse(place_, "must be a JSON object");
}

const Json* Item::find(const char* key) const {
  const auto it = json_->find(key);
  return it == json_->end() ? nullptr : &*it;
}

std::optional<uint64_t> Item::integer(const char* key) const {
  const Json* value = find(key);
  if (!value) return {};
  return toInteger(*value, place_, key);
}

uint64_t Item::requiredInteger(const char* key) const {
  const auto n = integer(key);
  if (!n) refuse(place_, std::string(key) + " is missing");
  return *n;
}

std::optional<uint32_t> Item::reference(const char* key, size_t count, const char* kind) const {
  const auto n = integer(key);
  if (!n) return {};
  if (*n >= count)
    refuse(place_,
           std::string(key) + " refers to " + kind + " " + std::to_string(*n) + ", there are " + std::to_string(count));
  return static_cast<uint32_t>(*n);
}

std::vector<uint32_t> Item::references(const char* key, size_t count, const char* kind) const {
  const Json* value = find(key);
  if (!value) return {};
  if (!value->is_array()) refuse(place_, std::string(key) + " must be an array");
  std::vector<uint32_t> out;
  out.reserve(value->size());
  for (const Json& element : *value) {
    const uint64_t n = toInteger(element, place_, key);
    if (n >= count)
      refuse(place_, std::string(key) + " refers to " + kind + " " + std::to_string(n) + ", there are " +
                         std::to_string(count));
    out.push_back(static_cast<uint32_t>(n));
  }
  return out;
}

std::optional<double> Item::number(const char* key) const {
  const Json* value = find(key);
  if (!value) return {};
  return toNumber(*value, place_, key);
}

std::vector<double> Item::numbers(const char* key, size_t count) const {
  const Json* value = find(key);
  if (!value) return {};
  if (!value->is_array() || value->size() != count)
    refuse(place_, std::string(key) + " must be an array of " + std::to_string(count) + " numbers");
  std::vector<double> out;
  for (const Json& element : *value) out.push_back(toNumber(element, place_, key));
  return out;
}

bool Item::flag(const char* key) const {
  const Json* value = find(key);
  if (!value) return false;
  if (!value->is_boolean()) refuse(place_, std::string(key) + " must be true or false");
  return value->get<bool>();
}

std::string Item::text(const char* key) const {
  const Json* value = find(key);
  if (!value) return {};
  if (!value->is_string()) refuse(place_, std::string(key) + " must be a string");
  return value->get<std::string>();
}

std::optional<Item> Item::object(const char* key) const {
  const Json* value = find(key);
  if (!value) return {};
  if (!value->is_object()) refuse(place_, std::string(key) + " must be a JSON object");
  return Item(*value, place_ + " " + key);
}

std::optional<Item> Item::extension(const char* name) const {
  const auto all = object("extensions");
  if (!all || !all->has(name)) return {};
  const Json& value = all->json()[name];
  if (!value.is_object()) refuse(place_, std::string(name) + " must be a JSON object");
  return Item(value, place_ + " " + name);
}

std::vector<Item> Item::items(const char* key, const char* kind) const {
  const Json* value = find(key);
  if (!value) return {};
  const std::string where = place_ == "file" ? "" : place_ + " ";
  if (!value->is_array()) refuse(place_ == "file" ? key : place_, std::string(key) + " must be an array");
  std::vector<Item> out;
  out.reserve(value->size());
  for (size_t i = 0; i < value->size(); ++i) out.emplace_back((*value)[i], where + kind + " " + std::to_string(i));
  return out;
}

}  // namespace ff::bake::gltf
