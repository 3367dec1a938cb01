// An observer's surroundings in a world as each kind of solver sees them: the cut through the pyramid, and the active
// patches alone with one constant for all that is far, which is what the dense methods of the paper work on.
#pragma once
#include <memory>
#include <span>
#include <vector>

#include "formats/read/whole_world.h"
#include "runtime/cut/matrix_assembler.h"
#include "tools/chart/walks.h"
#include "tools/chart/world_truth.h"

namespace ff::chart {

struct Neighbourhood {
  Case at;
  std::unique_ptr<stream::Streamer> streamer;
  std::unique_ptr<runtime::MatrixAssembler> pyramid;
  std::vector<runtime::Vec4> source;  // by slot of the pyramid

  uint32_t activePatches() const;
  size_t leaves() const { return pyramid->matrix().leaves.size(); }
};

// All that is wanted there has been read. The world and the truth must outlive it.
Result<Neighbourhood> neighbourhoodAt(const formats::WholeWorld& world, const WorldTruth& truth, Vec3 observer,
                                      const stream::StreamSettings& settings);

// The solver with a matrix, its light (by slot), and radiosity that starts from the light; the matrix must outlive it.
Result<void> lightUp(const runtime::LocalMatrix& matrix, std::span<const runtime::Vec4> source, runtime::Solver& solver);
Result<void> lightUp(const Neighbourhood& there, runtime::Solver& solver);  // with those of a neighbourhood

// The active patches of a neighbourhood. Beyond them the truth's mean radiosity, the constant's best value.
struct LocalPatches {
  runtime::LocalMatrix matrix;  // FarLight::kConstant
  walks::SceneRows set;
  std::vector<uint32_t> slots;             // of the patches, in order
  std::vector<runtime::Vec4> source;       // by patch: M and what the constant adds
  std::vector<runtime::Vec4> slot_source;  // by slot: M alone
  uint32_t patches() const { return static_cast<uint32_t>(slots.size()); }
};

Result<LocalPatches> localPatches(const formats::WholeWorld& world, const WorldTruth& truth, const Neighbourhood& there);

// Patches 0 .. patches - 1 enter in blocks.
Result<void> fillMatrix(runtime::BounceMatrix& matrix, walks::Placement& placement, uint32_t patches, uint32_t block);

// Radiosity by slot of local.matrix from one product (bounces included) with a matrix that holds all patches.
Result<std::vector<runtime::Vec4>> relitRadiosity(const LocalPatches& local, const walks::Placement& placement,
                                                  runtime::BounceMatrix& matrix);

// Bytes that one step of gather must read: entries with their padding, and what it keeps by row.
double gatherBytes(const runtime::LocalMatrix& matrix);

}  // namespace ff::chart
