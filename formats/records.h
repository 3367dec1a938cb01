// The fixed-size records of shards and manifest, field by field. Each record has one `fields` function that serves for
// reading (ByteReader) and for writing (ByteWriter); sizes and offsets are those of FORMAT.md and are tested against it.
#pragma once
#include <cstdint>

#include "formats/bytes.h"
#include "formats/model.h"

namespace ff::formats {

inline constexpr uint64_t kManifestMagic = 0x0a444c524f574646;  // "FFWORLD\n"
inline constexpr uint64_t kShardMagic = 0x0a44524148534646;     // "FFSHARD\n"
inline constexpr uint64_t kFooterMagic = 0x0a58444e49534646;    // "FFSINDX\n"
inline constexpr uint32_t kStripMagic = 0x54534646;             // "FFST"
inline constexpr uint32_t kGeometryMagic = 0x4d474646;          // "FFGM"

inline constexpr uint32_t kKindRows = 0;
inline constexpr uint32_t kKindGeometry = 1;

inline constexpr size_t kStripHeaderBytes = 64;
inline constexpr size_t kStripChecksumOffset = 56;
inline constexpr size_t kIndexRecordBytes = 64;
inline constexpr size_t kFooterBytes = 64;
inline constexpr size_t kManifestHeaderBytes = 64;
inline constexpr size_t kSectionRecordBytes = 40;
inline constexpr size_t kLevelRecordBytes = 32;
inline constexpr uint32_t kMaxStripRawBytes = 64u << 20;
inline constexpr uint32_t kMaxGeometryTriangles = 1u << 24;

// The first 4096 bytes of a shard.
struct ShardHeader {
  uint64_t magic = kShardMagic;
  uint16_t version = kFormatVersion;
  uint16_t reader_version = kFormatVersion;  // a reader must understand this version or newer
  uint32_t kind = kKindRows;
  uint32_t shard = 0;                        // index in the manifest's shard table
  uint64_t checksum = 0;                     // XXH3-64 of bytes 0..4087
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u64(s.magic), io.u16(s.version), io.u16(s.reader_version), io.u32(s.kind), io.u32(s.shard);
    io.reserved(2028);
    io.unused(2040);
    io.u64(s.checksum);
  }
};

// Before a strip's payload. Geometry strips use the same header: magic kGeometryMagic, level 0, entries = triangles,
// blocks = sealed triangles, raw_bytes = 0.
struct StripHeader {
  uint32_t magic = kStripMagic;
  uint8_t level = 0;
  uint16_t nodes = 0;
  uint32_t tile = 0;
  uint32_t first_node = 0;
  uint32_t entries = 0;
  uint32_t blocks = 0;
  uint32_t payload_bytes = 0;
  uint32_t raw_bytes = 0;
  Box bounds;
  uint64_t checksum = 0;
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.magic), io.u8(s.level), io.reserved(1), io.u16(s.nodes), io.u32(s.tile), io.u32(s.first_node);
    io.u32(s.entries), io.u32(s.blocks), io.u32(s.payload_bytes), io.u32(s.raw_bytes), io.box(s.bounds);
    io.u64(s.checksum);
  }
};

// One per strip, in the order of the strips.
struct IndexRecord {
  uint8_t level = 0;
  uint16_t nodes = 0;
  uint32_t tile = 0;
  uint64_t offset = 0;
  uint32_t stored_bytes = 0;
  uint32_t raw_bytes = 0;
  uint32_t first_node = 0;
  uint32_t entries = 0;   // triangles in a geometry shard
  Box bounds;
  uint64_t checksum = 0;  // as in the strip's header
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u8(s.level), io.reserved(1), io.u16(s.nodes), io.u32(s.tile), io.u64(s.offset), io.u32(s.stored_bytes);
    io.u32(s.raw_bytes), io.u32(s.first_node), io.u32(s.entries), io.box(s.bounds), io.u64(s.checksum);
  }
};

// The last 64 bytes of a shard.
struct ShardFooter {
  uint64_t magic = kFooterMagic;
  uint64_t index_offset = 0;
  uint64_t index_checksum = 0;  // XXH3-64 of the index
  uint64_t file_bytes = 0;      // of the whole shard, footer included
  uint32_t records = 0;
  uint64_t checksum = 0;        // XXH3-64 of the footer's bytes 0..55
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u64(s.magic), io.u64(s.index_offset), io.u64(s.index_checksum), io.u64(s.file_bytes), io.u32(s.records);
    io.reserved(20);
    io.u64(s.checksum);
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
inline constexpr uint32_t kSectionParents = 4;
inline constexpr uint32_t kSectionGrid = 5;
inline constexpr uint32_t kSectionLampGroups = 6;
inline constexpr uint32_t kSectionLights = 7;
inline constexpr uint32_t kSectionLast = kSectionLights;     // the largest kind that this reader knows
inline constexpr uint32_t kSectionOptional = 0x80000000u;  // kinds with this bit may be skipped by who does not know them

struct SectionRecord {
  uint32_t kind = 0;
  uint64_t offset = 0;
  uint64_t stored_bytes = 0;
  uint64_t raw_bytes = 0;  // equal to stored_bytes unless the section is compressed
  uint64_t checksum = 0;   // XXH3-64 of the stored bytes
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.kind), io.reserved(4), io.u64(s.offset), io.u64(s.stored_bytes), io.u64(s.raw_bytes), io.u64(s.checksum);
  }
};

struct LevelRecord {
  static constexpr size_t kBytes = kLevelRecordBytes;
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.nodes), io.u32(s.tiles), io.u64(s.entries), io.u64(s.stored_bytes), io.f32(s.cell_m);
    io.reserved(4);
  }
};

struct WorldInfoRecord {
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.f32(s.cell_m), io.vec3(s.grid_origin), io.box(s.bounds), io.u32(s.rays), io.u32(s.quanta), io.u64(s.seed);
    io.bytes(s.bake_key), io.f32(s.row_total_deviation), io.f64(s.area_m2), io.u64(s.triangles);
    io.f64(s.absorbed_fraction), io.text(s.generator), io.text(s.scene);
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
  std::string name;             // a plain file name beside the manifest
  uint32_t kind = kKindRows;
  uint32_t records = 0;
  uint64_t bytes = 0;
  uint64_t index_checksum = 0;  // as in the shard's footer
  template <class Io, class Self>
  static void fields(Io& io, Self& s) {
    io.u32(s.kind), io.u32(s.records), io.u64(s.bytes), io.u64(s.index_checksum), io.text(s.name);
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
