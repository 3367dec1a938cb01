// ff_bench_open: what it takes to open a world and to fly through it, of the world at hand (a town) and of a simulated one of 1e9 patches
// whose index is as large as that of a real one. Bytes read to open are counted in the storage; memory is what the process gained, by
// the kernel's count of its pages. Prints JSON lines.
#include <malloc.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "formats/read/reader.h"
#include "runtime/api/formfield.h"
#include "tests/support/simulated_world.h"

namespace {

using namespace ff;
using Clock = std::chrono::steady_clock;

// Counts what is read through it.
class CountingStorage final : public formats::Storage {
 public:
  Result<std::unique_ptr<formats::StoredFile>> open(const std::string& path, const formats::ReadOptions& options) override {
    auto file = below_->open(path, options);
    if (!file) return file.error();
    return std::unique_ptr<formats::StoredFile>(std::make_unique<File>(std::move(*file), bytes));
  }
  Result<std::unique_ptr<formats::NewFile>> create(const std::string& path) override { return below_->create(path); }
  Result<void> rename(const std::string& from, const std::string& to) override { return below_->rename(from, to); }
  Result<void> remove(const std::string& path) override { return below_->remove(path); }
  Result<bool> syncFolder(const std::string& folder) override { return below_->syncFolder(folder); }
  Result<bool> exists(const std::string& path) override { return below_->exists(path); }
  Result<std::string> version(const std::string& path, const formats::ReadOptions& options) override { return below_->version(path, options); }
  Result<std::vector<std::string>> list(const std::string& folder) override { return below_->list(folder); }
  Result<std::unique_ptr<formats::Claim>> claim(const std::string& path) override { return below_->claim(path); }
  Result<void> checkWritable(const std::string& folder) override { return below_->checkWritable(folder); }

  std::atomic<uint64_t> bytes{0};

 private:
  class File final : public formats::StoredFile {
   public:
    File(std::unique_ptr<StoredFile> below, std::atomic<uint64_t>& read) : StoredFile(below->path()), below_(std::move(below)), read_(read) {}
    uint64_t bytes() const override { return below_->bytes(); }

   private:
    Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const formats::ReadOptions& options) const override {
      read_ += out.size();
      return below_->read(offset, out, options);
    }
    std::unique_ptr<StoredFile> below_;
    std::atomic<uint64_t>& read_;
  };
  formats::StoragePtr below_ = formats::posixStorage();
};

void print(const std::string& metric, double value, const char* unit, nlohmann::json limit, const std::string& note) {
  std::cout << nlohmann::json{{"metric", metric}, {"value", value}, {"unit", unit}, {"limit", std::move(limit)}, {"note", note}}.dump() << "\n";
}

double residentBytes() {
  malloc_trim(0);
  std::ifstream in("/proc/self/statm");
  uint64_t all = 0, resident = 0;
  in >> all >> resident;
  return static_cast<double>(resident) * static_cast<double>(::sysconf(_SC_PAGESIZE));
}

int failed(const std::string& line) {
  std::cerr << "ff_bench_open: " << line << "\n";
  return 1;
}

// Opens, then flies `seconds` of 60 frames a second along a circle about the middle of the world, at speed_m_s.
int measure(const std::string& path, const std::string& name, int frames, float speed_m_s) {
  const auto storage = std::make_shared<CountingStorage>();
  const double before = residentBytes();
  const auto began = Clock::now();
  auto world = formats::World::open(path, storage);
  const double ms = std::chrono::duration<double, std::milli>(Clock::now() - began).count();
  if (!world) return failed(world.error().line());
  const uint64_t patches = world->levels()[0].nodes;
  const std::string note = name + ", " + std::to_string(patches) + " patches, " + std::to_string(world->levels().size()) + " levels";
  print("open.bytes_read", static_cast<double>(storage->bytes.load()), "B", 256 << 10, note);
  print("open.resident_bytes", residentBytes() - before, "B", 1 << 20, note);
  print("open.ms", ms, "ms", nullptr, note);
  const Box bounds = world->info().bounds;

  FormfieldDevice device = nullptr;
  FormfieldWorld flown = nullptr;
  if (formfieldCreateCpuDevice(0, &device) != FORMFIELD_OK) return failed("no device");
  const double bare = residentBytes();
  if (formfieldOpenWorld(device, path.c_str(), nullptr, &flown) != FORMFIELD_OK) return failed(formfieldError(device));
  FormfieldSky sky{};
  sky.radiance[0] = sky.radiance[1] = sky.radiance[2] = 1;
  formfieldSetSky(flown, &sky);
  double most = 0;
  uint64_t changes = 0, tiles = 0;
  const double radius = 0.3 * static_cast<double>(bounds.hi.x - bounds.lo.x);
  for (int frame = 0; frame < frames; ++frame) {
    const double angle = static_cast<double>(frame) / 60 * static_cast<double>(speed_m_s) / radius;
    const double at[3] = {static_cast<double>(bounds.lo.x + bounds.hi.x) / 2 + radius * std::cos(angle), 2,
                          static_cast<double>(bounds.lo.z + bounds.hi.z) / 2 + radius * std::sin(angle)};
    const float velocity[3] = {static_cast<float>(-std::sin(angle)) * speed_m_s, 0, static_cast<float>(std::cos(angle)) * speed_m_s};
    if (formfieldFrame(flown, at, velocity) != FORMFIELD_OK) return failed(formfieldError(device));
    if (frame % 60 == 0) {
      if (formfieldSettle(flown, 0.01f, 4) != FORMFIELD_OK) return failed(formfieldError(device));
      most = std::max(most, residentBytes() - bare);
    }
    FormfieldStats stats{};
    stats.size = sizeof stats;
    formfieldGetStats(flown, &stats);
    changes += stats.cut_changed;
    tiles = stats.level0_leaves;
  }
  print("open.flying_resident_bytes", most, "B", 64 << 20,
        note + "; " + std::to_string(frames) + " frames at " + std::to_string(static_cast<int>(speed_m_s)) + " m/s through the C API, CPU, default settings, probes included; " +
            std::to_string(changes) + " changes of the cut, " + std::to_string(tiles) + " patches at full resolution at the end");
  formfieldCloseWorld(flown);
  formfieldDestroyDevice(device);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"What opening a world costs, and flying through it: of 1e9 simulated patches, and of a world of yours.", "ff_bench_open"};
  std::string world;
  bool quick = false;
  uint32_t levels = 10;
  app.add_option("--world", world, "a world, NAME.ffm, beside the simulated one");
  app.add_option("--levels", levels, "of the simulated world: each is four times as large")->check(CLI::Range(2, 10))->capture_default_str();
  app.add_flag("--quick", quick, "fewer frames");
  CLI11_PARSE(app, argc, argv);
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_open_" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  const std::string path = (folder / "simulated.ffm").string();
  if (auto written = formats::writeSimulatedWorld(path, levels); !written) return failed(written.error().line());
  int code = measure(path, "simulated", quick ? 120 : 1800, 30);
  if (code == 0 && !world.empty()) code = measure(world, std::filesystem::path(world).filename().string(), quick ? 120 : 600, 10);
  std::filesystem::remove_all(folder);
  return code;
}
