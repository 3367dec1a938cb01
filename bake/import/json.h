// Typed, checked access to parsed JSON, and the way faults travel inside the importer: they are thrown as ImportError and
// become ff::Error in importGltf(), which alone knows the file's name. Private to this folder.
#pragma once
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "formats/result.h"

namespace ff::bake::gltf {

using Json = nlohmann::json;

struct ImportError {
  Error error;
};

[[noreturn]] void refuse(const std::string& place, const std::string& message, const std::string& remedy = "");
[[noreturn]] void refuseIo(const std::string& place, const std::string& message, const std::string& remedy = "");

// Text from a file made fit for one line of a message: control and non-ASCII bytes become '?', long text is cut.
std::string printable(const std::string& text);

// Memory that file contents make the importer take. take() refuses once the limit would be passed.
class Budget {
 public:
  explicit Budget(uint64_t limit) : limit_(limit) {}
  void take(uint64_t bytes, const std::string& place);
  void give(uint64_t bytes) { used_ -= bytes; }
  uint64_t left() const { return limit_ - used_; }

 private:
  uint64_t limit_, used_ = 0;
};

// A JSON object and its name in messages ("accessor 3"). Members of the wrong type or out of range are refused.
class Item {
 public:
  Item(const Json& json, std::string place);  // refuses what is not an object

  const std::string& place() const { return place_; }
  bool has(const char* key) const { return json_->contains(key); }
  std::optional<uint64_t> integer(const char* key) const;  // 0..2^63; 3.0 counts as 3
  uint64_t requiredInteger(const char* key) const;
  std::optional<uint32_t> reference(const char* key, size_t count, const char* kind) const;  // < count
  std::vector<uint32_t> references(const char* key, size_t count, const char* kind) const;
  std::optional<double> number(const char* key) const;               // finite
  std::vector<double> numbers(const char* key, size_t count) const;  // empty if absent, else `count` finite numbers
  bool flag(const char* key) const;                                  // absent: false
  std::string text(const char* key) const;                           // absent: ""
  std::optional<Item> object(const char* key) const;
  std::optional<Item> extension(const char* name) const;
  std::vector<Item> items(const char* key, const char* kind) const;  // "kind 0", "kind 1", ...
  const Json& json() const { return *json_; }

 private:
  const Json* find(const char* key) const;
  const Json* json_;
  std::string place_;
};

}  // namespace ff::bake::gltf
