// What is written is what is read, within the quantisation that FORMAT.md states.
#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "formats/codec/geometry.h"
#include "formats/codec/strip_codec.h"
#include "formats/read/whole_world.h"
#include "formats/write/writer.h"
#include "tests/support/random_world.h"

namespace ff::formats {
namespace {

// Half a step of the 16-bit fractions, the rounding of the float sum lo + extent * t, and that of bounds told from a corner 100 m away.
void expectNear(Vec3 read, Vec3 written, const Box& bounds) {
  for (int c = 0; c < 3; ++c) {
    const float scale = std::max({std::abs(bounds.lo[c]), std::abs(bounds.hi[c]), 1e-30f});
    ASSERT_NEAR(read[c], written[c], 0.5f / 65535 * (bounds.hi[c] - bounds.lo[c]) + 8 * 6e-8f * scale + 2e-5f);
  }
}

void expectSameNode(const Node& read, const Node& written, const Box& bounds) {
  ASSERT_EQ(read.area_m2, written.area_m2);
  expectNear(read.centroid, written.centroid, bounds);
  // Octahedral coordinates are off by half of 1/32767 each; the map stretches by less than 3.
  ASSERT_LT(length(read.normal - written.normal), 3.0f / 32767) << written.normal.x << " " << written.normal.y;
  for (int c = 0; c < 3; ++c) {
    ASSERT_NEAR(read.albedo[c], written.albedo[c], 0.5f / 65535 + 1e-7f);
    ASSERT_EQ(read.emission[c], written.emission[c]);
    // Half a step, or a whole one more where length 1 has to be kept.
    ASSERT_NEAR(read.sky_direction[c], written.sky_direction[c], 1.5f / 127 + 1e-6f);
  }
  ASSERT_LE(length(read.sky_direction), 1 + 1e-6f);
  ASSERT_EQ(read.quanta, written.quanta);
  ASSERT_EQ(read.sky, written.sky);
  ASSERT_EQ(read.absorbed, written.absorbed);
  // Fractions keep 12 bits; the quadratic means a step of 1/127.
  ASSERT_NEAR(read.sky_fraction, written.sky_fraction, 0x1p-12f * written.sky_fraction);
  ASSERT_NEAR(read.row_total, written.row_total, 0x1p-12f * written.row_total);
  for (size_t k = 0; k < read.sky_quadratic.size(); ++k)
    ASSERT_NEAR(read.sky_quadratic[k], written.sky_quadratic[k], 0.5f / 127 + 1e-6f);
  ASSERT_EQ(read.lamp_group, written.lamp_group);
}

void expectSameWorld(const WholeWorld& read, const RandomWorld& w) {
  ASSERT_EQ(read.info().lights, w.info.lights);
  ASSERT_EQ(read.levels().size(), w.strips.size());
  for (uint32_t level = 0; level < w.strips.size(); ++level) {
    ASSERT_EQ(read.tiles(level).size(), w.strips[level].size());
    ASSERT_EQ(read.levels()[level].cell_m, std::ldexp(w.info.cell_m, static_cast<int>(level)));
    uint64_t entries = 0;
    for (uint32_t tile = 0; tile < w.strips[level].size(); ++tile) {
      const Strip& written = w.strips[level][tile];
      auto strip = read.strip(TileId{level, tile});
      ASSERT_TRUE(strip) << strip.error().line();
      ASSERT_EQ(strip->id, written.id);
      ASSERT_EQ(strip->first_node, written.first_node);
      ASSERT_EQ(strip->nodes.size(), written.nodes.size());
      for (size_t i = 0; i < written.nodes.size(); ++i)
        expectSameNode(strip->nodes[i], written.nodes[i], w.bounds[level][tile]);
      ASSERT_TRUE(std::ranges::equal(strip->blocks, written.blocks, [](const Block& a, const Block& b) {
        return a.partner_tile == b.partner_tile && a.entries == b.entries;
      }));
      ASSERT_EQ(strip->rows, written.rows);
      ASSERT_EQ(strip->columns, written.columns);
      ASSERT_EQ(strip->counts, written.counts);
      ASSERT_EQ(strip->lamps.size(), written.lamps.size());
      for (size_t k = 0; k < written.lamps.size(); ++k) {
        ASSERT_EQ(strip->lamps[k].row, written.lamps[k].row);
        ASSERT_EQ(strip->lamps[k].group, written.lamps[k].group);
        for (int c = 0; c < 3; ++c)
          ASSERT_NEAR(strip->lamps[k].weight[c], written.lamps[k].weight[c], 0x1p-12f * written.lamps[k].weight[c]);
      }
      const TileInfo& info = read.tiles(level)[tile];
      for (int a = 0; a < 3; ++a) {  // files hold bounds from the chunk's corner
        ASSERT_NEAR(info.bounds.lo[a], w.bounds[level][tile].lo[a], 4e-5f);
        ASSERT_NEAR(info.bounds.hi[a], w.bounds[level][tile].hi[a], 4e-5f);
      }
      ASSERT_EQ(info.nodes, written.nodes.size());
      entries += info.entries;
    }
    ASSERT_EQ(read.levels()[level].entries, entries);
  }
}

TEST(StripCodec, FractionsKeepTwelveBitsFromOneDownToTwoToTheMinusThirtyAndAreInOrder) {
  EXPECT_EQ(packFraction(0), 0);
  EXPECT_EQ(packFraction(-1), 0);
  EXPECT_EQ(packFraction(1), kFractionOne);
  EXPECT_EQ(packFraction(7), kFractionOne);
  float before = -1;
  for (uint32_t code = 0; code <= kFractionOne; ++code) {
    const float v = unpackFraction(static_cast<uint16_t>(code));
    ASSERT_GT(v, before);
    ASSERT_EQ(packFraction(v), code);
    before = v;
  }
  for (float v = 1; v > 0x1p-30f; v *= 0.9371f) ASSERT_NEAR(unpackFraction(packFraction(v)), v, 0x1p-12f * v) << v;
}

TEST(World, ReadsWhatWasWritten) {
  for (uint64_t seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE(seed);
    TemporaryFolder folder;
    RandomWorldSettings settings;
    settings.seed = seed;
    settings.level0_tiles = static_cast<uint32_t>(1 + seed * seed / 3);
    settings.max_tile_nodes = seed % 3 == 0 ? 7 : kTileNodes;
    settings.levels = static_cast<uint32_t>(1 + seed % 4);
    settings.quanta = seed % 2 == 0 ? 64 : 2000;
    settings.geometry = seed % 4 != 1;
    const RandomWorld w = makeRandomWorld(settings);
    const auto written = writeWorld(w, folder.file("w.ffm"), seed % 2 == 0 ? 20000 : 1 << 28);
    ASSERT_TRUE(written) << written.error().line();
    auto world = WholeWorld::open(folder.file("w.ffm"));
    ASSERT_TRUE(world) << world.error().line();
    expectSameWorld(*world, w);
    EXPECT_EQ(world->info().scene, w.info.scene);
    EXPECT_EQ(world->info().bake_key, w.info.bake_key);
    EXPECT_EQ(world->info().absorbed_fraction, w.info.absorbed_fraction);
    EXPECT_EQ(world->info().row_total_deviation, w.info.row_total_deviation);
    EXPECT_EQ(world->info().fewest_rays, w.info.fewest_rays);
    EXPECT_EQ(world->info().target_error, w.info.target_error);
    EXPECT_EQ(world->info().row_error, w.info.row_error);
    EXPECT_EQ(world->info().preview, w.info.preview);
    EXPECT_EQ(world->info().seed, w.info.seed);
  }
}

TEST(World, LinksNodesTilesParentsAndChildren) {
  TemporaryFolder folder;
  RandomWorldSettings settings;
  settings.level0_tiles = 40;
  settings.max_tile_nodes = 200;
  settings.levels = 4;
  settings.quanta = 4;
  const RandomWorld w = makeRandomWorld(settings);
  ASSERT_TRUE(writeWorld(w, folder.file("w.ffm"), 1 << 28));
  auto world = WholeWorld::open(folder.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  const auto names = nameTiles(w);
  for (uint32_t level = 0; level < 4; ++level) {
    for (const Strip& strip : w.strips[level])
      for (uint32_t i = 0; i < strip.nodes.size(); ++i) ASSERT_EQ(world->tileOf(level, strip.first_node + i), strip.id.tile);
    if (level == 3) {
      EXPECT_EQ(world->parent(level, 0), kNoParent);
      continue;
    }
    bool in_order = true;  // else nothing is shown of families that are not in the order of their parents
    for (const Strip& strip : w.strips[level]) {
      const TileRef tile = world->ref(strip.id);
      ASSERT_EQ(tile.id(), strip.id);
      ASSERT_EQ(tile.name(), names[level][strip.id.tile]);
      const auto by_name = world->tile(level, tile.name());
      ASSERT_TRUE(by_name && by_name->id() == strip.id);
      const uint32_t above = tile.info().parent_tile;
      ASSERT_EQ(tile.parent().id(), (TileId{level + 1, above}));
      const auto siblings = world->childTiles(tile.parent());
      ASSERT_TRUE(siblings && siblings->chunk == tile.chunk && siblings->first <= tile.index && tile.index < siblings->end);
      for (uint64_t i = strip.first_node; i < strip.first_node + strip.nodes.size(); ++i) {
        ASSERT_EQ(world->tileOf(level + 1, w.parents[level][i]), above);
        ASSERT_EQ(tile.parentIndex()[i - strip.first_node], w.parents[level][i] - w.strips[level + 1][above].first_node);
        in_order = in_order && (i == 0 || w.parents[level][i] >= w.parents[level][i - 1]);
      }
    }
    EXPECT_FALSE(in_order) << level;
    std::vector<std::vector<uint32_t>> children(world->levels()[level + 1].nodes);
    for (uint32_t i = 0; i < w.parents[level].size(); ++i) {
      const uint32_t p = w.parents[level][i];
      ASSERT_EQ(world->parent(level, i), p);
      children[p].push_back(i);
    }
    for (uint32_t p = 0; p < children.size(); ++p) ASSERT_TRUE(std::ranges::equal(world->children(level + 1, p), children[p]));
  }
}

TEST(World, ReadsGeometryInOrder) {
  TemporaryFolder folder;
  const RandomWorld w = makeRandomWorld({});
  ASSERT_TRUE(writeWorld(w, folder.file("w.ffm"), 1 << 28));
  auto world = WholeWorld::open(folder.file("w.ffm"));
  ASSERT_TRUE(world) << world.error().line();
  ASSERT_TRUE(world->hasGeometry());
  size_t triangles = 0;
  for (const TileGeometry& written : w.geometry) {
    auto read = world->geometry(written.tile);
    ASSERT_TRUE(read) << read.error().line();
    ASSERT_EQ(read->patch, written.patch);
    ASSERT_EQ(read->positions.size(), written.positions.size());
    Box extent;
    for (const Vec3& p : written.positions) extent.add(p);
    for (size_t i = 0; i < written.positions.size(); ++i) {
      // One range for all axes: the largest extent; half a step and the floats' rounding at 100 m.
      const Vec3 e = extent.hi - extent.lo;
      const float step = std::max({e.x, e.y, e.z}) / 65535;
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(read->positions[i][c], written.positions[i][c], 0.5f * step + 4e-5f);
    }
    triangles += written.patch.size();
  }
  EXPECT_GT(triangles, 100u);
}

TEST(Geometry, SurvivesWhereItCompressesToLessThanThreeBytesATriangle) {
  // Regular floors compress so well that Draco's decoder takes the number of their faces for a lie.
  for (uint32_t side = 1; side <= 16; ++side) {
    TileGeometry written;
    for (uint32_t i = 0; i < side * side; ++i) {
      const auto x = static_cast<float>(i % side), z = static_cast<float>(i / side);
      for (const Vec3 p : {Vec3{x, 0, z}, {x, 0, z + 1}, {x + 1, 0, z}, {x + 1, 0, z}, {x, 0, z + 1}, {x + 1, 0, z + 1}})
        written.positions.push_back(p);
      written.patch.insert(written.patch.end(), 2, static_cast<uint8_t>(i));
    }
    const auto bytes = encodeGeometry(written);
    ASSERT_TRUE(bytes) << bytes.error().line();
    TileGeometry read;
    const auto decoded = decodeGeometry(*bytes, 2 * side * side, side * side, read);
    ASSERT_TRUE(decoded) << "side " << side << ": " << decoded.error().line();
    ASSERT_EQ(read.patch, written.patch);
  }
}

// 44 kB that hold a right mesh of 1000 triangles and have Draco take 1.5 kB a point besides: with more and larger attributes, gigabytes.
TEST(Geometry, HasNoAttributesButPositionsAndPatchNumbers) {
  constexpr uint32_t kTriangles = 1000;
  const auto encoded = [&](int more, draco::MeshEncoderMethod method) {
    draco::TriangleSoupMeshBuilder builder;
    builder.Start(kTriangles);
    const int position = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
    const int patch = builder.AddAttribute(draco::GeometryAttribute::GENERIC, 1, draco::DT_UINT8);
    const uint8_t zero = 0;
    const std::array<int32_t, 4> none{};
    for (uint32_t t = 0; t < kTriangles; ++t) {
      const draco::FaceIndex face(t);
      const Vec3 a{static_cast<float>(t), 0, 0}, b{static_cast<float>(t), 1, 0}, c{static_cast<float>(t), 0, 1};
      builder.SetAttributeValuesForFace(position, face, &a.x, &b.x, &c.x);
      builder.SetAttributeValuesForFace(patch, face, &zero, &zero, &zero);
    }
    for (int i = 0; i < more; ++i) {
      const int attribute = builder.AddAttribute(draco::GeometryAttribute::GENERIC, 4, draco::DT_INT32);
      for (uint32_t t = 0; t < kTriangles; ++t)
        builder.SetAttributeValuesForFace(attribute, draco::FaceIndex(t), none.data(), none.data(), none.data());
    }
    const auto mesh = builder.Finalize();
    draco::Encoder encoder;
    encoder.SetEncodingMethod(method);
    draco::EncoderBuffer buffer;
    EXPECT_TRUE(encoder.EncodeMeshToBuffer(*mesh, &buffer).ok());
    const auto* bytes = reinterpret_cast<const std::byte*>(buffer.data());
    return std::vector<std::byte>(bytes, bytes + buffer.size());
  };
  TileGeometry read;
  EXPECT_TRUE(decodeGeometry(encoded(0, draco::MESH_SEQUENTIAL_ENCODING), kTriangles, 1, read));
  const auto hostile = encoded(96, draco::MESH_SEQUENTIAL_ENCODING);
  EXPECT_LT(hostile.size(), 50000u);
  const auto refused = decodeGeometry(hostile, kTriangles, 1, read);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().message, "geometry has other attributes than positions and patch numbers");
  const auto wrong = decodeGeometry(encoded(0, draco::MESH_EDGEBREAKER_ENCODING), kTriangles, 1, read);
  ASSERT_FALSE(wrong);
  EXPECT_NE(wrong.error().message.find("sequential"), std::string::npos) << wrong.error().line();
}

TEST(Normal, SurvivesPackingInEveryOctant) {
  for (int x = -8; x <= 8; ++x)
    for (int y = -8; y <= 8; ++y)
      for (int z = -8; z <= 8; ++z) {
        const Vec3 n = normalized({static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)});
        ASSERT_LT(length(unpackNormal(packNormal(n)) - n), 3.0f / 32767) << x << " " << y << " " << z;
      }
  for (int axis = 0; axis < 3; ++axis)
    for (float sign : {-1.0f, 1.0f}) {
      Vec3 n;
      n[axis] = sign;
      EXPECT_EQ(unpackNormal(packNormal(n)), n);  // axes are exact: voxel worlds have no others
    }
}

}  // namespace
}  // namespace ff::formats
