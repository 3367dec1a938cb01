#include "bake/gltf_meshopt.h"

#ifdef FF_HAVE_MESHOPTIMIZER
#include <meshoptimizer.h>
#endif

namespace ff::bake::gltf {
namespace {

#ifdef FF_HAVE_MESHOPTIMIZER
// False where the library says that the data is broken or of a newer version than it knows.
bool decode(const std::string& mode, const std::string& filter, std::vector<uint8_t>& out, uint64_t count, uint64_t stride,
            const uint8_t* data, uint64_t bytes) {
  int rc = -1;
  if (mode == "ATTRIBUTES") rc = meshopt_decodeVertexBuffer(out.data(), count, stride, data, bytes);
  else if (mode == "TRIANGLES") rc = meshopt_decodeIndexBuffer(out.data(), count, stride, data, bytes);
  else rc = meshopt_decodeIndexSequence(out.data(), count, stride, data, bytes);
  if (rc != 0) return false;
  if (filter == "EXPONENTIAL") meshopt_decodeFilterExp(out.data(), count, stride);
  // Octahedral, quaternion and colour filters serve normals, rotations and colours; positions and texture coordinates,
  // which are all that is read here, come without or with the exponential one.
  return filter.empty() || filter == "NONE" || filter == "EXPONENTIAL";
}
#endif

void decodeView(const Item& view, const Item& meshopt, size_t number, Storage& storage, Budget& budget) {
  const auto source = meshopt.reference("buffer", storage.buffers.size(), "buffer");
  if (!source) refuse(meshopt.place(), "buffer is missing");
  const uint64_t offset = meshopt.integer("byteOffset").value_or(0), bytes = meshopt.requiredInteger("byteLength");
  const uint64_t stride = meshopt.requiredInteger("byteStride"), count = meshopt.requiredInteger("count");
  const std::string mode = meshopt.text("mode"), filter = meshopt.text("filter");
  const uint64_t available = storage.present[*source] ? storage.buffers[*source].size() : 0;
  if (offset > available || bytes > available - offset)
    refuse(meshopt.place(), "offset " + std::to_string(offset) + " and length " + std::to_string(bytes) + " end past buffer " +
                                std::to_string(*source));
  const bool attributes = mode == "ATTRIBUTES", triangles = mode == "TRIANGLES";
  if (!attributes && !triangles && mode != "INDICES") refuse(meshopt.place(), "mode \"" + printable(mode) + "\" is unknown");
  if (attributes ? stride < 4 || stride > 256 || stride % 4 : stride != 2 && stride != 4)
    refuse(meshopt.place(), "byteStride " + std::to_string(stride) + " does not fit " + mode);
  if (count < 1 || count > 0xfffffffeu || (triangles && count % 3)) refuse(meshopt.place(), "count " + std::to_string(count));
  if (count * stride != storage.views[number].length)
    refuse(meshopt.place(), std::to_string(count) + " elements of " + std::to_string(stride) + " bytes do not fill the view");
  if (filter == "EXPONENTIAL" && !attributes) refuse(meshopt.place(), "a filter on indices");
#ifdef FF_HAVE_MESHOPTIMIZER
  budget.take(count * stride, view.place());
  std::vector<uint8_t> out(count * stride);
  if (!decode(mode, filter, out, count, stride, storage.buffers[*source].data() + offset, bytes)) {
    budget.give(count * stride);
    return;
  }
  Extents& extents = storage.views[number];
  extents.buffer = static_cast<uint32_t>(storage.buffers.size());
  extents.offset = 0;
  storage.buffers.push_back(std::move(out));
  storage.present.push_back(true);
#else
  (void)view;
  (void)budget;
#endif
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
