// From radiosity to PNG: exposure, tone curve, dither, heat map.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "formats/result.h"
#include "runtime/cut/local_matrix.h"

namespace ff::view {

struct Picture {
  uint32_t width = 0, height = 0;
  std::vector<uint8_t> rgb;  // 3 per pixel, sRGB, top row first
};

// log2 of the factor on radiosity that shows the surfaces (alpha > 0) well: their mean log luminance (the darkest and the
// brightest 5 % left out, so that no lamp and no black corner decides) comes out as middle grey, unless that would burn
// more than a tenth of them to white. 0 if no surface is seen or all are black.
float exposureStops(std::span<const runtime::Vec4> radiosity);

// A channel of radiosity times exposure as a picture shows it, 0 to 1: the tone curve, then sRGB.
float toneCurve(float x);

// samples: the radiosity is `samples` times as wide and as high as the picture; each sample goes through the tone curve
// before the mean, so that edges against bright lamps stay smooth.
Picture toneMapped(std::span<const runtime::Vec4> radiosity, uint32_t width, uint32_t height, uint32_t samples,
                   float exposure);

// Differences from 0 to `full_scale` as colours from dark to bright, the sky (-1) grey, with a legend.
Picture heatMap(std::span<const float> difference, uint32_t width, uint32_t height, uint32_t samples, float full_scale,
                const std::string& title);

Result<void> writePng(const Picture& picture, const std::string& path);

}  // namespace ff::view
