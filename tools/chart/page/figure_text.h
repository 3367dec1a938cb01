// Figures and words as people read them, on pages and in charts. The same on every machine: no locale is asked.
#pragma once
#include <string>

#include "tools/chart/report.h"

namespace ff::chart {

inline constexpr const char* kNotMeasuredText = "\u2014";  // an em dash

// As text or an attribute of HTML, SVG and XML: & < > " ' as entities; what XML 1.0 forbids (control characters, broken
// UTF-8) as U+FFFD.
std::string escaped(const std::string& text);

// Three significant digits, thousands by commas, whole numbers whole: 0.0123, 4.20, 59,890, 1.2 x 10^-6 with raised
// digits. Not measured: an em dash.
std::string shortNumber(double value);
// Of an axis: no digits but those needed: 0.05, 20, 10,000; below 0.0001 and from 1,000,000 on as powers of ten.
std::string axisNumber(double value, int digits = 6);
// The same where all numbers of an axis are powers of ten: 1, 10, 2 x 10^-5.
std::string axisPower(double value);
// A figure times `scale`: three significant digits, more where its error would not show: "2.41 +- 0.03", with the proper
// sign. Errors of 0 and unknown ones are not shown.
std::string withError(Figure figure, double scale = 1);
// `decimals` digits after the point.
std::string fixedNumber(double value, int decimals);
// The shortest that reads back as the same double. Not measured: "".
std::string exactNumber(double value);

// How wide text is drawn, about, in ems; on the safe side for the usual sans serif fonts.
double widthInEms(const std::string& text);
// At most about that wide; what does not fit becomes an ellipsis.
std::string shortened(const std::string& text, double ems);

// "Sun and sky" -> "sun-and-sky": a-z, 0-9, - and _ alone. Never empty.
std::string fileWord(const std::string& text);

}  // namespace ff::chart
