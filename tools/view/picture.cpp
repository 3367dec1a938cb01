#include "tools/view/picture.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>

#define STB_IMAGE_WRITE_IMPLEMENTATION
#define STB_IMAGE_WRITE_STATIC
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-function"
#include <stb_image_write.h>
#pragma GCC diagnostic pop

#include "tools/view/font.h"

namespace ff::view {
namespace {

constexpr float kMiddleGrey = 0.18f, kNearWhite = 0.9f;

float luminance(float r, float g, float b) { return 0.2126f * r + 0.7152f * g + 0.0722f * b; }

// Narkowicz. ACES Filmic Tone Mapping Curve. 2015. 0.18 comes out near middle grey after the sRGB curve.
float filmic(float x) {
  x = std::max(x, 0.0f);
  return std::clamp(x * (2.51f * x + 0.03f) / (x * (2.43f * x + 0.59f) + 0.14f), 0.0f, 1.0f);
}

float srgb(float x) { return x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1 / 2.4f) - 0.055f; }

// The tone curve and sRGB together, tabulated over log2 of the input: a picture has millions of samples.
class ToneTable {
 public:
  ToneTable() {
    for (size_t i = 0; i < table_.size(); ++i)
      table_[i] = srgb(filmic(std::exp2(kLow + (kHigh - kLow) * static_cast<float>(i) / (kSteps - 1))));
  }
  float operator()(float x) const {
    if (!(x > 0)) return 0;
    const float at = std::clamp((std::log2(x) - kLow) / (kHigh - kLow), 0.0f, 1.0f) * (kSteps - 1);
    const auto i = std::min(static_cast<size_t>(at), table_.size() - 2);
    const float f = at - static_cast<float>(i);
    return table_[i] * (1 - f) + table_[i + 1] * f;
  }

 private:
  static constexpr float kLow = -16, kHigh = 8, kSteps = 4096;
  std::array<float, 4096> table_{};
};

// Interleaved gradient noise, 0..1. Jimenez. Next Generation Post Processing in Call of Duty: Advanced Warfare. 2014.
float ditherAt(uint32_t x, uint32_t y) {
  const float a = 0.06711056f * static_cast<float>(x) + 0.00583715f * static_cast<float>(y);
  const float b = 52.9829189f * (a - std::floor(a));
  return b - std::floor(b);
}

std::array<float, 3> heatColour(float t) {
  // Dark blue, violet, red, orange, pale yellow: rises steadily in lightness, so that it reads in grey, too.
  constexpr float kStops[6][3] = {{0.02f, 0.02f, 0.10f}, {0.22f, 0.06f, 0.40f}, {0.55f, 0.13f, 0.42f},
                                  {0.85f, 0.28f, 0.22f}, {0.98f, 0.62f, 0.12f}, {0.99f, 0.98f, 0.75f}};
  const float at = std::clamp(t, 0.0f, 1.0f) * 5;
  const auto i = std::min<size_t>(static_cast<size_t>(at), 4);
  const float f = at - static_cast<float>(i);
  std::array<float, 3> c{};
  for (size_t k = 0; k < 3; ++k) c[k] = kStops[i][k] * (1 - f) + kStops[i + 1][k] * f;
  return c;
}

uint8_t byteOf(float x) { return static_cast<uint8_t>(std::clamp(x * 255 + 0.5f, 0.0f, 255.0f)); }

void put(Picture& p, uint32_t x, uint32_t y, const std::array<float, 3>& c) {
  if (x >= p.width || y >= p.height) return;
  for (size_t k = 0; k < 3; ++k) p.rgb[(size_t{y} * p.width + x) * 3 + k] = byteOf(c[k]);
}

void write(Picture& p, uint32_t x, uint32_t y, const std::string& text, uint32_t scale) {
  for (const char ch : text) {
    const auto& glyph = glyphOf(ch);
    for (uint32_t row = 0; row < kGlyphHeight; ++row)
      for (uint32_t column = 0; column < kGlyphWidth; ++column)
        if (glyph[row] >> (kGlyphWidth - 1 - column) & 1)
          for (uint32_t s = 0; s < scale * scale; ++s)
            put(p, x + column * scale + s % scale, y + row * scale + s / scale, {1, 1, 1});
    x += (kGlyphWidth + 1) * scale;
  }
}

std::string percent(float x) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.3g %%", static_cast<double>(x * 100));
  return text;
}

}  // namespace

float exposureStops(std::span<const runtime::Vec4> radiosity) {
  std::vector<float> logs;
  logs.reserve(radiosity.size());
  for (const runtime::Vec4& b : radiosity) {
    const float l = luminance(b.x, b.y, b.z);
    if (b.w > 0 && l > 0) logs.push_back(std::log2(l));
  }
  if (logs.empty()) return 0;
  std::sort(logs.begin(), logs.end());
  const size_t cut = logs.size() / 20;
  double sum = 0;
  for (size_t i = cut; i < logs.size() - cut; ++i) sum += static_cast<double>(logs[i]);
  const auto mean = static_cast<float>(sum / static_cast<double>(logs.size() - 2 * cut));
  const float bright = logs[logs.size() - 1 - logs.size() / 10];
  return std::min(std::log2(kMiddleGrey) - mean, std::log2(kNearWhite) - bright);
}

float toneCurve(float x) { return srgb(filmic(x)); }

Picture toneMapped(std::span<const runtime::Vec4> radiosity, uint32_t width, uint32_t height, uint32_t samples,
                   float exposure) {
  static const ToneTable tone;
  Picture p{width, height, std::vector<uint8_t>(size_t{3} * width * height)};
  const size_t stride = size_t{width} * samples;
  const float share = 1 / static_cast<float>(samples * samples);
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x) {
      float sum[3] = {};
      for (uint32_t s = 0; s < samples * samples; ++s) {
        const runtime::Vec4& b = radiosity[(size_t{y} * samples + s / samples) * stride + size_t{x} * samples + s % samples];
        sum[0] += tone(exposure * b.x);
        sum[1] += tone(exposure * b.y);
        sum[2] += tone(exposure * b.z);
      }
      const float dither = (ditherAt(x, y) - 0.5f) / 255;
      for (size_t c = 0; c < 3; ++c) p.rgb[(size_t{y} * width + x) * 3 + c] = byteOf(sum[c] * share + dither);
    }
  return p;
}

Picture heatMap(std::span<const float> difference, uint32_t width, uint32_t height, uint32_t samples, float full_scale,
                const std::string& title) {
  Picture p{width, height, std::vector<uint8_t>(size_t{3} * width * height)};
  const size_t stride = size_t{width} * samples;
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x) {
      std::array<float, 3> sum{};
      for (uint32_t s = 0; s < samples * samples; ++s) {
        const float d = difference[(size_t{y} * samples + s / samples) * stride + size_t{x} * samples + s % samples];
        const std::array<float, 3> c = d < 0 ? std::array<float, 3>{0.35f, 0.37f, 0.40f} : heatColour(d / full_scale);
        for (size_t k = 0; k < 3; ++k) sum[k] += c[k] / static_cast<float>(samples * samples);
      }
      put(p, x, y, sum);
    }

  const uint32_t scale = std::max(1u, width / 640), bar = std::max(64u, width / 3), line = (kGlyphHeight + 3) * scale;
  const uint32_t left = 8 * scale, top = height - std::min(height, 3 * line + 6 * scale);
  for (uint32_t y = top; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x) put(p, x, y, {0.10f, 0.10f, 0.11f});
  write(p, left, top + 3 * scale, title, scale);
  for (uint32_t x = 0; x < bar; ++x)
    for (uint32_t y = 0; y < line - 2 * scale; ++y)
      put(p, left + x, top + line + 3 * scale + y, heatColour(static_cast<float>(x) / static_cast<float>(bar - 1)));
  for (int tick = 0; tick <= 4; ++tick) {
    const float t = static_cast<float>(tick) / 4;
    const std::string text = (tick == 4 ? ">=" : "") + percent(t * full_scale);
    write(p, left + static_cast<uint32_t>(t * static_cast<float>(bar)), top + 2 * line + 3 * scale, text, scale);
  }
  return p;
}

Result<void> writePng(const Picture& picture, const std::string& path) {
  const int w = static_cast<int>(picture.width), h = static_cast<int>(picture.height);
  if (!stbi_write_png(path.c_str(), w, h, 3, picture.rgb.data(), 3 * w))
    return Error{ErrorCode::kIo, path, "", std::string("cannot write the picture: ") + std::strerror(errno), ""};
  return {};
}

}  // namespace ff::view
