#include "tools/bake/progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdio>
#include <nlohmann/json.hpp>

namespace ff::tools {
namespace {

void write(const std::string& text) {
  (void)std::fwrite(text.data(), 1, text.size(), stderr);
  (void)std::fflush(stderr);
}

std::string rate(double per_second) {
  if (per_second >= 1e6) return fmt::format("{:.1f}M/s", per_second * 1e-6);
  return per_second >= 1e3 ? fmt::format("{:.1f}k/s", per_second * 1e-3) : fmt::format("{:.0f}/s", per_second);
}

std::string duration(double seconds) {
  if (seconds < 120) return fmt::format("{:.0f} s", seconds);
  return seconds < 7200 ? fmt::format("{:.0f} min", seconds / 60) : fmt::format("{:.1f} h", seconds / 3600);
}

double left(uint64_t done, uint64_t total, double seconds) {
  return done > 0 ? seconds * (static_cast<double>(total) / static_cast<double>(done) - 1) : 0;
}

}  // namespace

ProgressPrinter::ProgressPrinter(Style style) : style_(style), terminal_(isatty(STDERR_FILENO) == 1) {}

void ProgressPrinter::operator()(const char* phase, uint64_t done, uint64_t total) {
  const auto now = Clock::now();
  if (phases_.empty() || phases_.back().first != phase) {
    endLine();
    phases_.emplace_back(phase, 0);
    began_ = now;
    said_ = {};
    said_done_ = false;
  }
  const double seconds = phases_.back().second = std::chrono::duration<double>(now - began_).count();
  if (style_ == Style::kBar) printBar(done, total, seconds);
  if (style_ == Style::kJson) printJson(done, total, seconds);
}

void ProgressPrinter::printBar(uint64_t done, uint64_t total, double seconds) {
  const std::string& phase = phases_.back().first;
  if (terminal_) {
    const double share = total > 0 ? static_cast<double>(done) / static_cast<double>(total) : 0;
    std::string more;
    if (share > 0 && share < 1 && seconds > 0.5)
      more = rate(static_cast<double>(done) / seconds) + ", " + duration(left(done, total, seconds)) + " left";
    write(fmt::format("\r{:<9} [{:<30}] {:3.0f} %  {:<26}", phase, std::string(static_cast<size_t>(share * 30), '#'), share * 100, more));
    open_ = true;
  } else if (done == total && total > 0 && !said_done_) {
    said_done_ = true;
    write(fmt::format("{:<9} {:>10} done in {:.1f} s\n", phase, total, seconds));
  }
}

void ProgressPrinter::printJson(uint64_t done, uint64_t total, double seconds) {
  const auto now = Clock::now();
  const bool last = done == total && total > 0;
  if (said_done_ || (!last && now - said_ < std::chrono::seconds(1))) return;
  said_ = now;
  said_done_ = last;
  nlohmann::json line = {{"phase", phases_.back().first}, {"done", done}, {"total", total}, {"seconds", seconds}, {"seconds_left", nullptr}};
  if (done > 0) line["seconds_left"] = left(done, total, seconds);
  write(line.dump() + "\n");
}

void ProgressPrinter::endLine() {
  if (open_) write("\n");
  open_ = false;
}

}  // namespace ff::tools
