// The bake cache: results of units of work as files in a folder, by a key of what they were made of. What a bake has done once it does not do
// again: after a stop, or an edit elsewhere. Nothing in it is needed: a file that is missing, cut short or damaged is work that is done again,
// and a folder that is full or read-only costs a warning.
#pragma once
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "formats/storage/storage.h"

namespace ff::bake {

using Digest = std::array<uint64_t, 2>;  // XXH3-128
Digest digestOf(std::span<const std::byte> bytes);

// Thread-safe.
class BakeCache {
 public:
  // Makes the folder where it is missing, and removes what bakes that were killed left half-written. limit_bytes: of the files together; see trim().
  // Errors: kIo (no such folder can be made).
  static Result<std::unique_ptr<BakeCache>> open(const std::string& folder, uint64_t limit_bytes, formats::StoragePtr storage = formats::posixStorage());

  // The same to look into only: nothing is made, removed or to be stored, and a folder that is missing is an empty one. Errors: kIo.
  static Result<std::unique_ptr<BakeCache>> peek(const std::string& folder, formats::StoragePtr storage = formats::posixStorage());

  // What was stored; nothing where there is none, or it is damaged. kind: of the unit, a word.
  std::optional<std::vector<std::byte>> load(std::string_view kind, const Digest& key);
  // In one step: another bake sees all of it or nothing. Survives a kill; a power cut may lose it. Trims where the limit asks for it; where that is not
  // enough, nothing is stored any more.
  void store(std::string_view kind, const Digest& key, std::span<const std::byte> bytes);
  // Removes files that this bake has neither loaded nor stored so far, until the rest and room_bytes more are within the limit. Counts what others stored.
  void trim(uint64_t room_bytes = 0);
  // Removes all files; returns how many bytes.
  static Result<uint64_t> clean(const std::string& folder, formats::StoragePtr storage = formats::posixStorage());

  const std::string& folder() const { return folder_; }  // ends with '/'
  uint64_t bytes() const { return bytes_; }        // of the files that are there
  std::vector<std::string> warnings() const;       // a line each

 private:
  BakeCache(std::string folder, uint64_t limit_bytes, formats::StoragePtr storage);
  // Counts what is there; tidy: removes what is half written and abandoned.
  Result<void> look(const std::string& folder, bool tidy);
  void warn(const Error& error);

  const std::string folder_;  // ends with '/'
  const uint64_t limit_bytes_;
  const formats::StoragePtr storage_;
  std::atomic<uint64_t> bytes_{0}, temporaries_{0};
  std::atomic<bool> broken_{false};  // nothing is stored any more
  mutable std::mutex mutex_;
  std::set<std::string> used_;       // names of files
  std::vector<std::string> warnings_;
};

}  // namespace ff::bake
