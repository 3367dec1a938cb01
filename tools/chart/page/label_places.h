// Finds room for words in a chart: where they cover neither points, lines nor each other.
#pragma once
#include <vector>

namespace ff::chart {

struct LabelBox {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

class LabelPlaces {
 public:
  // The plot; nothing is put outside.
  explicit LabelPlaces(LabelBox plot) : plot_(plot) {}
  void occupy(LabelBox box) { taken_.push_back(box); }
  // Along a line, a small box every few pixels.
  void occupyLine(double x0, double y0, double x1, double y1);
  // The candidate that covers least, the earlier one among equals; it is occupied from then on.
  LabelBox take(const std::vector<LabelBox>& candidates);

 private:
  double covered(const LabelBox& box) const;
  LabelBox plot_;
  std::vector<LabelBox> taken_;
};

}  // namespace ff::chart
