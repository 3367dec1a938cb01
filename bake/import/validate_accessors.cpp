#include "bake/import/validate.h"

namespace ff::bake::gltf {
namespace {

uint64_t componentBytes(uint64_t component_type) {
  switch (component_type) {
    case 5120:
    case 5121:
      return 1;
    case 5122:
    case 5123:
      return 2;
    case 5125:
    case 5126:
      return 4;
    default:
      return 0;
  }
}

// Bytes of one element; columns of matrices start at multiples of 4 (glTF 2.0, section 3.6.2.4). 0: unknown type.
uint64_t elementBytes(const std::string& type, uint64_t component) {
  const auto matrix = [&](uint64_t n) { return n * ((n * component + 3) / 4 * 4); };
  if (type == "SCALAR") return component;
  if (type == "VEC2") return 2 * component;
  if (type == "VEC3") return 3 * component;
  if (type == "VEC4") return 4 * component;
  if (type == "MAT2") return matrix(2);
  if (type == "MAT3") return matrix(3);
  if (type == "MAT4") return matrix(4);
  return 0;
}

// The last element may end where its last column does.
uint64_t lastElementBytes(const std::string& type, uint64_t component) {
  const uint64_t element = elementBytes(type, component);
  if (type.compare(0, 3, "MAT") != 0) return element;
  const uint64_t n = static_cast<uint64_t>(type[3] - '0');
  return element - element / n + n * component;
}

// All operands are below 2^63 (Item::integer) and counts below 2^32, strides below 2^8: nothing here can wrap.
void checkExtent(const Item& item, uint64_t count, uint64_t last_element, uint64_t stride, uint64_t offset,
                 uint64_t alignment, uint32_t view, const Extents& extents) {
  if (offset % alignment || (extents.offset + offset) % alignment)
    refuse(item.place(),
           "byteOffset " + std::to_string(offset) + " is not aligned to " + std::to_string(alignment) + " bytes");
  const uint64_t needed = stride * (count - 1) + last_element;
  if (offset > extents.length || needed > extents.length - offset)
    refuse(item.place(), "count " + std::to_string(count) + " needs " + std::to_string(needed) + " bytes from offset " +
                             std::to_string(offset) + " but bufferView " + std::to_string(view) + " has " +
                             std::to_string(extents.length));
}

uint64_t count(const Item& item) {
  const uint64_t n = item.requiredInteger("count");
  if (n < 1 || n > 0xfffffffeu) refuse(item.place(), "count " + std::to_string(n) + " must be 1 to 4294967294");
  return n;
}

void checkSparseOrder(const Item& item, const Storage& storage, uint32_t view, uint64_t offset, uint64_t width,
                      uint64_t sparse_count, uint64_t accessor_count) {
  const Extents& extents = storage.views[view];
  if (!storage.present[extents.buffer]) return;
  const uint8_t* p = storage.buffers[extents.buffer].data() + extents.offset + offset;
  uint64_t least = 0;
  for (uint64_t i = 0; i < sparse_count; ++i) {
    uint64_t index = 0;
    for (uint64_t b = 0; b < width; ++b) index |= uint64_t{p[i * width + b]} << (8 * b);
    if (index >= accessor_count)
      refuse(item.place(),
             "sparse index " + std::to_string(index) + " of " + std::to_string(accessor_count) + " elements");
    if (index < least) refuse(item.place(), "sparse indices must increase");
    least = index + 1;
  }
}

Json validateSparse(const Item& item, const Item& sparse, const Storage& storage, const AccessorFacts& facts,
                    uint64_t element, uint64_t component, bool* present) {
  const uint64_t n = count(sparse);
  if (n > facts.count)
    refuse(sparse.place(),
           "count " + std::to_string(n) + " is larger than the accessor's " + std::to_string(facts.count));
  Json out = {{"count", n}};
  for (const char* part : {"indices", "values"}) {
    const auto side = sparse.object(part);
    if (!side) refuse(sparse.place(), std::string(part) + " is missing");
    const auto view = side->reference("bufferView", storage.views.size(), "bufferView");
    if (!view) refuse(side->place(), "bufferView is missing");
    const uint64_t offset = side->integer("byteOffset").value_or(0);
    uint64_t width = element, alignment = component;
    Json validated = {{"bufferView", *view}, {"byteOffset", offset}};
    if (part[0] == 'i') {
      const uint64_t type = side->requiredInteger("componentType");
      if (type != 5121 && type != 5123 && type != 5125)
        refuse(side->place(), "componentType " + std::to_string(type) + " cannot be an index");
      width = alignment = componentBytes(type);
      validated["componentType"] = type;
    }
    if (storage.views[*view].stride) refuse(side->place(), "bufferView " + std::to_string(*view) + " has a byteStride");
    if (offset > 0x7fffffffu) refuse(side->place(), "byteOffset " + std::to_string(offset) + " is too large");
    checkExtent(*side, n, width, width, offset, alignment, *view, storage.views[*view]);
    if (part[0] == 'i') checkSparseOrder(item, storage, *view, offset, width, n, facts.count);
    *present = *present && storage.present[storage.views[*view].buffer];
    out[part] = std::move(validated);
  }
  return out;
}

}  // namespace

Json validateAccessors(const Item& file, const Storage& storage, std::vector<AccessorFacts>& facts) {
  Json out = Json::array();
  for (const Item& item : file.items("accessors", "accessor")) {
    AccessorFacts f;
    f.count = count(item);
    const uint64_t component_type = item.requiredInteger("componentType");
    const uint64_t component = componentBytes(component_type);
    if (!component) refuse(item.place(), "componentType " + std::to_string(component_type) + " is unknown");
    f.component_type = static_cast<int>(component_type);
    f.type = item.text("type");
    const uint64_t element = elementBytes(f.type, component);
    if (!element) refuse(item.place(), "type \"" + printable(f.type) + "\" is unknown");
    f.normalized = item.flag("normalized");
    if (f.normalized && component == 4) refuse(item.place(), "32-bit components cannot be normalized");
    Json validated = {
        {"count", f.count}, {"componentType", component_type}, {"type", f.type}, {"normalized", f.normalized}};
    bool present = true;
    if (const auto view = item.reference("bufferView", storage.views.size(), "bufferView")) {
      const Extents& extents = storage.views[*view];
      const uint64_t offset = item.integer("byteOffset").value_or(0);
      if (extents.stride && extents.stride < element)
        refuse(item.place(), "an element of " + std::to_string(element) + " bytes does not fit the byteStride " +
                                 std::to_string(extents.stride) + " of bufferView " + std::to_string(*view));
      checkExtent(item, f.count, lastElementBytes(f.type, component), extents.stride ? extents.stride : element, offset,
                  component, *view, extents);
      validated["bufferView"] = *view;
      validated["byteOffset"] = offset;
      f.view = static_cast<int>(*view);
      f.strided = extents.stride != 0;
      f.has_data = true;
      present = storage.present[extents.buffer];
    } else if (item.has("byteOffset")) {
      refuse(item.place(), "byteOffset without a bufferView");
    }
    if (const auto sparse = item.object("sparse")) {
      validated["sparse"] = validateSparse(item, *sparse, storage, f, element, component, &present);
      f.has_data = true;
    }
    f.has_data = f.has_data && present;
    facts.push_back(std::move(f));
    out.push_back(std::move(validated));
  }
  return out;
}

}  // namespace ff::bake::gltf
