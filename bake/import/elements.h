// Values of an accessor by element and component, wherever they lie: packed, strided, normalised, sparse or decoded
// from Draco. Private to this folder.
#pragma once
#include <string>
#include <vector>

#include "bake/import/document.h"

namespace ff::bake::gltf {

class Elements {
 public:
  // Refuses an accessor without data. The document must outlive this.
  Elements(const Document& document, int accessor);
  // Decoded values, `components` for each element.
  Elements(std::vector<float> values, uint32_t components, std::string place);

  uint64_t count() const { return count_; }
  uint32_t components() const { return components_; }
  float value(uint64_t element, uint32_t component) const;  // element < count(); refuses NaN and infinities
  uint32_t index(uint64_t element) const;                   // of an unsigned SCALAR accessor

 private:
  const uint8_t* find(uint64_t element) const;  // nullptr: zero

  std::string place_;
  uint64_t count_ = 0, stride_ = 0, element_bytes_ = 0, component_bytes_ = 0;
  uint32_t components_ = 0;
  int type_ = 0;
  bool normalized_ = false;
  const uint8_t* base_ = nullptr;
  const uint8_t* sparse_values_ = nullptr;
  const uint8_t* sparse_indices_ = nullptr;
  uint64_t sparse_count_ = 0, sparse_width_ = 0;
  std::vector<float> decoded_;
};

// The bytes of a bufferView; refuses one whose buffer has no data.
struct Bytes {
  const uint8_t* data = nullptr;
  uint64_t size = 0;
};
Bytes viewBytes(const Document& document, int view, const std::string& place);

}  // namespace ff::bake::gltf
