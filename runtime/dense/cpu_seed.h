// The baselines that multibounce is charted against, behind the same interface. Never the default.
//
// `seed`: Shcherbakov, A., Frolov, V. "Implementation of the Radiosity Algorithm for Large Scale Scenes." GraphiCon
// 2019: one RGBA16F matrix, a patch at a time, the six update shaders in their order, removal by zeroing row and
// column. With f the form factors of the new patch, rho its colour, C the colours of those there, F_local the stored
// matrix:
//   (1) double = f_row C f_col            (2) g_col = f_col rho double, g_row = f_row rho double
//   (3) g'_col = F_local C (f_col + g_col), g'_row = (f_row + g_row) C F_local
//   (4) col = g'_col + g_col + f_col, row likewise
//   (5) F_local += col rho row            (6) col, row and (on the diagonal) double are written to the matrix
// Where the print is incomplete this is its most accurate reading: equation (3) prints neither C nor f, without which
// no path would reach the new patch over two others; equation (5) prints no rho. Still left out, as in the print: paths
// that return to the new patch more than once, and the removal of paths through a patch that leaves.
// Each step is a dense pass at memory bandwidth, as on the GPU; the zeros of f are not skipped.
#pragma once
#include <memory>

#include "runtime/dense/bounce_matrix.h"

namespace ff::runtime {

// Storage, luminance and time slicing of the settings are not for it. Errors (kUsage): as makeCpuMultibounce.
Result<std::unique_ptr<BounceMatrix>> makeCpuSeed(const MultibounceSettings& settings);

inline constexpr int kPlainBounces = 3;  // "at least 3 multiplications" (the paper's section 3)

// Plain local radiosity, what the paper compares itself with: the form factors alone in one dense matrix, so many
// products with it a relight.
Result<std::unique_ptr<BounceMatrix>> makeCpuPlainLocal(const MultibounceSettings& settings,
                                                        int bounces = kPlainBounces);

}  // namespace ff::runtime
