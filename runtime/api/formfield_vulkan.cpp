#include "runtime/api/formfield_vulkan.h"

#include <algorithm>
#include <cstring>

#include "runtime/api/formfield_handles.h"
#include "runtime/dense/vk_seed.h"
#include "runtime/gather/shown_light.h"
#include "runtime/solver/fallback_solver.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"

namespace {

using namespace ff;
using namespace ff::runtime;

// One world's frames in the caller's command buffers, and their light on its way back: it is looked at where somebody asks.
class VulkanRecording final : public Recording {
 public:
  // room: slots that the recorder has room for; max_slots: of any cut, of a larger re-bake too, which the recorder refuses.
  static Result<std::unique_ptr<VulkanRecording>> create(VkContext& context, VulkanRecorder& recorder, uint32_t frames, uint32_t room, uint32_t max_slots) {
    auto buffer = Buffer::create(context, (uint64_t{frames} + 1) * room * sizeof(Vec4), VK_BUFFER_USAGE_TRANSFER_DST_BIT,
                                 MemoryUse::kHost);
    if (!buffer) return buffer.error();
    return std::unique_ptr<VulkanRecording>(new VulkanRecording(recorder, std::move(*buffer), frames, room, max_slots));
  }

  Result<void> frame(FormfieldWorld_T& world, VkCommandBuffer commands, const stream::Observers& observers) {
    commands_ = commands;
    world_ = &world;
    world.recording = true;
    auto stepped = world.step(observers);
    world.recording = false;
    if (!stepped) return stepped;
    if (world.solver.fellBack()) {
      lastSeen(reflected_);
      arrived_ = {};
      enter(world);
      if (auto set = world.solver.solver->setRadiosity(reflected_); !set) return set;
      if (auto read = world.readRadiosity(); !read) return read;
      world.logFrame(world.frame_stats.steps_ms);
      return {};
    }
    arrived_ = regions_[(records_ + 1) % regions_.size()];  // of the record frames_in_flight ago, which is done
    if (arrived_.record < anew_) arrived_ = {};
    enter(world);
    recordReadBack(world.updater().matrix().slots());
    world.unseen = FormfieldWorld_T::Unseen::kRecorded;
    world.residual_unseen = false;
    world.residual = recorder_.residual();
    ++records_;
    world.logFrame(0);  // the steps run on the device
    return {};
  }

  Result<void> record(int iterations) override {
    if (auto told = shown_.tell(recorder_, world_->updater()); !told) return told;
    return recorder_.record(commands_, iterations);
  }
  void lastSeen(std::span<Vec4> reflected) const override {
    for (uint32_t slot = 0; slot < std::min(reflected_.size(), reflected.size()); ++slot) reflected[slot] = lastSeenOf(slot);
  }
  void goOnFrom(std::span<const Vec4> reflected) override {
    reflected_.assign(reflected.begin(), reflected.end());
    anew_ = records_;
    arrived_ = {};
  }
  const VulkanRecorder& recorder() const { return recorder_; }

 private:
  struct Region {
    uint64_t record = 0;
    uint32_t slots = 0;  // 0: nothing was recorded there
  };
  VulkanRecording(VulkanRecorder& recorder, Buffer buffer, uint32_t frames, uint32_t room, uint32_t max_slots)
      : recorder_(recorder), buffer_(std::move(buffer)), room_(room), regions_(frames + 1), entered_(max_slots) {
    reflected_.reserve(max_slots);
  }

  std::byte* at(uint64_t record) const { return buffer_.mapped() + offset(record); }
  uint64_t offset(uint64_t record) const { return record % regions_.size() * room_ * sizeof(Vec4); }
  Vec4 lastSeenOf(uint32_t slot) const {
    if (slot >= arrived_.slots || entered_[slot] > arrived_.record) return reflected_[slot];
    Vec4 b;
    std::memcpy(&b, at(arrived_.record) + slot * sizeof(Vec4), sizeof(b));
    return b;
  }

  // Tiles that enter start from their parents, as on the device.
  void enter(const FormfieldWorld_T& world) {
    const LocalMatrix& matrix = world.updater().matrix();
    reflected_.resize(matrix.slots());
    if (!world.frame_stats.matrix_changed) return;
    const bool eased = world.updater().fade().frames() > 0;
    for (const uint32_t t : world.updater().change().entered) {  // parents first
      const SlotRange& range = matrix.tiles[t];
      for (uint32_t slot = range.first_slot; slot < range.first_slot + range.nodes; ++slot) {
        entered_[slot] = records_;
        if (anew_ == records_) continue;  // it is as it was carried over
        const uint32_t parent = matrix.parent_slot[slot];
        const Vec4 b = parent != kNoSlot ? lastSeenOf(parent) : Vec4{};
        reflected_[slot] = parent != kNoSlot && eased ? onAlbedo(b, matrix.albedo[parent], matrix.albedo[slot], b) : b;
      }
    }
  }

  void recordReadBack(uint32_t slots) {
    const VkBufferCopy copy{0, offset(records_), slots * sizeof(Vec4)};
    vkCmdCopyBuffer(commands_, recorder_.reflectedBuffer(), buffer_.handle(), 1, &copy);
    auto done = zeroed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
    done.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    done.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
    vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &done, 0, nullptr, 0,
                         nullptr);
    regions_[records_ % regions_.size()] = {records_, slots};
  }

  VulkanRecorder& recorder_;
  Buffer buffer_;
  const uint64_t room_;  // slots of a region: what the recorder has room for
  std::vector<Region> regions_;  // by record: those in flight, and the last that has come back
  Region arrived_;               // that one; of records from before slots were given out anew there is none
  std::vector<Vec4> reflected_;    // by slot, where it entered after that: as its parent was then, or as it was carried over
  std::vector<uint64_t> entered_;  // by slot: the record in which it entered
  ShownLight shown_;
  uint64_t records_ = 0;
  uint64_t anew_ = 0;                    // the first record with the slots of now
  VkCommandBuffer commands_ = VK_NULL_HANDLE;
  const FormfieldWorld_T* world_ = nullptr;
};

// Null where the world's solver cannot record.
VulkanRecording* recordingOf(FormfieldWorld world) {
  return world && !world->solver.fellBack() ? dynamic_cast<VulkanRecording*>(world->solver.recording.get()) : nullptr;
}

struct VulkanDevice final : FormfieldDevice_T {
  Result<WorldSolver> makeSolver(const formats::World& world, const SolverChoice& choice, uint32_t max_slots) override {
    MultibounceSettings dense;
    dense.places = choice.places;
    dense.storage = choice.storage;
    dense.luminance = choice.luminance;
    if (records(choice.kind)) {
      VulkanGatherSettings room = gatherRoomFor(world, max_slots);
      room.frames_in_flight = frames_in_flight;
      auto recorder = choice.kind == SolverKind::kGather ? makeVulkanRecorder(context, room)
                                                         : makeVulkanDenseRecorder(context, room, dense);
      if (!recorder) return withoutDevice(recorder.error());
      auto recording = VulkanRecording::create(*context, **recorder, frames_in_flight, room.slots, max_slots);
      if (!recording) return withoutDevice(recording.error());
      const DenseStats* const known = (*recorder)->dense();
      auto solver = withFallback(std::move(*recorder), known);
      solver.recording = std::move(*recording);
      return solver;
    }
    auto matrix = makeVulkanSeed(context, dense);
    if (!matrix) return withoutDevice(matrix.error());
    auto solver = makeDenseSolver(std::move(*matrix), {.correct = false});
    const DenseStats* const known = &solver->stats();
    return withFallback(std::move(solver), known);
  }
  bool records(SolverKind kind) const override { return kind != SolverKind::kSeed; }
  uint64_t submissions() const override { return context->submissions(); }
  // A device that is lost or full from the start is no worse than one that gets there.
  static Result<WorldSolver> withoutDevice(const Error& error) {
    if (error.cause == ErrorCause::kOther) return error;
    auto reason = std::make_unique<std::string>(error.line());
    const std::string* const known = reason.get();
    return WorldSolver{makeCpuGather(), known, nullptr, nullptr, std::move(reason)};
  }
  static WorldSolver withFallback(std::unique_ptr<Solver> first, const DenseStats* dense) {
    auto solver = makeFallbackSolver(std::move(first), makeCpuGather());
    const std::string* const reason = &solver->reason();
    return {std::move(solver), reason, dense, nullptr, nullptr};
  }
  std::shared_ptr<VkContext> context;
  uint32_t frames_in_flight = 2;
  std::string last_message;
};

Result<std::shared_ptr<VkContext>> contextOf(const FormfieldVulkanSettings& s) {
  const int given = (s.instance != VK_NULL_HANDLE) + (s.physical_device != VK_NULL_HANDLE) +
                    (s.device != VK_NULL_HANDLE) + (s.queue != VK_NULL_HANDLE);
  if (given == 4)
    return VkContext::adopt(s.instance, s.physical_device, s.device, s.queue_family, s.queue, s.memory_bytes);
  if (given != 0)
    return usageError("device", "instance, physical_device, device and queue go together", "give all four, or none");
  VulkanChoice choice;
  if (s.device_name) choice.device = s.device_name;
  choice.validate = s.validate != 0;
  choice.memory_bytes = s.memory_bytes;
  return openVulkan(choice);
}

}  // namespace

extern "C" {

FormfieldResult formfieldCreateVulkanDevice(const FormfieldVulkanSettings* settings, FormfieldDevice* device) {
  return guarded(errorOfThisThread(), [&]() -> Result<void> {
    if (!device) return usageError("device", "is NULL");
    *device = nullptr;
    FormfieldVulkanSettings s{};
    if (auto taken = takeSettings(settings, s); !taken) return taken;
    if (s.frames_in_flight > 16) return usageError("frames_in_flight", "are more than 16", "2 or 3 are usual");
    auto context = contextOf(s);
    if (!context) return context.error();
    auto made = std::make_unique<VulkanDevice>();
    made->context = std::move(*context);
    if (s.frames_in_flight > 0) made->frames_in_flight = s.frames_in_flight;
    made->name = "vulkan: " + deviceName(*made->context);
    *device = made.release();
    return {};
  });
}

uint32_t formfieldValidationMessages(FormfieldDevice device, const char** last) {
  if (last) *last = "";
  auto* const vulkan = dynamic_cast<VulkanDevice*>(device);
  if (!vulkan) return 0;
  uint32_t count = 0;
  (void)guarded(vulkan->error, [&]() -> Result<void> {
    const auto messages = validationMessages(*vulkan->context);
    count = static_cast<uint32_t>(messages.size());
    vulkan->last_message = messages.empty() ? "" : messages.back();
    return {};
  });
  if (last) *last = vulkan->last_message.c_str();
  return count;
}

FormfieldResult formfieldRecord(FormfieldWorld world, VkCommandBuffer commands, const double observer[3],
                                const float velocity[3]) {
  if (!observer) return formfieldRecordFor(world, commands, 1, nullptr);
  const FormfieldObserver one = observerOf(observer, velocity);
  return formfieldRecordFor(world, commands, 1, &one);
}

FormfieldResult formfieldRecordFor(FormfieldWorld world, VkCommandBuffer commands, uint32_t count, const FormfieldObserver* observers) {
  if (!world) return guarded(errorOfThisThread(), [] { return Result<void>(usageError("world", "is NULL")); });
  const auto unsupported = [&] {
    (void)guarded(world->device.error, [&]() -> Result<void> {
      return usageError("formfieldRecord",
                        world->solver.fellBack()                  ? "the CPU has taken over"
                        : world->choice.kind == SolverKind::kSeed ? "seed is a baseline and does not record"
                                                                  : "this device does not record",
                        "call formfieldFrame");
    });
    return FORMFIELD_ERROR_UNSUPPORTED;
  };
  VulkanRecording* const recording = recordingOf(world);
  if (!recording) return unsupported();
  const FormfieldResult result = guarded(world->device.error, [&]() -> Result<void> {
    if (!commands || !observers) return usageError("commands or observer", "is NULL");
    const auto all = world->observersOf({observers, count});
    return all ? recording->frame(*world, commands, *all) : Result<void>(all.error());
  });
  return result == FORMFIELD_OK && world->solver.fellBack() ? unsupported() : result;
}

VkBuffer formfieldRadiosityBuffer(FormfieldWorld world) {
  VulkanRecording* const recording = recordingOf(world);
  return recording ? recording->recorder().radiosityBuffer() : VK_NULL_HANDLE;
}

VkBuffer formfieldSourceBuffer(FormfieldWorld world) {
  VulkanRecording* const recording = recordingOf(world);
  return recording ? recording->recorder().sourceBuffer() : VK_NULL_HANDLE;
}

}  // extern "C"
