// How far a bake is, on stderr.
#pragma once
#include <chrono>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace ff::tools {

using PhaseTimes = std::vector<std::pair<std::string, double>>;  // s, in their order

// Not thread-safe. What cannot be written is lost: a reader of stderr that is gone is no reason to end a bake.
class ProgressPrinter {
 public:
  // kBar: a bar with rate and time left on a terminal, one line a phase elsewhere. kJson: an object a line, at most one a second.
  enum class Style { kQuiet, kBar, kJson };
  explicit ProgressPrinter(Style style);
  ~ProgressPrinter() { endLine(); }
  ProgressPrinter(const ProgressPrinter&) = delete;
  ProgressPrinter& operator=(const ProgressPrinter&) = delete;

  void operator()(const char* phase, uint64_t done, uint64_t total);
  void endLine();
  // How long each phase took so far.
  const PhaseTimes& phases() const { return phases_; }

 private:
  using Clock = std::chrono::steady_clock;
  void printBar(uint64_t done, uint64_t total, double seconds);
  void printJson(uint64_t done, uint64_t total, double seconds);

  const Style style_;
  const bool terminal_;
  bool open_ = false, said_done_ = false;
  Clock::time_point began_, said_;
  PhaseTimes phases_;
};

}  // namespace ff::tools
