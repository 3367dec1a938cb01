// ffinspect: looks into a world, checks it, and hands its parts to other programs.
#include <CLI/CLI.hpp>
#include <array>
#include <charconv>
#include <cstdio>
#include <functional>

#include "formats/read/whole_world.h"
#include "formats/version.h"
#include "tools/inspect/inspect.h"
#include "tools/run_tool.h"

namespace {

using namespace ff;
using namespace ff::tools;

// "3,-1,0"
bool parseChunk(const std::string& text, formats::ChunkCell& cell) {
  const char* at = text.c_str();
  for (size_t a = 0; a < 3; ++a) {
    const auto [end, fault] = std::from_chars(at, text.c_str() + text.size(), cell[a]);
    if (fault != std::errc() || *end != (a < 2 ? ',' : '\0')) return false;
    at = end + 1;
  }
  return true;
}

struct Arguments {
  std::string world;
  NodeName node, other;
  std::array<double, 3> point{};
  int threads = 0;
  bool quiet = false;
  ExportRequest request;
  TraceRequest trace;
  InspectOutput out;
};

// Of what reads the whole index, and of what reads only what it looks at.
using WholeCommand = std::function<Result<void>(const formats::WholeWorld&)>;
using Command = std::function<Result<void>(const formats::World&)>;

int run(int argc, char** argv) {
  CLI::App app{"Looks into a Formfield world (.ffm), checks it, and exports its parts.\n"
               "Exit codes: 0 ok, 1 usage, 2 cannot read or write, 3 invalid file, 4 valid but violates physics.",
               "ffinspect"};
  app.set_version_flag("--version", FF_VERSION);
  app.require_subcommand(1);
  Arguments a;
  std::function<Result<void>()> command;
  const auto addCommand = [&](const char* name, const char* help, std::function<Result<void>()> run) {
    CLI::App* sub = app.add_subcommand(name, help);
    sub->add_option("world", a.world, "manifest, NAME.ffm, or its address behind a web server, https://.../NAME.ffm")->required();
    sub->add_flag("--json", a.out.json, "print one JSON document");
    sub->callback([&command, run = std::move(run)] { command = run; });
    return sub;
  };
  const auto opening = [&]<class World, class Run>(Run run) {
    return [&a, run = std::move(run)]() -> Result<void> {
      const auto world = World::open(a.world);
      return world ? run(*world) : Result<void>(world.error());
    };
  };
  const auto add = [&](const char* name, const char* help, Command run) {
    return addCommand(name, help, opening.template operator()<formats::World>(std::move(run)));
  };
  const auto addWhole = [&](const char* name, const char* help, WholeCommand run) {
    return addCommand(name, help, opening.template operator()<formats::WholeWorld>(std::move(run)));
  };
  const auto addTile = [&](CLI::App* sub, NodeName& node, const std::string& of) {
    sub->add_option_function<std::string>(
           "chunk" + of, [&node](const std::string& text) {
             if (!parseChunk(text, node.tile.chunk)) throw CLI::ValidationError("chunk", "\"" + text + "\" is not three numbers, as in 3,-1,0");
           }, "of the tile: X,Y,Z, as locate prints it")->required();
    sub->add_option("tile" + of, node.tile.tile, "its number within the chunk")->required();
  };
  const auto addNode = [&](CLI::App* sub, NodeName& node, const std::string& of) {
    addTile(sub, node, of);
    sub->add_option("index" + of, node.index, "of the node within the tile")->required();
  };
  add("info", "one screen about the world", [&](const auto& w) { return inspectInfo(w, a.out); });
  auto* verify = addWhole("verify", "checksums, extents, order, closure, reciprocity, pyramid",
                          [&](const auto& w) { return inspectVerify(w, a.threads, a.quiet, a.out); });
  verify->add_option("--threads", a.threads, "0: all cores")->check(CLI::Range(0, 256));
  verify->add_flag("--quiet", a.quiet, "no progress");
  addWhole("stats", "entries per row, bytes by part, closure by level", [&](const auto& w) { return inspectStats(w, a.out); });
  auto* row = add("row", "one node and its row of form factors", [&](const auto& w) { return inspectRow(w, a.node, a.out); });
  row->add_option("level", a.node.level, "0 = patches")->required();
  addNode(row, a.node, "");
  auto* tile = add("tile", "one tile and its nodes", [&](const auto& w) { return inspectTile(w, a.node.level, a.node.tile, a.out); });
  tile->add_option("level", a.node.level, "0 = patches")->required();
  addTile(tile, a.node, "");
  auto* pair = add("pair", "both form factors between two nodes", [&](const auto& w) {
    a.other.level = a.node.level;
    return inspectPair(w, a.node, a.other, a.out);
  });
  pair->add_option("level", a.node.level, "of both; 0 = patches")->required();
  addNode(pair, a.node, "_i");
  addNode(pair, a.other, "_j");
  auto* locate = add("locate", "the nearest patch of a point, and its name", [&](const auto& w) { return inspectLocate(w, a.point, a.out); });
  locate->add_option("x", a.point[0], "m")->required();
  locate->add_option("y", a.point[1], "m")->required();
  locate->add_option("z", a.point[2], "m")->required();
  auto* exported = addWhole("export", "rows to mtx or npy, patches to npy or ply, geometry to ply",
                            [&](const auto& w) { return inspectExport(w, a.request, a.out); });
  exported->add_option("--what", a.request.what)->required()->check(CLI::IsMember({"rows", "lamps", "patches", "geometry"}));
  exported->add_option("--level", a.request.level, "0 = patches")->capture_default_str();
  exported->add_option("--format", a.request.format)->required()->check(CLI::IsMember({"mtx", "npy", "ply"}));
  exported->add_option("-o,--output", a.request.path, "file to write")->required();
  auto* trace = addCommand("trace", "flies a recorded path again: what frames take, what is late, and where", [&] { return inspectTrace(a.world, a.trace, a.out); });
  trace->add_option("path", a.trace.path, "what formfieldWriteTrace has written")->required();
  trace->add_option("-o,--output", a.trace.trace_path, "a trace of this run, for chrome://tracing and ui.perfetto.dev");
  trace->add_option("--threads", a.trace.threads, "of the solver; 0: all cores")->check(CLI::Range(0, 256));
  trace->add_option("--radius", a.trace.radius_m, "within it light is computed patch by patch, m")->check(CLI::PositiveNumber);
  trace->add_option("--memory", a.trace.memory_bytes, "of strips")->transform(CLI::AsSizeValue(true));
  trace->add_option("--bytes", a.trace.bytes_per_second, "read a second at most")->transform(CLI::AsSizeValue(true));
  trace->add_option("--tiles", a.trace.max_applied_tiles, "that enter a frame's light at most");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 1;
  }
  const auto ok = command();
  if (const std::string warning = formats::storageFor(a.world)->warning(); !warning.empty()) std::fprintf(stderr, "ffinspect: %s\n", warning.c_str());
  if (!ok) {
    std::fprintf(stderr, "ffinspect: %s\n", ok.error().line().c_str());
    return static_cast<int>(ok.error().code);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) { return ff::tools::runTool("ffinspect", argc, argv, run); }
