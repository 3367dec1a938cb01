// What was measured as one JSON document, for programs.
#pragma once
#include <string>
#include <vector>

#include "tools/chart/answer.h"
#include "tools/chart/report.h"

namespace ff::chart {

// One page of a run of ffchart.
struct JsonPage {
  std::string name;             // "accuracy", "stability", "paper": its key
  std::string file;             // the HTML
  Report report;
  std::vector<Answered> answers{};
};

// One object on one line: "version", "command" and each page by its name. Settings have the names and the full precision
// of the CSV; what is not measured, or not finite, is null. Charts hold the numbers of all points, tables the words of
// the page. No text breaks it: broken UTF-8 becomes U+FFFD.
std::string jsonDocument(const std::string& version, const std::string& command, const std::vector<JsonPage>& pages);

}  // namespace ff::chart
