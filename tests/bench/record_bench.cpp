// ff_bench_record: what formfieldRecord takes of an engine's thread as a whole, in flight along a line, a metre or so a frame: all of the C interface, the writing of the
// command buffer included. The device has run all frames before when a call begins, so that a software device takes nothing of the thread. Prints JSON lines.
#include <vulkan/vulkan.h>

#include <CLI/CLI.hpp>

#include "runtime/api/formfield_vulkan.h"
#include "runtime/vulkan/context.h"
#include "runtime/vulkan/device.h"
#include "tests/bench/truth.h"

namespace {

using namespace ff;
using namespace ff::bench;

constexpr int kFirstFrames = 120;  // not counted: the cut of the start fades

void orExit(FormfieldResult result, FormfieldDevice device) {
  if (result == FORMFIELD_OK) return;
  std::cerr << "ff_bench_record: " << formfieldError(device) << "\n";
  std::exit(result);
}

struct Engine {
  Engine() : context(bench::orExit(runtime::openVulkan())) {
    FormfieldVulkanSettings s{};
    s.size = sizeof(s);
    s.instance = context->instance();
    s.physical_device = context->physicalDevice();
    s.device = context->device();
    s.queue_family = context->queueFamily();
    vkGetDeviceQueue(s.device, s.queue_family, 0, &s.queue);
    orExit(formfieldCreateVulkanDevice(&s, &device), nullptr);
  }
  Engine(const Engine&) = delete;
  Engine& operator=(const Engine&) = delete;
  ~Engine() { formfieldDestroyDevice(device); }

  std::shared_ptr<runtime::VkContext> context;
  FormfieldDevice device = nullptr;
};

// Frames of a 60th of a second along x through the middle of the world.
void fly(const std::string& path, int frames, float speed_m_s) {
  const Box bounds = bench::orExit(formats::World::open(path)).info().bounds;
  Engine engine;
  FormfieldWorld world = nullptr;
  orExit(formfieldOpenWorld(engine.device, path.c_str(), nullptr, &world), engine.device);
  const double step_m = static_cast<double>(speed_m_s) / 60, half_way_m = step_m * (frames + kFirstFrames) / 2;
  const float velocity[3] = {speed_m_s, 0, 0};
  std::vector<double> wall_ms, cpu_ms, read_ms;
  uint64_t changes = 0, uploaded = 0;
  FormfieldStats stats{};
  stats.size = sizeof(stats);
  for (int frame = 0; frame < frames + kFirstFrames; ++frame) {
    const double at[3] = {static_cast<double>(bounds.lo.x + bounds.hi.x) / 2 - half_way_m + step_m * frame, 1.6, static_cast<double>(bounds.lo.z + bounds.hi.z) / 2};
    const uint64_t uploaded_before = stats.uploaded_row_bytes + stats.uploaded_light_bytes;
    double thread_ms = 0, ms = 0;
    (void)bench::orExit(engine.context->run([&](VkCommandBuffer commands) {
      const auto began = Clock::now();
      const double cpu = threadMs();
      orExit(formfieldRecord(world, commands, at, velocity), engine.device);
      thread_ms = threadMs() - cpu;
      ms = msSince(began);
    }));
    orExit(formfieldGetStats(world, &stats), engine.device);
    if (frame < kFirstFrames) continue;
    wall_ms.push_back(ms);
    cpu_ms.push_back(thread_ms);
    changes += stats.cut_changed;
    uploaded += stats.uploaded_row_bytes + stats.uploaded_light_bytes - uploaded_before;
    if (frame % 10 != 0) continue;
    const auto reads = Clock::now();
    uint32_t slots = 0;
    if (!formfieldRadiosity(world, &slots)) orExit(FORMFIELD_ERROR_USAGE, engine.device);
    read_ms.push_back(msSince(reads));
  }
  const std::string note = deviceName(*engine.context) + "; " + std::to_string(frames) + " frames at " + std::to_string(static_cast<int>(speed_m_s)) + " m/s, " + std::to_string(changes) + " changes of the cut, " +
                           std::to_string(stats.slots) + " slots; formfieldRecord as a whole";
  const auto printed = [&](const char* metric, double share, const std::string& what) {
    print(metric, quantile(wall_ms, share), "ms", NAN, note + what + "; of the thread's own time " + std::to_string(quantile(cpu_ms, share)), "vulkan");
  };
  printed("record.frame_p50_ms", 0.5, "");
  printed("record.frame_p99_ms", 0.99, "; target 0.2");
  printed("record.frame_max_ms", 1, "; target 1");
  print("record.uploaded_bytes", static_cast<double>(uploaded) / frames, "B", NAN, note + ", to the device in a frame, mean", "vulkan");
  print("record.read_ms", median(read_ms), "ms", NAN, note + " not; formfieldRadiosity in every tenth frame, median", "vulkan");
  formfieldCloseWorld(world);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"What formfieldRecord takes of an engine's thread, in flight.", "ff_bench_record"};
  std::string world;
  bool quick = false;
  int frames = 600;
  float speed = 60;
  app.add_option("--world", world, "NAME.ffm; by default a town of 60,000 patches, baked now");
  app.add_option("--frames", frames, "counted, after 120 that are not")->check(CLI::Range(10, 100000))->capture_default_str();
  app.add_option("--speed", speed, "m/s")->check(CLI::Range(0.1f, 200.0f))->capture_default_str();
  app.add_flag("--quick", quick, "a small town, 60 frames");
  CLI11_PARSE(app, argc, argv);
  const auto folder = std::filesystem::temp_directory_path() / ("ff_bench_record_" + std::to_string(getpid()));
  if (world.empty()) {
    std::filesystem::create_directories(folder);
    world = bakeTown(folder, quick);
  }
  fly(world, quick ? 60 : frames, speed);
  std::filesystem::remove_all(folder);
  return 0;
}
