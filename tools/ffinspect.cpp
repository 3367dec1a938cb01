// ffinspect: looks into a world, checks it, and hands its parts to other programs.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <functional>

#include "formats/version.h"
#include "tools/inspect/inspect.h"

namespace {

using namespace ff;
using namespace ff::tools;

struct Arguments {
  std::string world;
  uint32_t level = 0, node = 0, other = 0, tile = 0;
  Vec3 point;
  int threads = 0;
  bool quiet = false;
  ExportRequest request;
  InspectOutput out;
};

using Command = std::function<Result<void>(const formats::World&)>;

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Looks into a Formfield world (.ffm), checks it, and exports its parts.\n"
               "Exit codes: 0 ok, 1 usage, 2 cannot read or write, 3 invalid file, 4 valid but violates physics.",
               "ffinspect"};
  app.set_version_flag("--version", FF_VERSION);
  app.require_subcommand(1);
  Arguments a;
  Command command;
  const auto add = [&](const char* name, const char* help, Command run) {
    CLI::App* sub = app.add_subcommand(name, help);
    sub->add_option("world", a.world, "manifest, NAME.ffm")->required();
    sub->add_flag("--json", a.out.json, "print one JSON document");
    sub->callback([&command, run = std::move(run)] { command = run; });
    return sub;
  };
  const auto addNode = [&](CLI::App* sub, const char* name, uint32_t& value, const char* help) {
    sub->add_option(name, value, help)->required();
  };
  add("info", "one screen about the world", [&](const auto& w) { return inspectInfo(w, a.out); });
  auto* verify = add("verify", "checksums, extents, order, closure, reciprocity, pyramid",
                     [&](const auto& w) { return inspectVerify(w, a.threads, a.quiet, a.out); });
  verify->add_option("--threads", a.threads, "0: all cores")->check(CLI::Range(0, 256));
  verify->add_flag("--quiet", a.quiet, "no progress");
  add("stats", "entries per row, bytes by part, closure by level", [&](const auto& w) { return inspectStats(w, a.out); });
  auto* row = add("row", "one node and its row of form factors",
                  [&](const auto& w) { return inspectRow(w, a.level, a.node, a.out); });
  addNode(row, "level", a.level, "0 = patches");
  addNode(row, "id", a.node, "number of the node within its level");
  auto* tile = add("tile", "one tile and its nodes", [&](const auto& w) { return inspectTile(w, {a.level, a.tile}, a.out); });
  addNode(tile, "level", a.level, "0 = patches");
  addNode(tile, "tile", a.tile, "number of the tile within its level");
  auto* pair = add("pair", "both form factors between two nodes",
                   [&](const auto& w) { return inspectPair(w, a.level, a.node, a.other, a.out); });
  addNode(pair, "level", a.level, "0 = patches");
  addNode(pair, "i", a.node, "number of a node");
  addNode(pair, "j", a.other, "number of another node of the same level");
  auto* locate = add("locate", "cell, tile and nearest patch of a point",
                     [&](const auto& w) { return inspectLocate(w, a.point, a.out); });
  locate->add_option("x", a.point.x, "m")->required();
  locate->add_option("y", a.point.y, "m")->required();
  locate->add_option("z", a.point.z, "m")->required();
  auto* exported = add("export", "rows to mtx or npy, patches to npy or ply, geometry to ply",
                       [&](const auto& w) { return inspectExport(w, a.request, a.out); });
  exported->add_option("--what", a.request.what)->required()->check(CLI::IsMember({"rows", "lamps", "patches", "geometry"}));
  exported->add_option("--level", a.request.level, "0 = patches")->capture_default_str();
  exported->add_option("--format", a.request.format)->required()->check(CLI::IsMember({"mtx", "npy", "ply"}));
  exported->add_option("-o,--output", a.request.path, "file to write")->required();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 1;
  }
  const auto fail = [](const Error& error) {
    std::fprintf(stderr, "ffinspect: %s\n", error.line().c_str());
    return static_cast<int>(error.code);
  };
  const auto world = formats::World::open(a.world);
  if (!world) return fail(world.error());
  if (const auto ok = command(*world); !ok) return fail(ok.error());
  return 0;
}
