// FORMAT.md and the code say the same numbers: every "| offset | type | field |" table is added up and compared with the
// record it describes.
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <regex>
#include <sstream>

#include "formats/codec/records.h"
#include "formats/codec/strip_codec.h"

namespace ff::formats {
namespace {

std::string page() {
  std::ifstream in(FF_FORMATS "/FORMAT.md");
  std::stringstream s;
  s << in.rdbuf();
  return s.str();
}

size_t sizeOfType(const std::string& type) {
  static const std::map<std::string, size_t> kSizes{{"u8", 1}, {"u16", 2}, {"u32", 4}, {"u64", 8}, {"6 f32", 24}, {"extent", 28}};
  std::smatch bytes;
  if (std::regex_match(type, bytes, std::regex("([0-9]+) bytes"))) return std::stoul(bytes[1]);
  const auto found = kSizes.find(type);
  return found == kSizes.end() ? 0 : found->second;
}

// Checks that fields follow each other without gaps; returns the record's size.
size_t recordSize(const std::string& heading) {
  std::istringstream lines(page());
  std::string line;
  bool inside = false;
  size_t end = 0, fields = 0;
  while (std::getline(lines, line)) {
    if (line.starts_with("### ")) inside = line.find(heading) != std::string::npos;
    std::smatch m;
    if (!inside || !std::regex_match(line, m, std::regex("\\| ([0-9]+) \\| ([^|]+) \\| .*"))) continue;
    EXPECT_EQ(std::stoul(m[1]), end) << heading << ": " << line;
    EXPECT_GT(sizeOfType(m[2]), 0u) << line;
    end += sizeOfType(m[2]);
    ++fields;
  }
  EXPECT_GT(fields, 4u) << heading;
  return end;
}

template <class Record>
size_t writtenSize() {
  return recordBytes(Record{}).size();
}

TEST(FormatPage, RecordSizesAreThoseOfTheCode) {
  EXPECT_EQ(recordSize("2.1 "), writtenSize<ManifestHeader>());
  EXPECT_EQ(recordSize("2.1 "), kManifestHeaderBytes);
  EXPECT_EQ(recordSize("2.2 "), writtenSize<SectionRecord>());
  EXPECT_EQ(recordSize("2.2 "), kSectionRecordBytes);
  EXPECT_EQ(recordSize("3.1 "), writtenSize<ShardHeader>());
  EXPECT_EQ(recordSize("3.1 "), kShardHeaderBytes);
  EXPECT_EQ(recordSize("3.2 "), writtenSize<StripHeader>());
  EXPECT_EQ(recordSize("3.2 "), kStripHeaderBytes);
  EXPECT_EQ(recordSize("4.1 "), writtenSize<ChunkHeader>());
  EXPECT_EQ(recordSize("4.1 "), kChunkHeaderBytes);
  EXPECT_EQ(recordSize("4.2 "), writtenSize<TileRecord>());
  EXPECT_EQ(recordSize("4.2 "), kTileRecordBytes);
  EXPECT_EQ(recordSize("2.3 "), writtenSize<ExtentRecord>());
  EXPECT_EQ(recordSize("2.3 "), kExtentBytes);
  EXPECT_EQ(writtenSize<GeometryRecord>(), kGeometryRecordBytes);
  EXPECT_EQ(writtenSize<LevelRecord>(), kLevelRecordBytes);
}

TEST(FormatPage, MagicsAreTheBytesItNames) {
  const auto text = [](const std::vector<std::byte>& bytes, size_t n) {
    return std::string(reinterpret_cast<const char*>(bytes.data()), n);
  };
  EXPECT_EQ(text(recordBytes(ManifestHeader{}), 8), "FFWORLD\n");
  EXPECT_EQ(text(recordBytes(ShardHeader{}), 8), "FFSHARD\n");
  EXPECT_EQ(text(recordBytes(ChunkHeader{}), 4), "FFCH");
  EXPECT_EQ(text(recordBytes(StripHeader{}), 4), "FFST");
  StripHeader geometry;
  geometry.magic = kGeometryMagic;
  EXPECT_EQ(text(recordBytes(geometry), 4), "FFGM");
}

// The node table of 5.1: "| 2 + 2 + 2 | u16 centroid x, y, z | ..." in payload order.
TEST(FormatPage, NodeArraysLieWhereTheCodeExpectsThem) {
  std::istringstream lines(page());
  std::string line;
  bool inside = false;
  std::map<std::string, uint64_t> offsets;
  uint64_t end = 0;
  while (std::getline(lines, line)) {
    if (line.starts_with("### ")) inside = line.find("5.1 ") != std::string::npos;
    std::smatch m;
    if (!inside || !std::regex_match(line, m, std::regex("\\| ([0-9 +]+) \\| [a-z0-9]+ (sky direction|[a-z]+).*"))) continue;
    offsets[m[2]] = end;
    std::istringstream terms(m[1]);
    for (std::string term; terms >> term;)
      if (term != "+") end += std::stoul(term);
  }
  const StripLayout one{.nodes = 1};
  EXPECT_EQ(end, StripLayout::kNodeBytes);
  EXPECT_EQ(offsets.size(), 14u);
  EXPECT_EQ(offsets["area"], one.area());
  EXPECT_EQ(offsets["centroid"], one.centroid());
  EXPECT_EQ(offsets["normal"], one.normal());
  EXPECT_EQ(offsets["albedo"], one.albedo());
  EXPECT_EQ(offsets["emission"], one.emission());
  EXPECT_EQ(offsets["quanta"], one.quanta());
  EXPECT_EQ(offsets["sky"], one.sky());
  EXPECT_EQ(offsets["absorbed"], one.absorbed());
  EXPECT_EQ(offsets["sky direction"], one.skyDirection());
  EXPECT_EQ(offsets["quadratic"], one.skyQuadratic());
  EXPECT_EQ(offsets["fraction"], one.skyFraction());
  EXPECT_EQ(offsets["total"], one.rowTotal());
  EXPECT_EQ(offsets["group"], one.lampGroup());
  EXPECT_EQ(offsets["lamps"], one.lampCount());
  EXPECT_NE(page().find("| " + std::to_string(StripLayout::kNodeBytes) + " N |"), std::string::npos);
  EXPECT_NE(page().find("| " + std::to_string(StripLayout::kLampBytes) + " L |"), std::string::npos);
  EXPECT_NE(page().find("| " + std::to_string(StripLayout::kChunkBytes) + " C |"), std::string::npos);
  EXPECT_NE(page().find("| " + std::to_string(StripLayout::kBlockBytes) + " B |"), std::string::npos);
  EXPECT_NE(page().find("2^" + std::to_string(kChunkLog) + " cells"), std::string::npos);
  EXPECT_NE(page().find("at most " + std::to_string(kMaxChunkTiles) + " tiles"), std::string::npos);
  EXPECT_NE(page().find("at most " + std::to_string(kMaxChunkRawBytes)), std::string::npos);
  EXPECT_NE(page().find("| " + std::to_string(StripLayout::kRunBytes) + " R |"), std::string::npos);
  EXPECT_NE(page().find("at most " + std::to_string(kMaxBlocks)), std::string::npos);
  EXPECT_NE(page().find("at most " + std::to_string(kMaxRowFactor) + " times the world's"), std::string::npos);
  EXPECT_NE(page().find("at most " + std::to_string(kMaxStripRawBytes)), std::string::npos);
  EXPECT_NE(page().find("format, version " + std::to_string(kFormatVersion)), std::string::npos);
}

}  // namespace
}  // namespace ff::formats
