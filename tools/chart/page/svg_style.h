// How charts look: colours that the colour-blind tell apart, shapes that tell series apart without colour.
#pragma once
#include <array>
#include <string>

namespace ff::chart {

// Okabe, Ito. Color Universal Design: How to make figures and presentations that are friendly to colorblind people. 2008.
// Without their yellow, which does not show on white. The last is for dark pages, where black would not show.
inline constexpr std::array<const char*, 7> kSeriesColours = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                              "#e69f00", "#56b4e9", "#000000"};
inline constexpr std::array<const char*, 7> kSeriesColoursOnDark = {"#4aa3df", "#ef7f35", "#2fc39a", "#dd9cc0",
                                                                    "#f0b429", "#8fd0f5", "#e8e8e8"};

// Paths around (0, 0), all of about the same area: circle, square, triangle, diamond, triangle downwards, pentagon,
// cross.
inline constexpr std::array<const char*, 7> kShapes = {
    "M-4.4 0A4.4 4.4 0 1 1 4.4 0A4.4 4.4 0 1 1-4.4 0Z", "M-3.9-3.9H3.9V3.9H-3.9Z",
    "M0-5.6L5.2 3.6H-5.2Z",                            "M0-5.7L5.2 0L0 5.7L-5.2 0Z",
    "M0 5.6L5.2-3.6H-5.2Z",                            "M0-5.2L4.9-1.6L3.1 4.2H-3.1L-4.9-1.6Z",
    "M-1.9-5.2H1.9V-1.9H5.2V1.9H1.9V5.2H-1.9V1.9H-5.2V-1.9H-1.9Z"};

// The style sheet of a chart; the same for all, so that charts may stand side by side in one page.
std::string chartStyle();

}  // namespace ff::chart
