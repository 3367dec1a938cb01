// ffinspect trace: paths by hand and paths that were recorded, of one observer and two; files that are none.
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/support/furnace_world.h"
#include "tools/inspect/inspect.h"
#include "tools/inspect/recorded_path.h"

namespace ff::tools {
namespace {

using namespace ff::formats;
using nlohmann::json;

class InspectTrace : public testing::Test {
 protected:
  void SetUp() override {
    const auto ok = writeWorld(makeFurnaceWorld(300), world(), 1 << 28);
    ASSERT_TRUE(ok) << ok.error().line();
  }
  std::string world() const { return folder_.file("f.ffm"); }
  std::string path() const { return folder_.file("path.json"); }
  void writePath(const std::string& text) const { std::ofstream(path()) << text; }
  // Of 60 frames a second along x at 3 m/s; the second observer stands.
  void writeWalk(int frames) const {
    json events = json::array();
    for (int f = 0; f < frames; ++f) {
      const double at = f / 60.0;
      events.push_back({{"name", "stream"}, {"ts", 5000 + at * 1e6}, {"args", {{"observers", {{3 * at, 1.6, 2.0, 3.0, 0.0, 0.0}, {-1.0, 1.0, 1.0}}}}}});
    }
    writePath(json{{"traceEvents", events}}.dump());
  }
  json trace(const TraceRequest& request) const {
    const std::string text = folder_.file("answer");
    std::FILE* to = std::fopen(text.c_str(), "w");
    const auto ok = inspectTrace(world(), request, {true, to});
    std::fclose(to);
    EXPECT_TRUE(ok) << ok.error().line();
    std::ifstream in(text);
    return json::parse(in, nullptr, false);
  }
  TemporaryFolder folder_;
};

TEST_F(InspectTrace, FliesAPathByHandAndThenItsOwnRecord) {
  writeWalk(31);
  const json first = trace({.path = path(), .trace_path = folder_.file("again.json")});
  EXPECT_EQ(first["frames"], 31);
  EXPECT_EQ(first["observers"], 2);
  EXPECT_NEAR(first["seconds"].get<double>(), 0.5, 1e-9);
  EXPECT_NEAR(first["length_m"].get<double>(), 1.5, 1e-6);
  EXPECT_TRUE(first["recorded"].is_null());
  EXPECT_EQ(first["replayed"]["frames_with_late_tiles"], 0);
  EXPECT_EQ(first["replayed"]["strips_failed"], 0);
  EXPECT_GT(first["replayed"]["peak_resident_bytes"].get<uint64_t>(), 0u);
  ASSERT_EQ(first["worst"].size(), 5u);
  for (const json& frame : first["worst"]) {
    EXPECT_EQ(frame["observers"][1], (json{-1.0, 1.0, 1.0}));
    EXPECT_NEAR(frame["observers"][0][0].get<double>(), 3 * frame["seconds"].get<double>(), 1e-9);
  }

  const auto again = readRecordedPath(folder_.file("again.json"));
  ASSERT_TRUE(again) << again.error().line();
  ASSERT_EQ(again->size(), 31u);  // the last frames that were kept
  EXPECT_NEAR(again->back().seconds, 0.5, 0.1);
  EXPECT_NEAR(again->back().observers[0].position[0], 1.5, 1e-6);
  EXPECT_EQ(again->back().observers[0].velocity[0], 3);
  EXPECT_EQ(again->back().observers[1].position[1], 1);
  const json second = trace({.path = folder_.file("again.json")});
  EXPECT_EQ(second["observers"], 2);
  for (const char* figure : {"frame_ms_p50", "frame_ms_p99", "frame_ms_max"})
    EXPECT_NEAR(second["recorded"][figure].get<double>(), first["replayed"][figure].get<double>(), 1e-4) << figure;
}

TEST_F(InspectTrace, SaysWhatIsWrongWithAFile) {
  const auto refusal = [&](const std::string& text) {
    writePath(text);
    const auto read = readRecordedPath(path());
    EXPECT_FALSE(read) << text;
    if (read) return std::string();
    EXPECT_EQ(read.error().code, ErrorCode::kInvalidFile);
    return read.error().line();
  };
  const auto event = [](const std::string& observers, const std::string& ts = "1") {
    return R"({"name":"stream","ts":)" + ts + R"(,"args":{"observers":)" + observers + "}}";
  };
  const auto events = [](const std::string& list) { return R"({"traceEvents":[)" + list + "]}"; };
  EXPECT_NE(refusal("no json").find("is no trace"), std::string::npos);
  EXPECT_NE(refusal(R"({"traceEvents":3})").find("is no trace"), std::string::npos);
  EXPECT_NE(refusal(events("")).find("no \"stream\" event"), std::string::npos);
  EXPECT_NE(refusal(events(R"(3, null, {"name":3}, {"name":"stream"}, {"name":"stream","args":4})")).find("no \"stream\" event"), std::string::npos);
  EXPECT_NE(refusal(events(event("[]"))).find("traceEvents[0]"), std::string::npos);
  std::string many = "[0,0,0]";
  for (int k = 1; k < 17; ++k) many += ",[0,0,0]";
  EXPECT_NE(refusal(events(event("[" + many + "]"))).find("more than 16"), std::string::npos);
  for (const char* observer : {"[1,2]", "[1,2,3,4]", "[1,2,\"3\"]", "4", "[1,2,1e300]"})
    EXPECT_NE(refusal(events(event(std::string("[") + observer + "]"))).find("an observer is not"), std::string::npos) << observer;
  EXPECT_NE(refusal(events(event("[[1,2,3]]", "\"now\""))).find("ts is not a time"), std::string::npos);
  EXPECT_NE(refusal(events(event("[[1,2,3]]") + "," + event("[[1,2,3]]"))).find("two frames begin at once"), std::string::npos);
  EXPECT_NE(refusal(events("")).find("formfieldWriteTrace"), std::string::npos);
  const auto missing = readRecordedPath(folder_.file("nothing"));
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kIo);
  writeWalk(2);
  const auto no_world = inspectTrace(folder_.file("no.ffm"), {.path = path()}, {});
  ASSERT_FALSE(no_world);
  EXPECT_EQ(no_world.error().code, ErrorCode::kIo);
  EXPECT_NE(no_world.error().line().find("no.ffm"), std::string::npos) << no_world.error().line();
}

}  // namespace
}  // namespace ff::tools
