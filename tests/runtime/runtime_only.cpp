// Uses every door of the room and links ff_runtime alone: link_closure.cmake looks at what comes along.
#include <cstdio>

#include "formats/read/whole_world.h"
#include "runtime/cut/node_values.h"
#include "runtime/full_solve.h"
#include "runtime/updater.h"

int main(int argc, char** argv) {
  if (argc < 2) return 1;
  const auto world = ff::formats::WholeWorld::open(argv[1]);
  if (!world) return std::fprintf(stderr, "%s\n", world.error().line().c_str()), 2;
  auto streamer = ff::stream::Streamer::create(*world, {});
  if (!streamer) return 2;
  const auto solver = ff::runtime::makeCpuGather();
  ff::runtime::Updater updater(*world, **streamer, *solver);
  const auto frame = updater.frame({}, {}, 1);
  const auto areas = ff::runtime::patchAreas(*world);
  const auto full = ff::runtime::solveFullWorld(*world, std::vector<double>(size_t{3} * world->levels()[0].nodes, 1.0));
  return frame && areas && full ? 0 : 3;
}
