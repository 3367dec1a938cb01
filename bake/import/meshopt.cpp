#include "bake/import/meshopt.h"

#include <cmath>
#include <cstring>
#include <span>

#include "bake/import/meshopt_vertices.h"

#ifdef FF_HAVE_MESHOPTIMIZER
#include <meshoptimizer.h>
#endif

namespace ff::bake::gltf {
namespace {

bool decode(const std::string& mode, std::vector<uint8_t>& out, uint64_t count, uint64_t stride,
            std::span<const uint8_t> stream, const std::string& place) {
  if (mode == "ATTRIBUTES") return decodeMeshoptVertices(stream, stride, out);
#ifdef FF_HAVE_MESHOPTIMIZER
  (void)place;
  if (mode == "TRIANGLES")
    return meshopt_decodeIndexBuffer(out.data(), count, stride, stream.data(), stream.size()) == 0;
  return meshopt_decodeIndexSequence(out.data(), count, stride, stream.data(), stream.size()) == 0;
#else
  (void)count;
  refuse(place, "meshopt-compressed indices cannot be read by this build", "export without meshopt compression");
#endif
}

// Each 32-bit word: a signed 24-bit mantissa below a signed 8-bit exponent.
void undoExponential(std::vector<uint8_t>& bytes) {
  for (size_t i = 0; i + 4 <= bytes.size(); i += 4) {
    uint32_t word;
    std::memcpy(&word, &bytes[i], 4);
    const auto mantissa = static_cast<float>(static_cast<int32_t>(word << 8) >> 8);
    const float value = std::ldexp(mantissa, static_cast<int8_t>(word >> 24));
    std::memcpy(&bytes[i], &value, 4);
  }
}

void decodeView(const Item& view, const Item& meshopt, size_t number, Storage& storage, Budget& budget) {
  const auto source = meshopt.reference("buffer", storage.buffers.size(), "buffer");
  if (!source) refuse(meshopt.place(), "buffer is missing");
  const uint64_t offset = meshopt.integer("byteOffset").value_or(0), bytes = meshopt.requiredInteger("byteLength");
  const uint64_t stride = meshopt.requiredInteger("byteStride"), count = meshopt.requiredInteger("count");
  const std::string mode = meshopt.text("mode"), filter = meshopt.text("filter");
  const uint64_t available = storage.present[*source] ? storage.buffers[*source].size() : 0;
  if (offset > available || bytes > available - offset)
    refuse(meshopt.place(), "offset " + std::to_string(offset) + " and length " + std::to_string(bytes) +
                                " end past buffer " + std::to_string(*source));
  const bool attributes = mode == "ATTRIBUTES", triangles = mode == "TRIANGLES";
  if (!attributes && !triangles && mode != "INDICES")
    refuse(meshopt.place(), "mode \"" + printable(mode) + "\" is unknown");
  if (attributes ? stride < 4 || stride > 256 || stride % 4 : stride != 2 && stride != 4)
    refuse(meshopt.place(), "byteStride " + std::to_string(stride) + " does not fit " + mode);
  if (count < 1 || count > 0xfffffffeu || (triangles && count % 3))
    refuse(meshopt.place(), "count " + std::to_string(count));
  if (count * stride != storage.views[number].length)
    refuse(meshopt.place(),
           std::to_string(count) + " elements of " + std::to_string(stride) + " bytes do not fill the view");
  if (filter == "EXPONENTIAL" && !attributes) refuse(meshopt.place(), "a filter on indices");
  // The other filters serve normals, rotations and colours, which may be left alone; positions and texture coordinates
  // come without or with the exponential one.
  if (!filter.empty() && filter != "NONE" && filter != "EXPONENTIAL") return;
  budget.take(count * stride, view.place());
  std::vector<uint8_t> out(count * stride);
  if (!decode(mode, out, count, stride, {storage.buffers[*source].data() + offset, bytes}, meshopt.place()))
    refuse(meshopt.place(), "the compressed data is broken", "fetch or compress the file again");
  if (filter == "EXPONENTIAL") undoExponential(out);
  Extents& extents = storage.views[number];
  extents.buffer = static_cast<uint32_t>(storage.buffers.size());
  extents.offset = 0;
  storage.buffers.push_back(std::move(out));
  storage.present.push_back(true);
}

}  // namespace

void decodeMeshoptViews(const Item& file, Storage& storage, Budget& budget) {
  const auto views = file.items("bufferViews", "bufferView");
  for (size_t i = 0; i < views.size(); ++i)
    for (const char* name : {"EXT_meshopt_compression", "KHR_meshopt_compression"})
      if (const auto meshopt = views[i].extension(name)) {
        decodeView(views[i], *meshopt, i, storage, budget);
        break;
      }
}

}  // namespace ff::bake::gltf
