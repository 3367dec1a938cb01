// The fixed-size records of shards and manifest, field by field. Each record has one `fields` function that serves for
// reading (ByteReader) and for writing (ByteWriter); sizes and offsets are those of FORMAT.md and are tested against it.
#pragma once
#include <cstdint>

#include "formats/codec/bytes.h"
#include "formats/model.h"

namespace ff::formats {

inline constexpr uint64_t kManifestMagic = 0x0a444c524f574646;  // "FFWORLD\n"
inline constexpr uint64_t kShardMagic = 0x0a44524148534646;     // "FFSHARD\n"
inline constexpr uint32_t kStripMagic = 0x54534646;             // "FFST"
inline constexpr uint32_t kGeometryMagic = 0x4d474646;          // "FFGM"
inline constexpr uint32_t kChunkMagic = 0x48434646;             // "FFCH"

inline constexpr int kZstdLevel = 3;  // of strips and manifest

inline constexpr uint32_t kKindRows = 0;
inline constexpr uint32_t kKindGeometry = 1;
inline constexpr uint32_t kKindIndex = 2;
inline constexpr uint32_t kShardKinds = 3;

inline constexpr size_t kStripHeaderBytes = 32;
inline constexpr size_t kChunkHeaderBytes = 20;
inline constexpr size_t kExtentBytes = 28;
inline constexpr size_t kTileRecordBytes = 70;
inline constexpr size_t kGeometryRecordBytes = 32;
inline constexpr size_t kChildRecordBytes = 56;   // and 16 bytes for each level below its parent
inline constexpr size_t kLevelCountBytes = 16;
inline constexpr size_t kManifestHeaderBytes = 64;
inline constexpr size_t kSectionRecordBytes = 40;
inline constexpr size_t kLevelRecordBytes = 32;
inline constexpr uint32_t kMaxStripRawBytes = 64u << 20;
inline constexpr uint32_t kMaxChunkRawBytes = 32u << 20;
inline constexpr uint32_t kMaxGeometryTriangles = 1u << 24;

// The first 4096 bytes of a shard.
struct ShardHeader {
  uint64_t magic = kShardMagic;
  uint16_t version = kFormatVersion;
  uint16_t reader_version = kFormatVersion;  // a reader must understand this version or newer
  uint32_t kind = kKindRows;
  uint64_t checksum = 0;                     // XXH3-64 of bytes 0..4087
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u64(s.magic), io.u16(s.version), io.u16(s.reader_version), io.u32(s.kind);
    io.reserved(2032);
    io.unused(2040);
    io.u64(s.checksum);
  }
};

// Before a strip's payload. Geometry strips use the same header: magic kGeometryMagic, level 0, entries = triangles,
// blocks = sealed triangles, nodes = largest patch number + 1, chunks = raw_bytes = 0.
struct StripHeader {
  uint32_t magic = kStripMagic;
  uint8_t level = 0;
  uint16_t nodes = 0;
  uint32_t entries = 0;
  uint32_t blocks = 0;
  uint32_t chunks = 0;         // in which the blocks' partner tiles lie
  uint32_t payload_bytes = 0;
  uint32_t raw_bytes = 0;
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.magic), io.u8(s.level), io.reserved(1), io.u16(s.nodes), io.u32(s.entries), io.u32(s.blocks);
    io.u32(s.chunks), io.u32(s.payload_bytes), io.u32(s.raw_bytes), io.reserved(4);
  }
};

// An Extent, wherever one stands.
struct ExtentRecord : Extent {
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.shard), io.u64(s.offset), io.u32(s.stored_bytes), io.u32(s.raw_bytes), io.u64(s.checksum);
  }
};

// A chunk's record (chunk.h): this header, then its tiles, their geometry, the nodes' parents, its children.
struct ChunkHeader {
  uint32_t magic = kChunkMagic;
  uint8_t level = 0;
  uint8_t geometry = 0;        // 1: there is a GeometryRecord for each tile
  uint16_t children = 0;
  uint32_t tiles = 0;
  uint32_t nodes = 0;
  uint32_t first_number = 0;   // of the first tile
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.magic), io.u8(s.level), io.u8(s.geometry), io.u16(s.children), io.u32(s.tiles), io.u32(s.nodes), io.u32(s.first_number);
  }
};

struct TileRecord {
  uint16_t nodes = 0;
  uint16_t parent = 0;         // number of the parent tile within its chunk; 0xffff at the coarsest level
  uint16_t child = 0;          // which of the chunk's children holds the child tiles
  uint16_t first_child = 0;    // number within that
  uint16_t child_tiles = 0;    // 0 at level 0
  uint32_t entries = 0;
  Extent strip;
  Box bounds;                  // less the chunk's corner
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u16(s.nodes), io.u16(s.parent), io.u16(s.child), io.u16(s.first_child), io.u16(s.child_tiles), io.reserved(4), io.u32(s.entries);
    ExtentRecord::fields(io, s.strip);
    io.box(s.bounds);
  }
};

struct GeometryRecord : GeometryInfo {
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    ExtentRecord::fields(io, s.strip);
    io.u32(s.triangles);
  }
};

struct ManifestHeader {
  uint64_t magic = kManifestMagic;
  uint16_t version = kFormatVersion;
  uint16_t reader_version = kFormatVersion;
  uint32_t sections = 0;
  uint64_t file_bytes = 0;
  uint64_t table_checksum = 0;  // XXH3-64 of the section table
  uint64_t checksum = 0;        // XXH3-64 of the header's bytes 0..55
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u64(s.magic), io.u16(s.version), io.u16(s.reader_version), io.u32(s.sections), io.u64(s.file_bytes);
    io.u64(s.table_checksum), io.reserved(24), io.u64(s.checksum);
  }
};

inline constexpr uint32_t kSectionInfo = 1;
inline constexpr uint32_t kSectionLevels = 2;
inline constexpr uint32_t kSectionShards = 3;
inline constexpr uint32_t kSectionRoot = 4;
inline constexpr uint32_t kSectionLampGroups = 5;
inline constexpr uint32_t kSectionLights = 6;
inline constexpr uint32_t kSectionLast = kSectionLights;     // the largest kind that this reader knows
inline constexpr uint32_t kSectionOptional = 0x80000000u;  // kinds with this bit may be skipped by who does not know them

struct SectionRecord {
  uint32_t kind = 0;
  uint64_t offset = 0;
  uint64_t stored_bytes = 0;
  uint64_t raw_bytes = 0;  // equal to stored_bytes: no section is compressed
  uint64_t checksum = 0;   // XXH3-64 of the stored bytes
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.kind), io.reserved(4), io.u64(s.offset), io.u64(s.stored_bytes), io.u64(s.raw_bytes), io.u64(s.checksum);
  }
};

struct LevelRecord {
  static constexpr size_t kBytes = kLevelRecordBytes;
  uint64_t nodes = 0, tiles = 0, entries = 0, stored_bytes = 0;
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u64(s.nodes), io.u64(s.tiles), io.u64(s.entries), io.u64(s.stored_bytes);
  }
};

struct WorldInfoRecord {
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.f32(s.cell_m), io.f64(s.origin[0]), io.f64(s.origin[1]), io.f64(s.origin[2]), io.box(s.bounds), io.u32(s.rays), io.u32(s.quanta), io.u64(s.seed);
    io.bytes(s.bake_key), io.f32(s.row_total_deviation), io.f64(s.area_m2), io.u64(s.triangles);
    io.f64(s.absorbed_fraction), io.u32(s.fewest_rays), io.f32(s.target_error), io.f32(s.row_error), io.u8(s.preview), io.text(s.generator), io.text(s.scene);
  }
};

struct LampGroupRecord {
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.vec3(s.emission), io.f64(s.area_m2), io.u32(s.patches), io.text(s.name);
  }
};

struct LightRecord {
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u8(s.kind), io.reserved(3), io.vec3(s.color_intensity), io.vec3(s.position), io.vec3(s.direction);
    io.f32(s.range_m), io.f32(s.inner_angle), io.f32(s.outer_angle), io.text(s.name);
  }
};

struct ShardRecord {
  std::string name;   // a plain file name beside the manifest
  uint32_t kind = kKindRows;
  uint64_t bytes = 0;
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.kind), io.u64(s.bytes), io.text(s.name);
  }
};

// Writing: the bytes of one record.
template <class Record>
std::vector<std::byte> recordBytes(const Record& record) {
  ByteWriter w;
  Record::fields(w, record);
  return std::move(w.data());
}

}  // namespace ff::formats
