// What ffchart has measured of one world, before it becomes a page, a table and an answer. Plain values: no file, no
// scene, no solver. Filled by sweep.h, stability.h and paper.h; written by page.h; searched by answer.h.
#pragma once
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace ff::chart {

inline constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();

// A figure with its standard error (0: exact; kNotMeasured: not known).
struct Figure {
  double value = kNotMeasured, error = 0;
};

// How far a setting's light is from the truth in one light situation, over all observers of the camera path: every patch
// within reach of an observer, each channel. Relative to the truth; 0.05 is 5 %.
struct Accuracy {
  std::string light{};                 // "sun and sky", "lamps", ...
  Figure rel_l2{};                     // against the path tracer, its own noise taken off
  Figure median{}, p95{}, p99{};       // of a patch's error over max(its truth, the mean truth)
  Figure energy{};                     // sum of A B over the truth's, minus 1: gained (+) or lost (-)
  Figure full_solve_rel_l2{};          // against the double-precision solve of the same rows: the run time's share
};

// A setting as `auto` reads it beside a world (runtime/choose_solver.h).
struct RunSettings {
  std::string solver{};                // "gather", "multibounce", "seed"; empty: nothing that `auto` can choose
  std::string storage = "fp32";        // or "fp16", of a dense matrix
  bool luminance = false;
  uint32_t places = 4096;              // of a dense matrix
  int iterations = 1;                  // a frame
  double radius_m = 0, growth = 0;     // of the cut; 0: the run time's own
  uint32_t max_patches = 0;            // active at once; 0: the run time's own
};

// One way to bake and run a world, and what it costs.
struct Setting {
  std::string name{};                  // short and unique: "gather, radius 12 m"
  std::string varies{};                // the knob that makes it differ from the default: "radius"; "": the default
  std::vector<std::pair<std::string, std::string>> knobs{};  // all of them, in one order: {"patch size", "1 m"}, ...
  bool is_default = false;
  bool bakes_anew = false;             // needs another bake than the default
  Figure relight_ms{};                 // a frame whose light changed: k steps of the solver; mean over places of the medians, and spreads
  Figure update_ms_per_tile{};         // a level-0 tile of 256 patches enters the cut
  double disk_bytes = kNotMeasured;    // of the rows of all levels
  double memory_bytes = kNotMeasured;  // of the local matrix and the strips it is made from
  double bake_seconds = kNotMeasured;
  double patches = kNotMeasured, active_nodes = kNotMeasured;
  std::vector<Accuracy> accuracy{};    // one a light situation, in the report's order
  bool on_front = false;               // no other setting is both faster and more accurate
  std::string note{};                  // one line, where a figure needs it
  std::string world{};                 // the path of its bake
  RunSettings run{};
};

// A line of a chart, or points.
struct Series {
  std::string name{};
  struct Point {
    double x = 0, y = 0, y_error = 0;
    std::string hover{};               // a few lines; empty: the numbers
    bool marked = false;               // on the front, the default, ...: drawn larger, with a ring
    double x_error = 0;
    std::string label{};               // a word or two beside the point
  };
  std::vector<Point> points{};
  bool lines = true;                   // false: points alone
  bool steps = false;                  // lines as stairs: to the next x first, then to its y
  bool dots = true;                    // false: the line alone, thin and grey: a front, a reference
};

struct Chart {
  std::string id{};                    // file name of its PNG and SVG: "speed-accuracy"
  std::string title{}, x_label{}, y_label{}, note{};  // note: what is seen and how it was made, a sentence or two
  bool log_x = false, log_y = false;
  std::vector<Series> series{};
  struct Mark { double at = 0; std::string text{}; };
  std::vector<Mark> y_marks{}, x_marks{};  // targets and limits: dashed lines with a word
};

struct Table {
  std::string id{}, title{}, note{};
  std::vector<std::string> columns{};
  std::vector<std::vector<std::string>> rows{};
};

// The end-to-end error in one light, source by source.
struct ErrorSources {
  struct Source {
    std::string source{};
    Figure error{};
    std::string measured_as{};         // "streamed against the full solve of the same rows"
  };
  std::string light{};
  size_t places = 0;                   // observers
  std::vector<Source> sources{};       // first all together
};

// The error of one method along a knob that is turned from easy to hard.
struct Measured {
  std::string scene, method;           // "closed box, albedo 0.98", "seed"
  std::string knob, unit;              // "swaps", ""; "patch size", "m"
  struct Point {
    double at = 0, error = 0;          // error: relative; infinity where a value is not finite
  };
  std::vector<Point> points;
  std::string then;                    // what the program does, with counts
};

// A PNG beside the page (taken into it as data when the page is written).
struct Illustration {
  std::string file{}, title{}, note{};
};

// How far the light is from the truth where eyes see it, in one light: each of many pixels compares the irradiance that its
// patch is given with the truth over the points of that patch that are seen, so that what a mean over the whole patch
// hides (half of it lies in the sun behind a wall) is found.
struct SeenScore {
  std::string light{};
  Accuracy streamed{};                 // the default's cut at each eye; energy: the bias
  Accuracy full_solve{};               // the full solve: what is left when the run time is exact
  double own_median = kNotMeasured;    // streamed: of a pixel's error over its own truth, however dark, the tracer's noise included
  double tracer_noise = kNotMeasured;  // relative L2, taken off; in the medians it is not
  double not_drawn = 0;                // share of the pixels whose surface has no patch, taken as unlit
  size_t eyes = 0, pixels = 0, patches = 0;
  std::string note{};                  // why there are no figures
};

// One page.
struct Report {
  std::string title, lead;             // lead: a paragraph, plain text: the answer first
  std::vector<std::pair<std::string, std::string>> facts;  // {"world", "town.ffm, 59,890 patches of 1 m"}, ...; the command last
  std::vector<Setting> settings;       // first the default
  std::vector<Chart> charts;
  std::vector<Table> tables;           // in words, whatever figures they come from
  std::vector<ErrorSources> sources;   // by light
  std::vector<SeenScore> seen;         // by light; empty: no eyes
  std::vector<Measured> cases;         // where methods break
  std::vector<Illustration> pictures;
};

}  // namespace ff::chart
