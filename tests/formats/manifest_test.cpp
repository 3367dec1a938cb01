// Manifests whose checksums are right but whose content is not: hostile sizes, names, counts.
#include <gtest/gtest.h>
#include <zstd.h>

#include <functional>
#include <limits>

#include "formats/checksum.h"
#include "formats/manifest.h"
#include "formats/reader.h"
#include "tests/support/furnace_world.h"

namespace ff::formats {
namespace {

constexpr size_t kTable = kManifestHeaderBytes;

// The manifest of a small world, taken apart into sections that can be changed and put together again.
class OpenManifest {
 public:
  struct Part {
    SectionRecord record;
    std::vector<std::byte> bytes;
  };
  ManifestHeader header;
  std::vector<Part> parts;

  OpenManifest() {
    TemporaryFolder folder;
    RandomWorld w = makeFurnaceWorld(300);
    w.grid.assign(5000, std::byte{7});
    EXPECT_TRUE(writeWorld(w, folder.file("w.ffm"), 1 << 28));
    const std::vector<std::byte> bytes = readFile(folder.file("w.ffm"));
    ByteReader r(bytes);
    ManifestHeader::fields(r, header);
    for (uint32_t i = 0; i < header.sections; ++i) {
      Part& p = parts.emplace_back();
      SectionRecord::fields(r, p.record);
      const auto begin = bytes.begin() + static_cast<std::ptrdiff_t>(p.record.offset);
      p.bytes.assign(begin, begin + static_cast<std::ptrdiff_t>(p.record.stored_bytes));
    }
  }

  Part& part(uint32_t kind) {
    for (Part& p : parts)
      if (p.record.kind == kind) return p;
    return parts.front();
  }

  // With right offsets, sizes and checksums. The table may be damaged before it is sealed.
  std::vector<std::byte> seal(const std::function<void(std::vector<SectionRecord>&)>& damage = {}) {
    std::vector<SectionRecord> records;
    uint64_t offset = kTable + parts.size() * kSectionRecordBytes;
    for (const Part& p : parts) {
      SectionRecord s = p.record;
      s.offset = offset;
      s.stored_bytes = p.bytes.size();
      if (s.kind != kSectionGrid) s.raw_bytes = s.stored_bytes;
      s.checksum = hashBytes(p.bytes);
      offset += s.stored_bytes;
      records.push_back(s);
    }
    if (damage) damage(records);
    ByteWriter table;
    for (const SectionRecord& s : records) SectionRecord::fields(table, s);
    header.sections = static_cast<uint32_t>(records.size());
    header.file_bytes = offset;
    header.table_checksum = hashBytes(table.data());
    std::vector<std::byte> out = recordBytes(header);
    storeLittle(out.data() + 56, hashBytes(std::span(out).first(56)));
    out.insert(out.end(), table.data().begin(), table.data().end());
    for (const Part& p : parts) out.insert(out.end(), p.bytes.begin(), p.bytes.end());
    return out;
  }
};

// The small world's, with these bytes as its section of a kind.
std::vector<std::byte> sealedWith(uint32_t kind, const std::vector<std::byte>& bytes) {
  OpenManifest m;
  std::erase_if(m.parts, [&](const OpenManifest::Part& p) { return p.record.kind == kind; });
  OpenManifest::Part& part = m.parts.emplace_back();
  part.record.kind = kind;
  part.bytes = bytes;
  return m.seal();
}

void expectRefused(const std::string& message, const std::vector<std::byte>& bytes) {
  const auto parsed = parseManifest(bytes);
  ASSERT_FALSE(parsed) << message;
  EXPECT_EQ(parsed.error().code, ErrorCode::kInvalidFile);
  EXPECT_NE(parsed.error().message.find(message), std::string::npos) << parsed.error().line();
  EXPECT_NE(parsed.error().place.find("offset"), std::string::npos) << parsed.error().line();
}

TEST(ManifestRules, TheUntouchedManifestPasses) {
  const auto parsed = parseManifest(OpenManifest().seal());
  ASSERT_TRUE(parsed) << parsed.error().line();
  EXPECT_EQ(parsed->grid_bytes, 5000u);
}

TEST(ManifestRules, SectionsLieInTheFile) {
  OpenManifest m;
  expectRefused("outside the file", m.seal([](auto& t) { t[1].stored_bytes = ~uint64_t{0} - 8; }));
  expectRefused("outside the file", m.seal([](auto& t) { t[1].offset += 1; }));
  std::vector<std::byte> longer = m.seal();
  longer.push_back(std::byte{0});
  m.header.file_bytes = longer.size();
  std::vector<std::byte> head = recordBytes(m.header);
  storeLittle(head.data() + 56, hashBytes(std::span(head).first(56)));
  std::copy(head.begin(), head.end(), longer.begin());
  expectRefused("after the last section", longer);
}

TEST(ManifestRules, KnownSectionsComeOnceAndUnknownOnesAreOptional) {
  OpenManifest m;
  m.parts.push_back(m.part(kSectionInfo));
  expectRefused("twice", m.seal());
  m.parts.back().record.kind = 77;
  expectRefused("unknown kind 77", m.seal());
  m.parts.back().record.kind = kSectionOptional | 77;
  EXPECT_TRUE(parseManifest(m.seal()));
  m.parts.erase(m.parts.begin() + 3);
  expectRefused("lacks section", m.seal());
}

TEST(ManifestRules, ShardsAreFilesBesideTheManifest) {
  for (const std::string& name : {std::string(), std::string("."), std::string(".."), std::string("../w.0000.ffs"),
                                 std::string("/etc/passwd"), std::string("a\0b", 3)}) {
    OpenManifest m;
    ByteWriter w;
    ShardRecord record;
    record.name = name;
    ShardRecord::fields(w, record);
    m.part(kSectionShards).bytes = w.data();
    expectRefused("plain file name", m.seal());
  }
  EXPECT_TRUE(isPlainFileName("town.0123456789abcdef.ffs"));
}

TEST(ManifestRules, TheGridIsAsLargeAsItsFrame) {
  // A terabyte promised by a few bytes: refused, and no terabyte taken.
  OpenManifest m;
  m.part(kSectionGrid).record.raw_bytes = uint64_t{1} << 40;
  expectRefused("spatial grid", m.seal());
  m.part(kSectionGrid).record.raw_bytes = 4999;
  expectRefused("spatial grid", m.seal());
  m.part(kSectionGrid).record.raw_bytes = 0;
  expectRefused("spatial grid", m.seal());
  m.part(kSectionGrid).record.raw_bytes = 5000;
  m.part(kSectionGrid).bytes.push_back(std::byte{0});
  expectRefused("spatial grid", m.seal());
  m.part(kSectionGrid).bytes.resize(6);
  expectRefused("spatial grid", m.seal());
  m.part(kSectionGrid).bytes.clear();
  expectRefused("spatial grid", m.seal());
}

// A gigabyte of zeros takes 32 kB.
TEST(ManifestRules, TheGridTakesNoMoreMemoryThanTheWorldsPatchesAllow) {
  const auto sealed = [](uint64_t raw_bytes) {
    OpenManifest m;
    const std::vector<std::byte> zeros(raw_bytes);
    std::vector<std::byte>& bytes = m.part(kSectionGrid).bytes;
    bytes.resize(ZSTD_compressBound(zeros.size()));
    bytes.resize(ZSTD_compress(bytes.data(), bytes.size(), zeros.data(), zeros.size(), 1));
    m.part(kSectionGrid).record.raw_bytes = raw_bytes;
    return m.seal();
  };
  const uint64_t most = (4 << 20) + 512 * 300;
  EXPECT_TRUE(parseManifest(sealed(most)));
  expectRefused("spatial grid has 4347905 bytes, for the world's patches 4347904 are allowed", sealed(most + 1));
}

TEST(ManifestRules, LevelsAndParentsAgree) {
  const auto set = [](std::vector<std::byte>& bytes, size_t at, uint32_t value) { storeLittle(bytes.data() + at, value); };
  {
    OpenManifest m;  // four billion nodes, 40 bytes of links
    set(m.part(kSectionLevels).bytes, 0, 0xffffffff);
    expectRefused("cut off", m.seal());
  }
  {
    OpenManifest m;
    set(m.part(kSectionLevels).bytes, kLevelRecordBytes, 149);
    expectRefused("parents", m.seal());
  }
  {
    OpenManifest m;
    set(m.part(kSectionLevels).bytes, 4, 301);  // more tiles than nodes
    expectRefused("cannot be", m.seal());
  }
  {
    OpenManifest m;
    set(m.part(kSectionLevels).bytes, 28, 1);
    expectRefused("reserved", m.seal());
  }
  {
    OpenManifest m;
    m.part(kSectionParents).bytes[0] &= std::byte{0xfe};
    expectRefused("begin with a parent", m.seal());
  }
  {
    OpenManifest m;
    m.part(kSectionParents).bytes[7] |= std::byte{0x80};  // tiles
    expectRefused("past the last", m.seal());
  }
  {
    OpenManifest m;
    m.part(kSectionParents).bytes[47] |= std::byte{0x80};  // nodes
    expectRefused("past the last", m.seal());
  }
  {
    OpenManifest m;
    m.part(kSectionParents).bytes.pop_back();
    expectRefused("cut off", m.seal());
    m.part(kSectionParents).bytes.resize(200);
    expectRefused("wrong length", m.seal());
  }
  {
    OpenManifest m;
    m.part(kSectionLevels).bytes.clear();
    expectRefused("0 levels", m.seal());
    m.part(kSectionLevels).bytes.resize(17 * kLevelRecordBytes);
    expectRefused("17 levels", m.seal());
  }
}

TEST(ManifestRules, EveryNodeIsTheParentOfOneFamilyAndParentsAscendWithinATile) {
  const auto opens = [](const std::function<void(std::span<std::byte>)>& damage) {
    TemporaryFolder folder;
    EXPECT_TRUE(writeWorld(makeFurnaceWorld(300), folder.file("w.ffm"), 1 << 28));
    OpenManifest m;
    damage(std::span(m.part(kSectionParents).bytes).subspan(48));  // places
    std::erase_if(m.parts, [](const OpenManifest::Part& p) { return p.record.kind == kSectionGrid; });
    writeFile(folder.file("w.ffm"), m.seal());
    const auto world = World::open(folder.file("w.ffm"));
    if (!world) {
      EXPECT_NE(world.error().line().find("each once and ascending"), std::string::npos) << world.error().line();
    }
    return world.has_value();
  };
  EXPECT_TRUE(opens([](auto) {}));
  EXPECT_FALSE(opens([](auto places) { places[149] = std::byte{150}; }));            // past the tile above
  EXPECT_FALSE(opens([](auto places) { places[149] = std::byte{0}; }));              // descends
  EXPECT_FALSE(opens([](auto places) { std::swap(places[3], places[4]); }));
  EXPECT_FALSE(opens([](auto places) { places[128] = places[127]; }));              // in another tile: twice
}

TEST(ManifestRules, WorldInformationIsComplete) {
  OpenManifest m;
  std::vector<std::byte>& info = m.part(kSectionInfo).bytes;
  info.pop_back();
  expectRefused("wrong length", m.seal());
  OpenManifest n;
  storeLittle(n.part(kSectionInfo).bytes.data(), 0x7fc00000u);  // cell_m: NaN
  expectRefused("cannot be", n.seal());
}

TEST(ManifestRules, LightsCanBe) {
  const Light spot{"s", Light::kSpot, {1, 1, 1}, {0, 3, 0}, {0, -1, 0}, 5, 0.2f, 0.4f};
  const auto sealed = [](const Light& light) {
    ByteWriter w;
    LightRecord::fields(w, light);
    return sealedWith(kSectionLights, w.data());
  };
  const auto good = parseManifest(sealed(spot));
  ASSERT_TRUE(good) << good.error().line();
  EXPECT_EQ(good->info.lights, std::vector{spot});
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const auto& damage : std::vector<std::function<void(Light&)>>{
           [](Light& l) { l.kind = 3; }, [](Light& l) { l.color_intensity.y = -1; },
           [&](Light& l) { l.color_intensity.z = nan; }, [&](Light& l) { l.position.x = nan; },
           [](Light& l) { l.direction = {}; }, [](Light& l) { l.direction = {0, -2, 0}; },
           [](Light& l) { l.kind = Light::kPoint; }, [](Light& l) { l.range_m = -1; },
           [&](Light& l) { l.range_m = std::numeric_limits<float>::infinity(); }, [](Light& l) { l.inner_angle = 0.4f; },
           [](Light& l) { l.inner_angle = -0.1f; }, [](Light& l) { l.outer_angle = 1.6f; },
           [&](Light& l) { l.outer_angle = nan; }, [](Light& l) { l.kind = Light::kDirectional; }}) {
    Light light = spot;
    damage(light);
    expectRefused("light holds a value that cannot be", sealed(light));
  }
}

TEST(ManifestRules, LampGroupsCanBe) {
  const auto sealed = [](const LampGroup& group) {
    ByteWriter w;
    LampGroupRecord::fields(w, group);
    return sealedWith(kSectionLampGroups, w.data());
  };
  const LampGroup lamp{"lamp", {1, 0, kMaxEmission}, 2, 3};
  ASSERT_TRUE(parseManifest(sealed(lamp)));
  for (const float emission : {-1.0f, 1.1e12f, 3e38f, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN()}) {
    LampGroup damaged = lamp;
    damaged.emission.y = emission;
    expectRefused("lamp group holds a value that cannot be", sealed(damaged));
  }
}

TEST(ManifestRules, AWorldWithoutLightsHasNoSectionOfThem) {
  OpenManifest m;
  for (const auto& part : m.parts) EXPECT_NE(part.record.kind, kSectionLights);
  const auto parsed = parseManifest(m.seal());
  ASSERT_TRUE(parsed);
  EXPECT_TRUE(parsed->info.lights.empty());
}

}  // namespace
}  // namespace ff::formats
