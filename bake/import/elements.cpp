#include "bake/import/elements.h"

#include <cmath>
#include <cstring>

namespace ff::bake::gltf {
namespace {

uint64_t littleEndian(const uint8_t* p, uint64_t bytes) {
  uint64_t n = 0;
  for (uint64_t b = 0; b < bytes; ++b) n |= uint64_t{p[b]} << (8 * b);
  return n;
}

// glTF 2.0, section 3.6.2.2: signed values divide by the largest positive one and are clamped at -1.
float fromInteger(int64_t n, double largest, bool normalized) {
  return static_cast<float>(normalized ? std::max(static_cast<double>(n) / largest, -1.0) : static_cast<double>(n));
}

}  // namespace

Bytes viewBytes(const Document& document, int view, const std::string& place) {
  const tinygltf::BufferView& v = document.model.bufferViews[static_cast<size_t>(view)];
  const auto buffer = static_cast<size_t>(v.buffer);
  if (!document.buffer_present[buffer])
    refuse(place, "bufferView " + std::to_string(view) + ": buffer " + std::to_string(buffer) + " has no data");
  return {document.model.buffers[buffer].data.data() + v.byteOffset, v.byteLength};
}

Elements::Elements(const Document& document, int accessor) : place_("accessor " + std::to_string(accessor)) {
  const tinygltf::Accessor& a = document.model.accessors[static_cast<size_t>(accessor)];
  count_ = a.count;
  type_ = a.componentType;
  normalized_ = a.normalized;
  components_ = static_cast<uint32_t>(tinygltf::GetNumComponentsInType(static_cast<uint32_t>(a.type)));
  component_bytes_ = static_cast<uint64_t>(tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(type_)));
  element_bytes_ = components_ * component_bytes_;
  stride_ = element_bytes_;
  if (a.bufferView >= 0) {
    base_ = viewBytes(document, a.bufferView, place_).data + a.byteOffset;
    if (const size_t stride = document.model.bufferViews[static_cast<size_t>(a.bufferView)].byteStride)
      stride_ = stride;
  }
  if (a.sparse.isSparse) {
    sparse_count_ = static_cast<uint64_t>(a.sparse.count);
    sparse_width_ =
        static_cast<uint64_t>(tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(a.sparse.indices.componentType)));
    sparse_indices_ = viewBytes(document, a.sparse.indices.bufferView, place_).data + a.sparse.indices.byteOffset;
    sparse_values_ = viewBytes(document, a.sparse.values.bufferView, place_).data + a.sparse.values.byteOffset;
  }
  if (!base_ && !sparse_count_) refuse(place_, "has no data", "re-export the file");
}

Elements::Elements(std::vector<float> values, uint32_t components, std::string place)
    : place_(std::move(place)),
      count_(values.size() / components),
      components_(components),
      decoded_(std::move(values)) {}

const uint8_t* Elements::find(uint64_t element) const {
  uint64_t lo = 0, hi = sparse_count_;  // first sparse index >= element
  while (lo < hi) {
    const uint64_t mid = (lo + hi) / 2;
    if (littleEndian(sparse_indices_ + mid * sparse_width_, sparse_width_) < element)
      lo = mid + 1;
    else
      hi = mid;
  }
  if (lo < sparse_count_ && littleEndian(sparse_indices_ + lo * sparse_width_, sparse_width_) == element)
    return sparse_values_ + lo * element_bytes_;
  return base_ ? base_ + element * stride_ : nullptr;
}

float Elements::value(uint64_t element, uint32_t component) const {
  float v = 0;
  if (!decoded_.empty()) {
    v = decoded_[element * components_ + component];
  } else if (const uint8_t* p = find(element)) {
    p += component * component_bytes_;
    const uint64_t raw = littleEndian(p, component_bytes_);
    switch (type_) {
      case TINYGLTF_COMPONENT_TYPE_BYTE:
        v = fromInteger(static_cast<int8_t>(raw), 127, normalized_);
        break;
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        v = fromInteger(static_cast<uint8_t>(raw), 255, normalized_);
        break;
      case TINYGLTF_COMPONENT_TYPE_SHORT:
        v = fromInteger(static_cast<int16_t>(raw), 32767, normalized_);
        break;
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        v = fromInteger(static_cast<uint16_t>(raw), 65535, normalized_);
        break;
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
        v = static_cast<float>(raw);
        break;
      default: {
        const auto bits = static_cast<uint32_t>(raw);
        std::memcpy(&v, &bits, sizeof v);
      }
    }
  }
  if (!std::isfinite(v))
    refuse(place_, "element " + std::to_string(element) + " holds " + (std::isnan(v) ? "NaN" : "an infinity"));
  return v;
}

uint32_t Elements::index(uint64_t element) const {
  const uint8_t* p = find(element);
  return p ? static_cast<uint32_t>(littleEndian(p, component_bytes_)) : 0;
}

}  // namespace ff::bake::gltf
