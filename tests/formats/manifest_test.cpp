// Manifests whose checksums are right but whose content is not: hostile sizes, names, counts.
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <tuple>

#include "formats/codec/checksum.h"
#include "formats/codec/manifest.h"
#include "formats/read/whole_world.h"
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
    EXPECT_TRUE(writeWorld(makeFurnaceWorld(300), folder.file("w.ffm"), 1 << 28));
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
      s.raw_bytes = s.stored_bytes;
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
  EXPECT_EQ(parsed->root->children.size(), 1u);
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

TEST(ManifestRules, LevelsAndTheRootAgree) {
  const auto set = [](std::vector<std::byte>& bytes, size_t at, uint64_t value) { storeLittle(bytes.data() + at, value); };
  for (const auto& [at, value, message] : std::vector<std::tuple<size_t, uint64_t, const char*>>{
           {8, uint64_t{1} << 32, "4294967296 tiles, this reader numbers 4294967294"}, {8, ~uint64_t{0}, "this reader numbers"}, {0, uint64_t{1} << 32, "cannot be"}, {0, 301, "hold other tiles and nodes of level 0"},
           {8, 301, "cannot be"}, {kLevelRecordBytes, 149, "hold other tiles and nodes of level 1"}}) {
    OpenManifest m;
    set(m.part(kSectionLevels).bytes, at, value);
    const auto parsed = parseManifest(m.seal());
    ASSERT_FALSE(parsed) << message;
    EXPECT_NE(parsed.error().line().find(message), std::string::npos) << parsed.error().line();
  }
  OpenManifest m;
  m.part(kSectionLevels).bytes.clear();
  expectRefused("0 levels", m.seal());
  m.part(kSectionLevels).bytes.resize(17 * kLevelRecordBytes);
  expectRefused("17 levels", m.seal());
}

TEST(ManifestRules, TheRootHoldsChunksThatCanBe) {
  const auto refused = [](const char* message, const std::function<void(std::vector<std::byte>&)>& damage) {
    OpenManifest m;
    damage(m.part(kSectionRoot).bytes);
    const auto parsed = parseManifest(m.seal());
    ASSERT_FALSE(parsed) << message;
    EXPECT_EQ(parsed.error().code, ErrorCode::kInvalidFile);
    EXPECT_NE(parsed.error().line().find(message), std::string::npos) << parsed.error().line();
  };
  // Cell 12, shard 4, offset 8, stored 4, raw 4, checksum 8, bounds 24, tiles and nodes of two levels 32 bytes.
  ASSERT_EQ(OpenManifest().part(kSectionRoot).bytes.size(), 96u);
  refused("cut off", [](auto& b) { b.pop_back(); });
  refused("cut off", [](auto& b) { b.push_back(std::byte{0}); });
  refused("other tiles and nodes", [](auto& b) { b.clear(); });
  refused("impossible size", [](auto& b) { storeLittle(b.data() + 24, uint32_t{0}); });
  refused("impossible size", [](auto& b) { storeLittle(b.data() + 28, uint32_t{kMaxChunkRawBytes + 1}); });
  refused("bounds", [](auto& b) { storeLittle(b.data() + 40, 0x7fc00000u); });
  refused("numbers of tiles and nodes", [](auto& b) { storeLittle(b.data() + 64, uint64_t{0}); });
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
