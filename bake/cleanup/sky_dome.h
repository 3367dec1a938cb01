// A dome or box of pictures of the sky around everything: of use to a renderer's camera, while here the sky is an input at run
// time, which it would block, and its size would take the patches from all the rest.
#pragma once
#include <vector>

#include "bake/scene.h"

namespace ff::bake {

// Of each triangle, whether it is of such a dome; empty: there is none. A dome is what is unlit and of one material, or named like a
// sky (its node, mesh or material), emits nothing, is
// larger than all the rest (twice as large where only its material tells), and fills two fifths or more of what is seen from there.
std::vector<bool> findSkyDome(const Scene& scene);

}  // namespace ff::bake
