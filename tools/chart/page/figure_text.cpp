#include "tools/chart/page/figure_text.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string_view>

namespace ff::chart {
namespace {

constexpr const char* kReplacement = "\xEF\xBF\xBD";  // U+FFFD

// Bytes of the UTF-8 sequence at the front of `s`; 0 where it is none.
size_t sequenceLength(std::string_view s) {
  const auto at = [&](size_t i) { return static_cast<unsigned char>(s[i]); };
  const unsigned char first = at(0);
  if (first < 0x80) return 1;
  const size_t n = first >= 0xF0 && first <= 0xF4 ? 4 : first >= 0xE0 && first < 0xF0 ? 3 : first >= 0xC2 && first < 0xE0 ? 2 : 0;
  if (n == 0 || s.size() < n) return 0;
  for (size_t i = 1; i < n; ++i)
    if (at(i) < 0x80 || at(i) > 0xBF) return 0;
  if (first == 0xE0 && at(1) < 0xA0) return 0;                    // longer than need be
  if (first == 0xED && at(1) > 0x9F) return 0;                    // surrogates
  if (first == 0xEF && at(1) == 0xBF && at(2) >= 0xBE) return 0;  // no characters
  if (first == 0xF0 && at(1) < 0x90) return 0;
  if (first == 0xF4 && at(1) > 0x8F) return 0;                    // past U+10FFFF
  return n;
}

std::string grouped(const std::string& digits) {
  const size_t start = digits[0] == '-' ? 1 : 0;
  const size_t end = std::min(digits.find('.'), digits.size());
  std::string out;
  for (size_t i = 0; i < digits.size(); ++i) {
    if (i > start && i < end && (end - i) % 3 == 0) out += ',';
    out += digits[i];
  }
  return out;
}

std::string raised(int exponent) {
  static constexpr const char* kDigits[] = {"\u2070", "\u00b9", "\u00b2", "\u00b3", "\u2074",
                                            "\u2075", "\u2076", "\u2077", "\u2078", "\u2079"};
  std::string text = exponent < 0 ? "\u207b" : "";
  for (const char c : std::to_string(std::abs(exponent))) text += kDigits[c - '0'];
  return text;
}

// The power of ten of the first digit, once rounded to `digits` significant ones.
int firstPower(double value, int digits) {
  char text[64];
  const auto end = std::to_chars(text, text + sizeof text, value, std::chars_format::scientific, digits - 1).ptr;
  const std::string_view s(text, static_cast<size_t>(end - text));
  int power = 0;
  size_t e = s.find('e') + 1;
  if (s[e] == '+') ++e;
  std::from_chars(s.data() + e, end, power);
  return power;
}

std::string withoutTrailingZeros(std::string s) {
  if (s.find('.') == std::string::npos) return s;
  while (s.back() == '0') s.pop_back();
  if (s.back() == '.') s.pop_back();
  return s;
}

std::string powerOfTen(double value, int digits) {
  const int power = firstPower(value, digits);
  const std::string front = withoutTrailingZeros(fixedNumber(value / std::pow(10.0, power), digits - 1));
  if (front == "1") return "10" + raised(power);
  return front + "\u00d710" + raised(power);
}

double widthOf(char c) {
  const std::string_view narrow = "iljtfrI.,:;|!'()[] ", wide = "mwMW%@";
  if (narrow.find(c) != std::string_view::npos) return 0.36;
  if (wide.find(c) != std::string_view::npos) return 0.92;
  return c >= 'A' && c <= 'Z' ? 0.7 : 0.59;
}

}  // namespace

std::string escaped(const std::string& text) {
  std::string out;
  out.reserve(text.size());
  for (size_t i = 0; i < text.size();) {
    const size_t n = sequenceLength(std::string_view(text).substr(i));
    const char c = text[i];
    if (n == 0 || (n == 1 && static_cast<unsigned char>(c) < 0x20 && c != '\n' && c != '\t') || c == 0x7f)
      out += kReplacement;
    else if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else if (c == '"')
      out += "&quot;";
    else if (c == '\'')
      out += "&#39;";
    else
      out.append(text, i, n);
    i += std::max<size_t>(n, 1);
  }
  return out;
}

std::string fixedNumber(double value, int decimals) {
  char text[400];
  const auto end = std::to_chars(text, text + sizeof text, value, std::chars_format::fixed, decimals).ptr;
  std::string s(text, end);
  if (s[0] == '-' && s.find_first_not_of("-0.") == std::string::npos) s.erase(0, 1);
  return s;
}

std::string exactNumber(double value) {
  if (!std::isfinite(value)) return "";
  char text[64];
  return std::string(text, std::to_chars(text, text + sizeof text, value).ptr);
}

std::string shortNumber(double value) {
  if (!std::isfinite(value)) return kNotMeasuredText;
  if (value == 0) return "0";
  const double size = std::abs(value);
  if (size < 1e-4 || size >= 1e12) return powerOfTen(value, 3);
  if (size >= 1000 || size == std::floor(size)) return grouped(fixedNumber(value, 0));
  return grouped(fixedNumber(value, std::max(0, 2 - firstPower(value, 3))));
}

std::string axisNumber(double value, int digits) {
  if (!std::isfinite(value)) return kNotMeasuredText;
  if (value == 0) return "0";
  const double size = std::abs(value);
  if (size < 0.99e-4 || size >= 0.99e6) return powerOfTen(value, digits);
  return grouped(withoutTrailingZeros(fixedNumber(value, std::max(0, digits - 1 - firstPower(value, digits)))));
}

std::string axisPower(double value) {
  return value > 0.999 && value < 10.001 ? axisNumber(value) : powerOfTen(value, 6);
}

std::string withError(Figure f, double scale) {
  const double value = f.value * scale, error = f.error * std::abs(scale);
  if (!std::isfinite(value) || !std::isfinite(error) || error <= 0) return shortNumber(value);
  // Three digits of the value at least, so that a coarse error does not hide it.
  const int of_error = 1 - firstPower(error, 2), of_value = value == 0 ? 0 : 2 - firstPower(value, 3);
  const int decimals = std::clamp(std::min(of_error, std::max(of_value, of_error - 1)), 0, 9);
  std::string error_text = fixedNumber(error, decimals);
  if (error_text.find_first_not_of("0.") == std::string::npos) error_text = shortNumber(error);
  return grouped(fixedNumber(value, decimals)) + " \u00b1 " + grouped(error_text);
}

double widthInEms(const std::string& text) {
  double ems = 0;
  for (const char c : text)
    if ((static_cast<unsigned char>(c) & 0xC0) != 0x80)  // once a character
      ems += widthOf(c);
  return ems;
}

std::string shortened(const std::string& text, double ems) {
  if (widthInEms(text) <= ems) return text;
  std::string out;
  double used = 1;
  for (size_t i = 0; i < text.size();) {
    const size_t n = std::max<size_t>(1, sequenceLength(std::string_view(text).substr(i)));
    used += widthOf(text[i]);
    if (used > ems) break;
    out.append(text, i, n);
    i += n;
  }
  while (!out.empty() && out.back() == ' ') out.pop_back();
  return out + "\u2026";
}

std::string fileWord(const std::string& text) {
  std::string word;
  for (char c : text) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    const bool kept = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
    if (kept)
      word += c;
    else if (!word.empty() && word.back() != '-')
      word += '-';
  }
  while (!word.empty() && word.back() == '-') word.pop_back();
  return word.empty() ? "chart" : word;
}

}  // namespace ff::chart
