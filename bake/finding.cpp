#include "bake/finding.h"

#include <cstdio>

namespace ff::bake {

std::string textOf(const std::array<double, 3>& at) {
  std::string text;
  for (const double x : at) {
    char digits[400];
    std::snprintf(digits, sizeof digits, "%.3f", x);
    std::string number = digits;
    number.erase(number.find_last_not_of('0') + 1);
    if (number.ends_with('.')) number.pop_back();
    if (number == "-0") number = "0";
    text += (text.empty() ? "" : " ") + number;
  }
  return text;
}

std::string percent(double share) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2g %%", share * 100);
  return text;
}

std::string counted(uint64_t n, const char* thing) { return std::to_string(n) + " " + thing + (n == 1 ? "" : "s"); }

std::string lineOf(const Finding& f) {
  std::string line = f.what;
  if (!f.share_of.empty()) line += " (" + percent(f.share) + " of the " + f.share_of + ")";
  const bool several = f.places.size() + f.more_places > 1;
  for (size_t i = 0; i < f.places.size(); ++i) {
    const FoundPlace& place = f.places[i];
    line += i == 0 ? ": " : "; ";
    if (place.at) line += "at " + textOf(*place.at) + (place.name.empty() ? "" : ", ");
    line += place.name;
    if (several && place.share > 0) line += " (" + percent(place.share) + ")";
  }
  if (f.more_places > 0) line += "; and " + std::to_string(f.more_places) + " more";
  if (!f.remedy.empty()) line += "; " + f.remedy;
  return line;
}

}  // namespace ff::bake
