#include <fmt/core.h>
#include <nlohmann/json.hpp>

#include <bit>
#include <cerrno>
#include <cstring>
#include <functional>
#include <memory>

#include "formats/codec/bytes.h"
#include "formats/read/whole_world.h"
#include "tools/inspect/inspect.h"

namespace ff::tools {

using namespace ff::formats;

namespace {

// A file written piece by piece; the first failure is kept and reported by close().
class OutputFile {
 public:
  explicit OutputFile(const std::string& path) : path_(path), file_(std::fopen(path.c_str(), "wb")) {}
  ~OutputFile() {
    if (file_ != nullptr) std::fclose(file_);
  }
  OutputFile(const OutputFile&) = delete;
  void write(std::span<const std::byte> bytes) {
    if (file_ != nullptr) failed_ |= std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size();
  }
  void write(const std::string& text) { write(std::as_bytes(std::span(text.data(), text.size()))); }
  Result<void> close() {
    if (file_ != nullptr && std::fclose(std::exchange(file_, nullptr)) == 0 && !failed_) return {};
    return Error{ErrorCode::kIo, path_, "", std::string("cannot write: ") + std::strerror(errno), ""};
  }

 private:
  std::string path_;
  std::FILE* file_ = nullptr;
  bool failed_ = false;
};

// Calls visit for every strip of a level.
Result<void> eachStrip(const WholeWorld& world, uint32_t level, const std::function<void(const Strip&)>& visit) {
  for (const TileInfo& tile : world.tiles(level)) {
    auto strip = world.strip(tile.id);
    if (!strip) return strip.error();
    visit(*strip);
  }
  return {};
}

// visit(row, column, count, quanta), node numbers, by (tile, partner tile, row, column).
Result<void> eachEntry(const WholeWorld& world, uint32_t level,
                       const std::function<void(uint32_t, uint32_t, uint16_t, uint32_t)>& visit) {
  return eachStrip(world, level, [&](const Strip& s) {
    size_t e = 0;
    for (const Block& block : s.blocks)
      for (const size_t end = e + block.entries; e < end; ++e)
        visit(wholeNumber(s.first_node + s.rows[e]), wholeNumber(world.tiles(level)[block.partner_tile].first_node + s.columns[e]), s.counts[e],
              s.nodes[s.rows[e]].quanta);
  });
}

// NumPy's .npy, version 1.0: a one-dimensional array of records.
std::string npyHeader(const std::string& descr, uint64_t length) {
  std::string dict = "{'descr': [" + descr + "], 'fortran_order': False, 'shape': (" + std::to_string(length) + ",), }";
  const size_t unpadded = 10 + dict.size() + 1;
  dict.append((64 - unpadded % 64) % 64, ' ');
  dict += '\n';
  std::string head = "\x93NUMPY";
  head += '\x01';
  head += '\0';
  head += static_cast<char>(dict.size() & 0xff);
  head += static_cast<char>(dict.size() >> 8);
  return head + dict;
}

Result<void> rowsMtx(const WholeWorld& world, uint32_t level, OutputFile& file) {
  const LevelInfo& info = world.levels()[level];
  file.write(fmt::format("%%MatrixMarket matrix coordinate real general\n% form factors, level {} of {}\n{} {} {}\n", level,
                         world.info().scene, info.nodes, info.nodes, info.entries));
  return eachEntry(world, level, [&](uint32_t row, uint32_t column, uint16_t count, uint32_t quanta) {
    file.write(fmt::format("{} {} {:.9g}\n", row + 1, column + 1, static_cast<double>(count) / quanta));
  });
}

Result<void> rowsNpy(const WholeWorld& world, uint32_t level, OutputFile& file) {
  file.write(npyHeader("('row', '<u4'), ('column', '<u4'), ('count', '<u2'), ('samples', '<u2')", world.levels()[level].entries));
  return eachEntry(world, level, [&](uint32_t row, uint32_t column, uint16_t count, uint32_t quanta) {
    ByteWriter w;
    w.u32(row), w.u32(column), w.u16(count), w.u16(static_cast<uint16_t>(quanta));
    file.write(w.data());
  });
}

Result<void> patchesNpy(const WholeWorld& world, uint32_t level, OutputFile& file) {
  file.write(npyHeader("('area_m2', '<f4'), ('centroid', '<f4', (3,)), ('normal', '<f4', (3,)), ('albedo', '<f4', (3,)), "
                       "('emission', '<f4', (3,)), ('sky_direction', '<f4', (3,)), ('parent', '<u4'), ('samples', '<u4'), "
                       "('sky', '<u4'), ('absorbed', '<u4'), ('row_total', '<f4'), ('sky_fraction', '<f4'), "
                       "('sky_quadratic', '<f4', (5,)), ('lamp_group', '<u4')",
                       world.levels()[level].nodes));
  return eachStrip(world, level, [&](const Strip& s) {
    ByteWriter w;
    uint32_t i = 0;
    for (const Node& n : s.nodes) {
      w.f32(n.area_m2), w.vec3(n.centroid), w.vec3(n.normal), w.vec3(n.albedo), w.vec3(n.emission), w.vec3(n.sky_direction);
      w.u32(world.parent(level, s.first_node + i++)), w.u32(n.quanta), w.u32(n.sky), w.u32(n.absorbed), w.f32(n.row_total), w.f32(n.sky_fraction);
      for (const float mean : n.sky_quadratic) w.f32(mean);
      w.u32(n.lamp_group);
    }
    file.write(w.data());
  });
}

Result<void> lampsNpy(const WholeWorld& world, uint32_t level, OutputFile& file) {
  uint64_t lamps = 0;  // a first pass, because the header wants their number
  if (auto ok = eachStrip(world, level, [&](const Strip& s) { lamps += s.lamps.size(); }); !ok) return ok;
  file.write(npyHeader("('node', '<u4'), ('group', '<u4'), ('weight', '<f4', (3,))", lamps));
  return eachStrip(world, level, [&](const Strip& s) {
    ByteWriter w;
    for (const LampLight& lamp : s.lamps) w.u32(wholeNumber(s.first_node + lamp.row)), w.u32(lamp.group), w.vec3(lamp.weight);
    file.write(w.data());
  });
}

// Viewers expect sRGB.
uint8_t displayByte(float linear) {
  const float v = linear <= 0.0031308f ? 12.92f * linear : 1.055f * std::pow(linear, 1 / 2.4f) - 0.055f;
  return static_cast<uint8_t>(std::lround(std::clamp(v, 0.0f, 1.0f) * 255));
}

void plyVertex(ByteWriter& w, Vec3 p, Vec3 albedo) {
  w.vec3(p);
  for (int c = 0; c < 3; ++c) w.u8(displayByte(albedo[c]));
}

std::string plyHeader(uint64_t vertices, const std::string& more) {
  return fmt::format("ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
                     "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n{}end_header\n",
                     vertices, more);
}

Result<void> patchesPly(const WholeWorld& world, uint32_t level, OutputFile& file) {
  file.write(plyHeader(world.levels()[level].nodes, ""));
  return eachStrip(world, level, [&](const Strip& s) {
    ByteWriter w;
    for (const Node& n : s.nodes) plyVertex(w, n.centroid, n.albedo);
    file.write(w.data());
  });
}

Result<void> geometryPly(const WholeWorld& world, OutputFile& file) {
  // A header first: two passes, because PLY wants the number of triangles before the triangles.
  uint64_t triangles = 0;
  for (uint32_t t = 0; t < world.tiles(0).size(); ++t) {
    auto geometry = world.geometry(t);
    if (!geometry) return geometry.error();
    triangles += geometry->patch.size();
  }
  if (3 * triangles > 0xffffffffu)
    return Error{ErrorCode::kUsage, world.path(), "", "has too many triangles for one PLY file", ""};
  file.write(plyHeader(3 * triangles, fmt::format("element face {}\nproperty list uchar uint vertex_indices\n", triangles)));
  for (uint32_t t = 0; t < world.tiles(0).size(); ++t) {
    auto geometry = world.geometry(t);
    auto strip = world.strip(TileId{0, t});
    if (!geometry) return geometry.error();
    if (!strip) return strip.error();
    ByteWriter w;
    for (size_t i = 0; i < geometry->positions.size(); ++i)
      plyVertex(w, geometry->positions[i], strip->nodes[geometry->patch[i / 3]].albedo);
    file.write(w.data());
  }
  ByteWriter w;
  for (uint32_t t = 0; t < triangles; ++t) w.u8(3), w.u32(3 * t), w.u32(3 * t + 1), w.u32(3 * t + 2);
  file.write(w.data());
  return {};
}

}  // namespace

Result<void> inspectExport(const WholeWorld& world, const ExportRequest& request, const InspectOutput& out) {
  if (auto ok = checkLevel(world, request.level); !ok) return ok;
  const std::string kind = request.what + " as " + request.format;
  std::function<Result<void>(OutputFile&)> write;
  const uint32_t level = request.level;
  if (kind == "rows as mtx") write = [&](OutputFile& f) { return rowsMtx(world, level, f); };
  if (kind == "rows as npy") write = [&](OutputFile& f) { return rowsNpy(world, level, f); };
  if (kind == "lamps as npy") write = [&](OutputFile& f) { return lampsNpy(world, level, f); };
  if (kind == "patches as npy") write = [&](OutputFile& f) { return patchesNpy(world, level, f); };
  if (kind == "patches as ply") write = [&](OutputFile& f) { return patchesPly(world, level, f); };
  if (kind == "geometry as ply") write = [&](OutputFile& f) { return geometryPly(world, f); };
  if (!write)
    return Error{ErrorCode::kUsage, "", "export", "cannot write " + kind,
                 "rows go to mtx or npy, lamps to npy, patches to npy or ply, geometry to ply"};
  OutputFile file(request.path);
  const auto written = write(file);
  const auto closed = file.close();
  if (!written || !closed) {
    std::remove(request.path.c_str());
    return written ? closed : written;
  }
  if (out.json)
    fmt::print(out.to, "{}\n",
               nlohmann::json{{"file", request.path}, {"what", request.what}, {"format", request.format}, {"level", level},
                              {"nodes", world.levels()[level].nodes}, {"entries", world.levels()[level].entries}}
                   .dump());
  return {};
}

}  // namespace ff::tools
