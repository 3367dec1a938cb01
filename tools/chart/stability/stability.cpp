#include "tools/chart/stability/stability.h"

#include <iterator>
#include <utility>

#include "tools/chart/stability/parts.h"

namespace ff::chart {

Result<Report> measureStability(const StabilityOptions& options, const StabilityProgress& progress) {
  Report report;
  report.title = "Where it breaks";
  using Experiment = Result<StabilityPart> (*)(const StabilityOptions&, const StabilityProgress&);
  for (const Experiment experiment :
       {Experiment{stabilityOfWalks}, Experiment{stabilityOfAlbedo}, Experiment{stabilityOfEnergy},
        Experiment{stabilityOfRays}, Experiment{stabilityOfLeaks}, Experiment{stabilityOfRadius}}) {
    auto part = experiment(options, progress);
    if (!part) return part.error();
    report.lead += (report.lead.empty() || part->lead.empty() ? "" : " ") + part->lead;
    std::move(part->charts.begin(), part->charts.end(), std::back_inserter(report.charts));
    std::move(part->measured.begin(), part->measured.end(), std::back_inserter(report.cases));
  }
  report.tables.push_back(breakingTable(report.cases));
  report.facts = {
      {"run", options.quick ? "quick: fewer swaps, smaller scenes" : "full"},
      {"seed", numberText(static_cast<double>(options.seed))},
      {"methods",
       "seed: the paper's update as printed, RGBA16F. multibounce: exact block updates of the dense matrix. dense "
       "solver: multibounce as frames use it, with corrections by the sparse rows, probe and rebuilding. gather: "
       "Jacobi iterations on the sparse rows."}};
  return report;
}

}  // namespace ff::chart
