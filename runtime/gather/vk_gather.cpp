#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "ease_comp.h"
#include "fade_comp.h"
#include "gather_change_comp.h"
#include "gather_comp.h"
#include "gather_enter_comp.h"
#include "gather_hold_comp.h"
#include "gather_kinds_comp.h"
#include "gather_leave_comp.h"
#include "pace_comp.h"
#include "pace_limit_comp.h"
#include "refine_comp.h"
#include "resolve_comp.h"
#include "runtime/cut/packed_rows.h"
#include "runtime/gather/gather_correction.h"
#include "runtime/gather/gather_layout.h"
#include "runtime/gather/semi_iteration.h"
#include "runtime/solver/sound_light.h"
#include "runtime/vulkan/buffer.h"
#include "runtime/vulkan/device.h"
#include "runtime/vulkan/pipeline.h"
#include "shaders/shared.h"
#include "shine_comp.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kMaxTiles = 16383;    // 4 work groups each, of the 65535 that any device takes
constexpr int kIterationsPerSubmit = 32;  // keeps a submission far below a driver's watchdog
constexpr uint32_t kQueries = 3;           // before the change, before the iterations, after them
constexpr uint64_t kVectorBytes = 16, kPageBytes = shaders::kPageWords * sizeof(uint32_t);
static_assert(kPageBytes == sizeof(PageTable::Page));
static_assert(shaders::kMostObservers == stream::kMaxObservers && shaders::kMostLevels == formats::kMaxLevels);

VkDescriptorBufferInfo whole(const Buffer& b) { return {b.handle(), 0, VK_WHOLE_SIZE}; }

Error tooSmall(const std::string& message) {
  return Error{ErrorCode::kIo, "", "vulkan", message, "raise the capacity", ErrorCause::kOutOfDeviceMemory};
}

shaders::PaceFrame frameOf(const LightPace& pace) {
  shaders::PaceFrame frame{};
  const auto point = [](Vec3 p) { return shaders::vec4{p.x, p.y, p.z, 0}; };
  frame.observers = static_cast<uint32_t>(pace.observers.size());
  for (size_t i = 0; i < pace.observers.size(); ++i) {
    const stream::Observer& observer = pace.observers[i];
    frame.at[i] = point(observer.at);
    frame.way[i] = point(pace.wayM(observer));
  }
  std::ranges::copy(pace.radii_m, frame.radii_m);
  frame.near_m = pace.nearM();
  frame.at_hand_m = pace.atHandM();
  frame.fewest_frames = LightPace::kFewestFrames;
  frame.most_change = pace.most_change;
  return frame;
}

class VulkanGather final : public VulkanRecorder {
 public:
  VulkanGather(std::shared_ptr<VkContext> context, const VulkanGatherSettings& settings,
               std::unique_ptr<GatherCorrection> correction)
      : context_(std::move(context)), settings_(settings), correction_(std::move(correction)) {}
  ~VulkanGather() override;
  Result<void> start();

  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override;
  bool resolvesRows() const override { return true; }
  Result<void> setRadiosity(std::span<const Vec4> radiosity) override;
  Result<void> setSource(std::span<const Vec4> source) override;
  Result<void> setEnteredSource(std::span<const Vec4> source, const MatrixChange& change, bool stays) override;
  void ease(uint32_t frames) override;
  void pace(const LightPace& pace) override { light_pace_ = pace.most_change > 0 ? frameOf(pace) : shaders::PaceFrame{}; }
  Result<void> iterate(int k) override;
  Result<void> approach(int k) override;
  Result<void> radiosity(std::span<Vec4> out) override;
  uint64_t repaired() const override {
    uint32_t in_steps = 0;
    std::memcpy(&in_steps, faults_.mapped(), sizeof(in_steps));
    return repaired_ + in_steps;
  }
  UploadedBytes uploaded() const override { return {uploaded_.rows + (correction_ ? correction_->uploadedBytes() : 0), uploaded_.light}; }
  double lastMs() const override { return last_ms_; }
  const char* name() const override { return correction_ ? correction_->name() : name_.c_str(); }
  Result<void> record(VkCommandBuffer commands, int iterations) override;
  Result<void> setEmission(std::span<const Vec4> emission) override;
  Result<void> setEnteredEmission(std::span<const Vec4> emission, const MatrixChange& change) override;
  void setFading(std::span<const shaders::FadingSlots> fading) override;
  VkBuffer radiosityBuffer() const override { return output_.handle(); }
  VkBuffer reflectedBuffer() const override { return radiosity_[now_].handle(); }
  VkBuffer sourceBuffer() const override { return source_.handle(); }
  double lastChangeMs() const override { return last_change_ms_; }
  double residual() const override { return correction_ ? correction_->residual() : -1; }
  const DenseStats* dense() const override { return correction_ ? &correction_->stats() : nullptr; }
  Result<std::vector<uint32_t>> row(uint32_t slot);
  Result<void> fillMatrix(float value) { return correction_->fillMatrix(value); }

 private:
  // A range of `jobs_` with what a dispatch over it needs.
  struct Jobs {
    uint32_t first, count, segment;
  };
  struct Level {  // spans of one level
    uint32_t first, count, longest;
  };
  Result<void> makePipelines();
  Result<void> makeBuffers();
  Result<void> makeSets();
  std::byte* stage(const Buffer& to, uint64_t at, uint64_t bytes, std::vector<VkBufferCopy>& copies, uint64_t UploadedBytes::*counts = &UploadedBytes::rows);
  std::byte* stageLight(const Buffer& to, uint64_t at, uint64_t bytes, std::vector<VkBufferCopy>& copies) { return stage(to, at, bytes, copies, &UploadedBytes::light); }
  void stageEntered(std::span<const Vec4> values, const MatrixChange& change, const Buffer& to, std::vector<VkBufferCopy>& copies);
  void stageOnce(std::span<const Vec4> values, const Buffer& to, std::vector<VkBufferCopy>& copies, bool& has);
  Result<void> flush();
  void stageTiles(const LocalMatrix& m, const MatrixChange& change);
  Result<void> stagePages(const LocalMatrix& m, const MatrixChange& change, bool all);
  void listJobs(const MatrixChange& change, bool all);
  void listSpans();
  void recordCopies(VkCommandBuffer c);
  void recordChange(VkCommandBuffer c);
  void recordHold(VkCommandBuffer c);
  void lookWhetherAnyIsHeld(uint32_t frame);
  void recordEase(VkCommandBuffer c, uint32_t frame);
  void recordRefine(VkCommandBuffer c, uint32_t buffer);
  void recordIteration(VkCommandBuffer c, bool first, float omega);
  // omega(): of the next step. passes: a frame passes before them.
  template <class Omega>
  Result<void> recordSteps(VkCommandBuffer c, int steps, Omega&& omega, bool passes);
  template <class Omega>
  Result<void> runSteps(int steps, Omega&& omega, bool passes = false);
  uint32_t recordNumber() const { return static_cast<uint32_t>(frame_) + 1; }  // of the next one, on the device
  void recordSeen(VkCommandBuffer c);
  Result<double> runMeasuredStep();
  void dispatchJobs(VkCommandBuffer c, const ComputePipeline& pipeline, VkDescriptorSet set, const Jobs& jobs) const;
  void readTime(uint32_t frame, bool wait);
  uint32_t rowsPerGroup() const { return std::max(1u, shaders::kGatherGroup / std::max(1u, context_->subgroupSize())); }
  uint32_t gatherGroups() const { return std::min(groupsOf(slots_, rowsPerGroup()), context_->limits().maxComputeWorkGroupCount[0]); }  // each goes on where the last one ends
  void forgetStaged();
  void letGo();

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  VulkanGatherSettings settings_;
  std::unique_ptr<GatherCorrection> correction_;  // may be null
  std::string name_ = "vulkan: " + context_->deviceName();
  ComputePipeline leave_, enter_, kinds_pass_, resolve_, gather_, gather_further_, hold_, pace_pass_, pace_limit_, ease_, change_, refine_, fade_, shine_;
  Buffer rows_, entries_, packed_, pages_, albedo_, parents_, siblings_, kinds_, source_, jobs_, spans_, emission_, fading_, weights_, output_, staging_;
  Buffer seen_;         // radiosity_[now_], brought to the host by the last submission of our own
  Buffer held_;         // what is held back of light, and for how many frames
  Buffer last_source_;  // source_ of the last step
  Buffer pace_frame_, paces_, paced_lights_, ease_state_;
  Buffer last_holding_;  // of ease_state_, brought to the host
  Buffer faults_;   // one word: values repaired in steps
  Buffer changes_;  // of runMeasuredStep(): a float a work group
  Buffer radiosity_[2];  // reflected
  uint32_t now_ = 0;     // radiosity_[now_] is the current one
  StorageSets sets_;
  VkDescriptorSet leave_set_ = VK_NULL_HANDLE, kinds_set_ = VK_NULL_HANDLE, fade_set_ = VK_NULL_HANDLE;
  VkDescriptorSet pace_set_[2] = {}, pace_limit_set_ = VK_NULL_HANDLE, ease_set_[2] = {}, enter_set_[2] = {}, refine_set_[2] = {}, shine_set_[2] = {};  // [radiosity buffer]
  VkDescriptorSet change_set_[2] = {};                         // [now_], before the step
  std::vector<VkDescriptorSet> resolve_sets_, gather_sets_[2], hold_sets_[2];  // [segment], [now_][segment]
  Handle<VkQueryPool, vkDestroyQueryPool> queries_;             // kQueries a frame in flight
  uint64_t segment_bytes_ = 0;
  uint32_t segments_ = 1;

  GatherLayout layout_;
  const LocalMatrix* matrix_ = nullptr;
  uint32_t slots_ = 0;
  std::vector<Level> levels_;  // finest first
  // What the next record() does first.
  bool changed_ = false, all_ = false, has_source_ = false, has_radiosity_ = false, has_emission_ = false;
  uint32_t fading_tiles_ = 0;
  bool has_later_source_ = false;  // sources were given twice
  uint32_t left_ = 0;
  std::vector<shaders::TileJob> job_list_;
  std::vector<shaders::SlotSpan> span_list_;
  std::vector<Jobs> enter_jobs_, resolve_jobs_;
  std::vector<VkBufferCopy> copies_to_packed_, copies_to_pages_, copies_to_jobs_, copies_to_spans_, copies_to_source_,
      copies_to_later_source_, copies_to_radiosity_, copies_to_emission_, copies_to_fading_;
  uint32_t ease_frames_ = 0;
  bool stepped_ = false;    // radiosity_[now_] is what a step came to, radiosity_[1 - now_] what it came from
  bool to_hold_ = false;    // rows have changed since
  bool holding_ = false;    // held_ may not be all zero
  std::vector<uint8_t> eased_;  // per frame in flight: ease.comp ran there, and nothing was held anew since
  shaders::PaceFrame light_pace_{};  // of the next record()
  uint32_t paced_tiles_ = 0;  // of span_list_
  bool let_go_ = false;     // it has to be, now
  bool seen_holds_ = false;
  uint64_t frame_ = 0, region_bytes_ = 0, region_used_ = 0;
  std::vector<uint8_t> timed_;  // per frame in flight: its queries were written
  UploadedBytes uploaded_;
  uint64_t repaired_ = 0;
  SemiIteration pace_;
  double last_ms_ = 0, last_change_ms_ = 0;
};

VulkanGather::~VulkanGather() {
  // Command buffers of the caller's may still be under way.
  vkDeviceWaitIdle(context_->device());
}

Result<void> VulkanGather::start() {
  const uint64_t range = context_->limits().maxStorageBufferRange;
  const uint64_t most = settings_.max_binding_bytes ? std::min(settings_.max_binding_bytes, range) : range;
  const uint64_t align = std::max<uint64_t>(256, context_->limits().minStorageBufferOffsetAlignment);
  settings_.entry_bytes = roundUp(settings_.entry_bytes, align);  // else a second segment for what is left
  segment_bytes_ = std::min(most, settings_.entry_bytes) / align * align;
  if (segment_bytes_ == 0 || settings_.slots == 0 || settings_.slots > kMaxSlots ||
      settings_.frames_in_flight == 0 || settings_.tiles == 0 || settings_.tiles > kMaxTiles)
    return Error{ErrorCode::kUsage, "", "vulkan", "no room for slots, tiles or entries, or no frame in flight",
                 "give at least " + std::to_string(align) + " bytes, 1 to " + std::to_string(kMaxSlots) + " slots, 1 to " + std::to_string(kMaxTiles) + " tiles and 1 frame"};
  segments_ = static_cast<uint32_t>(groupsOf(settings_.entry_bytes, segment_bytes_));
  if (settings_.packed_bytes > range || settings_.pages * kPageBytes > range)
    return Error{ErrorCode::kUsage, "", "vulkan",
                 "packed rows or pages exceed the " + std::to_string(range >> 20) + " MiB that the device binds",
                 "lower packed_bytes or pages"};
  layout_ = GatherLayout({settings_.packed_bytes / 4, segment_bytes_ / kVectorBytes, segments_, settings_.tiles});
  job_list_.reserve(size_t{4} * settings_.tiles);
  span_list_.reserve(settings_.tiles);
  for (auto* list : {&enter_jobs_, &resolve_jobs_}) list->reserve(formats::kMaxLevels + segments_);
  levels_.reserve(formats::kMaxLevels);
  copies_to_packed_.reserve(settings_.tiles);
  copies_to_pages_.reserve(settings_.pages);
  for (auto* list : {&copies_to_source_, &copies_to_emission_}) list->reserve(settings_.tiles);
  for (auto* list : {&copies_to_jobs_, &copies_to_spans_, &copies_to_later_source_, &copies_to_radiosity_, &copies_to_fading_}) list->reserve(1);
  timed_.assign(settings_.frames_in_flight, 0);
  eased_.assign(settings_.frames_in_flight, 0);
  if (auto r = makePipelines(); !r) return r;
  if (auto r = makeBuffers(); !r) return r;
  if (auto r = makeSets(); !r) return r;
  if (context_->hasTimestamps()) {
    auto info = zeroed<VkQueryPoolCreateInfo>(VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO);
    info.queryType = VK_QUERY_TYPE_TIMESTAMP;
    info.queryCount = kQueries * settings_.frames_in_flight;
    if (const VkResult r = vkCreateQueryPool(context_->device(), &info, nullptr, queries_.create(context_->device())); r != VK_SUCCESS)
      return vkError("vkCreateQueryPool", r);
  }
  auto cleared = context_->run([&](VkCommandBuffer c) {
    for (const Buffer* b : {&rows_, &albedo_, &source_, &emission_, &output_, &weights_, &radiosity_[0], &radiosity_[1], &kinds_, &held_, &last_source_, &ease_state_})
      vkCmdFillBuffer(c, b->handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, parents_.handle(), 0, VK_WHOLE_SIZE, shaders::kFreeSlot);
  });
  if (!cleared) return cleared.error();
  if (!correction_) return {};
  return correction_->start({kinds_.handle(),
                             albedo_.handle(),
                             source_.handle(),
                             {radiosity_[0].handle(), radiosity_[1].handle()},
                             settings_.slots,
                             settings_.frames_in_flight});
}

Result<void> VulkanGather::makePipelines() {
  struct Wanted {
    ComputePipeline* pipeline;
    std::span<const uint32_t> words;
    uint32_t buffers;
    size_t push_bytes;
    bool variant = false;
  };
  const Wanted list[] = {{&leave_, gather_leave_comp, 2, sizeof(shaders::JobPush)},
                         {&enter_, gather_enter_comp, 10, sizeof(shaders::JobPush)},
                         {&kinds_pass_, gather_kinds_comp, 2, sizeof(shaders::JobPush)},
                         {&resolve_, resolve_comp, 6, sizeof(shaders::JobPush)},
                         {&gather_, gather_comp, 9, sizeof(shaders::GatherPush)},
                         {&gather_further_, gather_comp, 9, sizeof(shaders::GatherPush), true},
                         {&hold_, gather_hold_comp, 9, sizeof(shaders::GatherPush)},
                         {&pace_pass_, pace_comp, 8, 0},
                         {&pace_limit_, pace_limit_comp, 3, sizeof(shaders::PacePush)},
                         {&ease_, ease_comp, 4, sizeof(shaders::EasePush)},
                         {&change_, gather_change_comp, 4, sizeof(shaders::ChangePush)},
                         {&refine_, refine_comp, 5, sizeof(shaders::RefinePush)},
                         {&fade_, fade_comp, 2, sizeof(shaders::FadePush)},
                         {&shine_, shine_comp, 8, sizeof(shaders::ShinePush)}};
  for (const Wanted& w : list) {
    auto made = ComputePipeline::create(*context_, w.words, w.buffers, static_cast<uint32_t>(w.push_bytes), w.variant);
    if (!made) return made.error();
    *w.pipeline = std::move(*made);
  }
  return {};
}

Result<void> VulkanGather::makeBuffers() {
  const uint64_t slots = settings_.slots, jobs = uint64_t{4} * settings_.tiles * sizeof(shaders::TileJob);
  const uint64_t spans = std::max(slots, uint64_t{settings_.tiles}) * sizeof(shaders::SlotSpan);
  // All that one frame can bring: the whole cut, every page, light, emission and radiosity. Each frame's begins aligned.
  const uint64_t most = settings_.packed_bytes + settings_.pages * kPageBytes + jobs + spans + 4 * slots * sizeof(Vec4) + settings_.tiles * sizeof(shaders::FadingSlots);
  region_bytes_ = roundUp(most, sizeof(Vec4));
  struct Wanted {
    Buffer* buffer;
    uint64_t bytes;
    MemoryUse use = MemoryUse::kDevice;
  };
  const Wanted list[] = {
      {&rows_, slots * sizeof(shaders::GatherRow)},
      {&entries_, segments_ * segment_bytes_},
      {&packed_, settings_.packed_bytes},
      {&pages_, settings_.pages * kPageBytes},
      {&albedo_, slots * sizeof(Vec4)},
      {&parents_, slots * sizeof(uint32_t)},
      {&siblings_, slots * sizeof(uint32_t)},
      {&kinds_, slots * sizeof(uint32_t)},
      {&source_, slots * sizeof(Vec4)},
      {&jobs_, jobs},
      {&spans_, spans},
      {&emission_, slots * sizeof(Vec4)},
      {&output_, slots * sizeof(Vec4)},
      {&fading_, settings_.tiles * sizeof(shaders::FadingSlots)},
      {&weights_, slots * 2 * sizeof(uint32_t)},
      {&held_, slots * sizeof(Vec4)},
      {&last_source_, slots * sizeof(Vec4)},
      {&pace_frame_, sizeof(shaders::PaceFrame)},
      {&paces_, slots * sizeof(shaders::TilePace)},
      {&paced_lights_, settings_.tiles * sizeof(shaders::PacedLight)},
      {&ease_state_, sizeof(shaders::EaseState)},
      {&last_holding_, sizeof(uint32_t), MemoryUse::kHost},
      {&faults_, sizeof(uint32_t), MemoryUse::kHost},
      {&changes_, groupsOf(settings_.slots, shaders::kGatherGroup) * sizeof(float), MemoryUse::kHost},
      {&radiosity_[0], slots * sizeof(Vec4)},
      {&radiosity_[1], slots * sizeof(Vec4)},
      {&staging_, region_bytes_ * settings_.frames_in_flight, MemoryUse::kHost},
      {&seen_, slots * sizeof(Vec4), MemoryUse::kHost}};
  for (const Wanted& w : list) {
    auto b = Buffer::create(*context_, w.bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, w.use);
    if (!b) return b.error();
    *w.buffer = std::move(*b);
  }
  for (const Buffer* word : {&faults_, &last_holding_}) std::memset(word->mapped(), 0, sizeof(uint32_t));
  return {};
}

Result<void> VulkanGather::makeSets() {
  auto sets = StorageSets::create(*context_, 16 + 5 * segments_, 2 + 2 + 2 + 3 + 2 * (10 + 8 + 4 + 5 + 4 + 8) + segments_ * (6 + 18 + 18));
  if (!sets) return sets.error();
  sets_ = std::move(*sets);
  Result<void> failed;
  const auto make = [&](const ComputePipeline& pipeline, std::initializer_list<VkDescriptorBufferInfo> buffers) {
    auto set = sets_.make(pipeline.setLayout(), std::span(buffers.begin(), buffers.size()));
    if (set) return *set;
    failed = set.error();
    return VkDescriptorSet{VK_NULL_HANDLE};
  };
  leave_set_ = make(leave_, {whole(jobs_), whole(parents_)});
  kinds_set_ = make(kinds_pass_, {whole(parents_), whole(kinds_)});
  for (uint32_t i = 0; i < 2; ++i) {
    enter_set_[i] = make(enter_, {whole(jobs_), whole(packed_), whole(albedo_), whole(rows_), whole(parents_),
                                  whole(siblings_), whole(radiosity_[i]), whole(radiosity_[1 - i]), whole(last_source_), whole(held_)});
    pace_set_[i] = make(pace_pass_, {whole(spans_), whole(packed_), whole(pace_frame_), whole(kinds_), whole(albedo_), whole(radiosity_[i]), whole(paces_), whole(paced_lights_)});
    ease_set_[i] = make(ease_, {whole(held_), whole(radiosity_[i]), whole(paces_), whole(ease_state_)});
    refine_set_[i] = make(refine_, {whole(spans_), whole(parents_), whole(siblings_), whole(albedo_), whole(radiosity_[i])});
    change_set_[i] = make(change_, {whole(radiosity_[i]), whole(radiosity_[1 - i]), whole(kinds_), whole(changes_)});
    shine_set_[i] = make(shine_, {whole(radiosity_[i]), whole(emission_), whole(output_), whole(weights_), whole(parents_), whole(albedo_),
                                  whole(source_), whole(last_source_)});
  }
  pace_limit_set_ = make(pace_limit_, {whole(pace_frame_), whole(paced_lights_), whole(ease_state_)});
  fade_set_ = make(fade_, {whole(fading_), whole(weights_)});
  for (uint32_t s = 0; s < segments_; ++s) {
    const VkDescriptorBufferInfo segment{entries_.handle(), s * segment_bytes_, segment_bytes_};
    resolve_sets_.push_back(make(resolve_, {whole(jobs_), whole(packed_), whole(pages_), whole(kinds_), whole(rows_), segment}));
    for (uint32_t now = 0; now < 2; ++now) {
      gather_sets_[now].push_back(
          make(gather_, {whole(rows_), segment, whole(albedo_), whole(source_), whole(radiosity_[now]),
                         whole(radiosity_[1 - now]), whole(kinds_), whole(held_), whole(faults_)}));
      // With all bounces in a step what it came to has gone on from what rows made of it: that is asked what rows make of it.
      const Buffer& before = radiosity_[correction_ ? now : 1 - now];
      hold_sets_[now].push_back(make(hold_, {whole(rows_), segment, whole(albedo_), whole(source_), whole(before),
                                             whole(radiosity_[now]), whole(kinds_), whole(held_), whole(last_source_)}));
    }
  }
  return failed;
}

// Room in this frame's region and the copy from there, which the next record() makes.
std::byte* VulkanGather::stage(const Buffer& to, uint64_t at, uint64_t bytes, std::vector<VkBufferCopy>& copies, uint64_t UploadedBytes::*counts) {
  const uint64_t from = frame_ % settings_.frames_in_flight * region_bytes_ + region_used_;
  FF_CHECK_LE(region_used_ + bytes, region_bytes_);
  FF_CHECK_LE(at + bytes, to.bytes());
  region_used_ += bytes;
  uploaded_.*counts += bytes;
  copies.push_back({from, at, bytes});
  return staging_.mapped() + from;
}

// A change that was not recorded yet goes to the device now.
Result<void> VulkanGather::flush() {
  if (!changed_ && !has_source_ && !has_radiosity_ && !has_emission_) return {};
  Result<void> recorded;
  auto ms = context_->run([&](VkCommandBuffer c) { recorded = record(c, 0); });
  if (!recorded) return recorded;
  if (!ms) return ms.error();
  return {};
}

// After an update that failed half-way.
void VulkanGather::forgetStaged() {
  for (auto* list : {&copies_to_packed_, &copies_to_pages_, &copies_to_jobs_, &copies_to_spans_, &copies_to_source_,
                     &copies_to_later_source_, &copies_to_radiosity_, &copies_to_emission_, &copies_to_fading_})
    list->clear();
  region_used_ = 0;
  changed_ = all_ = has_source_ = has_later_source_ = has_radiosity_ = has_emission_ = false;
  fading_tiles_ = 0;
}

// What is held back of light is forgotten.
void VulkanGather::letGo() {
  let_go_ |= std::exchange(holding_, false);
  to_hold_ = false;
}

void VulkanGather::ease(uint32_t frames) {
  ease_frames_ = frames;
  if (frames == 0) letGo();
}

Result<void> VulkanGather::update(const LocalMatrix& m, const MatrixChange& change) {
  if (!matrix_) forgetStaged();
  if (auto r = flush(); !r) return r;
  const bool by_hand = !m.pages;
  if (matrix_ == &m && !change.any && !by_hand) return {};
  const bool afresh = std::exchange(matrix_, nullptr) != &m || by_hand, all = afresh || change.renumbered;
  FF_CHECK_LT(0u, m.slots());
  if (m.slots() > settings_.slots)
    return tooSmall(std::to_string(m.slots()) + " slots, room was made for " + std::to_string(settings_.slots));
  if (auto r = layout_.update(m, change, all); !r) return r;
  if (auto r = stagePages(m, change, all); !r) return r;
  stageTiles(m, change);
  matrix_ = &m;
  if (all) {
    stepped_ = false;
    letGo();
  }
  to_hold_ = ease_frames_ > 0 && stepped_;
  listJobs(change, all);
  listSpans();
  if (!job_list_.empty())
    std::memcpy(stage(jobs_, 0, job_list_.size() * sizeof(shaders::TileJob), copies_to_jobs_), job_list_.data(),
                job_list_.size() * sizeof(shaders::TileJob));
  if (!span_list_.empty())
    std::memcpy(stage(spans_, 0, span_list_.size() * sizeof(shaders::SlotSpan), copies_to_spans_), span_list_.data(),
                span_list_.size() * sizeof(shaders::SlotSpan));
  slots_ = m.slots();
  changed_ = true;
  pace_.forget();
  all_ = all;
  if (correction_) correction_->update(m, change, afresh);
  return {};
}

void VulkanGather::stageTiles(const LocalMatrix& m, const MatrixChange& change) {
  const std::span<const GatherLayout::Tile> tiles = layout_.tiles();
  size_t entered = 0;  // in change.entered, whose numbers fall
  for (size_t t = tiles.size(); t-- > 0;) {
    const GatherLayout::Tile& tile = tiles[t];
    while (entered < change.entered.size() && change.entered[entered] > t) ++entered;
    if (!tile.placed) continue;
    auto* const words = reinterpret_cast<uint32_t*>(stage(packed_, tile.packed_at * 4, tile.packed_words * 4, copies_to_packed_));
    const bool has_entered = entered < change.entered.size() && change.entered[entered] == t;
    const std::span<const uint32_t> packed = change.packed && has_entered ? change.packed->tile(entered) : std::span<const uint32_t>();
    if (packed.empty())
      writePacked(m, tile.range, t < m.places.size() ? m.places[t].bounds : Box{}, *tile.strip, tile.partner_pages, words);
    else
      std::memcpy(words, packed.data(), packed.size_bytes());
  }
}

Result<void> VulkanGather::stagePages(const LocalMatrix& m, const MatrixChange& change, bool all) {
  if (!m.pages) {  // made by hand: pages in the order of slots
    const uint32_t pages = groupsOf(m.slots(), shaders::kPageNodes);
    if (pages > settings_.pages) return tooSmall("more pages than room was made for");
    for (uint32_t p = 0; p < pages; ++p) {
      PageTable::Page page{p * shaders::kPageNodes, {}};
      std::iota(page.index.begin(), page.index.end(), uint8_t{0});
      std::memcpy(stage(pages_, p * kPageBytes, kPageBytes, copies_to_pages_), &page, kPageBytes);
    }
    return {};
  }
  if (m.pages->pages().size() > settings_.pages)
    return tooSmall(std::to_string(m.pages->pages().size()) + " pages, room was made for " +
                    std::to_string(settings_.pages));
  const auto copy = [&](uint32_t number, const PageTable::Page& page) { std::memcpy(stage(pages_, number * kPageBytes, kPageBytes, copies_to_pages_), &page, kPageBytes); };
  if (all) {
    for (uint32_t p = 0; p < m.pages->pages().size(); ++p) copy(p, m.pages->page(p));
    return {};
  }
  const bool packed = change.packed && change.packed->pages().size() == change.pages.size();
  for (size_t p = 0; p < change.pages.size(); ++p) copy(change.pages[p], packed ? change.packed->pages()[p] : m.pages->page(change.pages[p]));
  return {};
}

// Tiles that left, those to take up (coarsest level first, a dispatch a level), those to resolve (a dispatch a segment).
void VulkanGather::listJobs(const MatrixChange& change, bool all) {
  const std::span<const GatherLayout::Tile> tiles = layout_.tiles();
  job_list_.clear();
  enter_jobs_.clear();
  resolve_jobs_.clear();
  if (!all)
    for (const SlotRange& range : change.left) job_list_.push_back({range.first_slot, range.nodes, 0, 0, 0, 0, 0, 0});
  left_ = static_cast<uint32_t>(job_list_.size());
  const auto add = [&](const GatherLayout::Tile& tile, uint32_t start) {
    job_list_.push_back({tile.range.first_slot, tile.range.nodes, tile.segment, static_cast<uint32_t>(tile.packed_at),
                         tile.pages_at, tile.words_at, static_cast<uint32_t>(tile.entries_at), start});
  };
  bool any_placed_anew = false;
  uint32_t level = kNoSlot;
  for (size_t t = tiles.size(); t-- > 0;) {
    const GatherLayout::Tile& tile = tiles[t];
    if (!tile.placed) continue;
    any_placed_anew = any_placed_anew || !tile.entered;
    if (enter_jobs_.empty() || tile.range.id.level != level)
      enter_jobs_.push_back({static_cast<uint32_t>(job_list_.size()), 0, 0});
    level = tile.range.id.level;
    ++enter_jobs_.back().count;
    add(tile, all ? shaders::kStartZero : !tile.entered ? shaders::kStartKept : to_hold_ ? shaders::kStartEased : shaders::kStartParent);
  }
  for (uint32_t s = 0; s < segments_; ++s) {
    const Jobs jobs{static_cast<uint32_t>(job_list_.size()), 0, s};
    const auto resolve = [&](const GatherLayout::Tile& tile) {
      if (tile.segment == s) add(tile, shaders::kStartKept);
    };
    if (all || any_placed_anew)
      std::for_each(tiles.begin(), tiles.end(), resolve);
    else
      for (const uint32_t t : change.rows) resolve(tiles[t]);
    if (job_list_.size() == jobs.first) continue;
    resolve_jobs_.push_back(jobs);
    resolve_jobs_.back().count = static_cast<uint32_t>(job_list_.size()) - jobs.first;
  }
}

// The slots whose parents are refined, level by level from the finest.
void VulkanGather::listSpans() {
  span_list_.clear();
  levels_.clear();
  paced_tiles_ = 0;
  const LocalMatrix& m = *matrix_;
  const auto add = [&](uint32_t first, uint32_t slots, uint32_t place_at) {
    span_list_.push_back({first, slots, place_at});
    ++levels_.back().count;
    levels_.back().longest = std::max(levels_.back().longest, slots);
  };
  if (!m.pages) {
    for (size_t l = 0; l + 1 < m.refined_level_start.size(); ++l) {
      levels_.push_back({static_cast<uint32_t>(span_list_.size()), 0, 0});
      for (uint32_t r = m.refined_level_start[l]; r < m.refined_level_start[l + 1]; ++r)
        add(m.refined[r].first_child, m.refined[r].last_child + 1 - m.refined[r].first_child, 0);
    }
    return;
  }
  uint32_t level = kNoSlot;
  for (size_t t = 0; t < m.tiles.size(); ++t) {
    const GatherLayout::Tile& tile = layout_.tiles()[t];
    if (tile.range.id.level != level) levels_.push_back({static_cast<uint32_t>(span_list_.size()), 0, 0});
    level = tile.range.id.level;
    add(tile.range.first_slot, tile.range.nodes, static_cast<uint32_t>(tile.packed_at + tile.packed_words) - shaders::kPlaceWords);
  }
  if (!levels_.empty() && m.parent_slot[m.tiles.back().first_slot] == kNoSlot) levels_.pop_back();  // the top level has no parents
  if (m.ambient_slot == kNoSlot && !m.places.empty()) paced_tiles_ = static_cast<uint32_t>(span_list_.size());
}

// Twice in a frame: the later counts.
void VulkanGather::stageOnce(std::span<const Vec4> values, const Buffer& to, std::vector<VkBufferCopy>& copies, bool& has) {
  FF_CHECK_EQ(values.size(), size_t{slots_});
  if (has) FF_CHECK_EQ(copies.back().size, uint64_t{values.size_bytes()});
  std::byte* const at = has ? staging_.mapped() + copies.back().srcOffset : stageLight(to, 0, values.size_bytes(), copies);
  repaired_ += copySound(values, {reinterpret_cast<Vec4*>(at), values.size()});
  has = true;
}

void VulkanGather::stageEntered(std::span<const Vec4> values, const MatrixChange& change, const Buffer& to, std::vector<VkBufferCopy>& copies) {
  FF_CHECK_EQ(values.size(), size_t{slots_});
  for (const uint32_t t : change.entered) {
    const SlotRange& range = matrix_->tiles[t];
    const auto entered = values.subspan(range.first_slot, range.nodes);
    std::byte* const at = stageLight(to, range.first_slot * sizeof(Vec4), entered.size_bytes(), copies);
    repaired_ += copySound(entered, {reinterpret_cast<Vec4*>(at), entered.size()});
  }
}

Result<void> VulkanGather::setSource(std::span<const Vec4> source) {
  if (has_source_)  // what is held back goes by those of before
    stageOnce(source, source_, copies_to_later_source_, has_later_source_);
  else
    stageOnce(source, source_, copies_to_source_, has_source_);
  pace_.forget();
  return {};
}

Result<void> VulkanGather::setEnteredSource(std::span<const Vec4> source, const MatrixChange& change, bool) {
  if (has_source_) return setSource(source);
  stageEntered(source, change, source_, copies_to_source_);
  has_source_ = true;
  pace_.forget();
  return {};
}

Result<void> VulkanGather::setEmission(std::span<const Vec4> emission) {
  stageOnce(emission, emission_, copies_to_emission_, has_emission_);
  return {};
}

Result<void> VulkanGather::setEnteredEmission(std::span<const Vec4> emission, const MatrixChange& change) {
  FF_CHECK_EQ(has_emission_, false);
  stageEntered(emission, change, emission_, copies_to_emission_);
  has_emission_ = true;
  return {};
}

void VulkanGather::setFading(std::span<const shaders::FadingSlots> fading) {
  FF_CHECK_EQ(fading_tiles_, 0u);
  fading_tiles_ = static_cast<uint32_t>(fading.size());
  if (!fading.empty()) std::memcpy(stageLight(fading_, 0, fading.size_bytes(), copies_to_fading_), fading.data(), fading.size_bytes());
}

Result<void> VulkanGather::setRadiosity(std::span<const Vec4> radiosity) {
  FF_CHECK_EQ(radiosity.size(), size_t{slots_});
  auto* to = reinterpret_cast<Vec4*>(
      has_radiosity_ ? staging_.mapped() + copies_to_radiosity_.back().srcOffset
                     : stageLight(radiosity_[now_], 0, radiosity.size_bytes(), copies_to_radiosity_));
  repaired_ += copySound(radiosity, {to, radiosity.size()});
  has_radiosity_ = true;
  stepped_ = false;
  letGo();
  pace_.forget();
  return {};
}

void VulkanGather::recordCopies(VkCommandBuffer c) {
  const auto copy = [&](std::vector<VkBufferCopy>& list, const Buffer& to) {
    if (!list.empty())
      vkCmdCopyBuffer(c, staging_.handle(), to.handle(), static_cast<uint32_t>(list.size()), list.data());
    list.clear();
  };
  copy(copies_to_packed_, packed_);
  copy(copies_to_pages_, pages_);
  copy(copies_to_jobs_, jobs_);
  copy(copies_to_spans_, spans_);
  copy(copies_to_source_, source_);
  copy(copies_to_emission_, emission_);
  copy(copies_to_fading_, fading_);
  if (let_go_) vkCmdFillBuffer(c, held_.handle(), 0, VK_WHOLE_SIZE, 0);
  let_go_ = false;
  if (all_) vkCmdFillBuffer(c, parents_.handle(), 0, VK_WHOLE_SIZE, shaders::kFreeSlot);
}

void VulkanGather::dispatchJobs(VkCommandBuffer c, const ComputePipeline& pipeline, VkDescriptorSet set,
                                const Jobs& jobs) const {
  // resolve.comp takes as many nodes at once as a group has subgroups, and goes on until the tile is done.
  const uint32_t at_once = &pipeline == &resolve_ ? rowsPerGroup() : shaders::kGatherGroup;
  const uint32_t most = std::max(1u, context_->limits().maxComputeWorkGroupCount[0] / jobs.count);
  const shaders::JobPush push{jobs.first, jobs.count, std::min(groupsOf(formats::kTileNodes, at_once), most)};
  pipeline.dispatch(c, set, &push, jobs.count * push.groups);
}

void VulkanGather::recordChange(VkCommandBuffer c) {
  if (left_ > 0) dispatchJobs(c, leave_, leave_set_, {0, left_, 0});
  separate(c);
  for (const Jobs& jobs : enter_jobs_) {
    dispatchJobs(c, enter_, enter_set_[now_], jobs);
    separate(c);
  }
  for (uint32_t pass = 0; pass < 2; ++pass) {
    const shaders::JobPush push{0, slots_, pass};
    kinds_pass_.dispatch(c, kinds_set_, &push, groupsOf(slots_, shaders::kGatherGroup));
    separate(c);
  }
  for (const Jobs& jobs : resolve_jobs_) dispatchJobs(c, resolve_, resolve_sets_[jobs.segment], jobs);
  separate(c);
}

// What rows that have changed would have made else of the last step.
void VulkanGather::recordHold(VkCommandBuffer c) {
  for (uint32_t s = 0; s < segments_; ++s) {
    const shaders::GatherPush push{slots_, s, 1, ease_frames_};
    hold_.dispatch(c, hold_sets_[now_][s], &push, gatherGroups());
  }
  separate(c);
  to_hold_ = false;
  holding_ = true;
  std::ranges::fill(eased_, uint8_t{0});
}

// By what the record that had this frame's region before has left.
void VulkanGather::lookWhetherAnyIsHeld(uint32_t frame) {
  if (!std::exchange(eased_[frame], uint8_t{0})) return;
  uint32_t last = 0;
  std::memcpy(&last, last_holding_.mapped(), sizeof(last));
  if (last + settings_.frames_in_flight < recordNumber()) holding_ = false;  // a later record holds nothing that this one did not
}

void VulkanGather::recordEase(VkCommandBuffer c, uint32_t frame) {
  const bool limited = light_pace_.most_change > 0 && paced_tiles_ > 0;
  if (limited) {
    vkCmdUpdateBuffer(c, pace_frame_.handle(), 0, sizeof(light_pace_), &light_pace_);
    separate(c);
    pace_pass_.dispatch(c, pace_set_[now_], nullptr, paced_tiles_);
    separate(c);
    const shaders::PacePush push{paced_tiles_};
    pace_limit_.dispatch(c, pace_limit_set_, &push, 1);
    separate(c);
  }
  const shaders::EasePush push{slots_, correction_ != nullptr, ease_frames_, recordNumber(), limited ? light_pace_.most_change : 0};
  ease_.dispatch(c, ease_set_[now_], &push, groupsOf(slots_, shaders::kGatherGroup));
  separate(c);
  if (correction_) recordRefine(c, now_);
  const VkBufferCopy copy{offsetof(shaders::EaseState, last_holding), 0, sizeof(uint32_t)};
  vkCmdCopyBuffer(c, ease_state_.handle(), last_holding_.handle(), 1, &copy);
  eased_[frame] = 1;
}

void VulkanGather::recordIteration(VkCommandBuffer c, bool first, float omega) {
  for (uint32_t s = 0; s < segments_; ++s) {  // segments write different slots: no barrier between them
    const shaders::GatherPush push{slots_, s, omega, 0};
    const ComputePipeline& gather = omega == 1 ? gather_ : gather_further_;
    gather.dispatch(c, gather_sets_[now_][s], &push, gatherGroups());
  }
  // The next step reads what this one wrote, the next iteration overwrites what this one read.
  separate(c);
  if (correction_) correction_->recordStep(c, now_, first);
  recordRefine(c, 1 - now_);
  now_ = 1 - now_;
}

// Of radiosity_[buffer].
void VulkanGather::recordRefine(VkCommandBuffer c, uint32_t buffer) {
  for (const Level& level : levels_) {
    const uint32_t groups = groupsOf(level.longest, shaders::kRefineGroup);
    const shaders::RefinePush push{level.first, groups};
    refine_.dispatch(c, refine_set_[buffer], &push, level.count * groups);
    separate(c);
  }
}

void VulkanGather::readTime(uint32_t frame, bool wait) {
  if (!queries_ || !timed_[frame]) return;
  uint64_t ticks[kQueries] = {};
  const VkQueryResultFlags flags = VK_QUERY_RESULT_64_BIT | (wait ? VK_QUERY_RESULT_WAIT_BIT : 0);
  if (vkGetQueryPoolResults(context_->device(), queries_, kQueries * frame, kQueries, sizeof(ticks), ticks,
                            sizeof(uint64_t), flags) != VK_SUCCESS)
    return;
  const double ms_per_tick = static_cast<double>(context_->limits().timestampPeriod) * 1e-6;
  last_change_ms_ = static_cast<double>(ticks[1] - ticks[0]) * ms_per_tick;
  last_ms_ = static_cast<double>(ticks[2] - ticks[1]) * ms_per_tick;
}

Result<void> VulkanGather::record(VkCommandBuffer c, int iterations) {
  return recordSteps(c, iterations, [] { return 1.0f; }, iterations > 0);
}

template <class Omega>
Result<void> VulkanGather::recordSteps(VkCommandBuffer c, int iterations, Omega&& omega, bool passes) {
  FF_CHECK_EQ(matrix_ != nullptr, true);
  const auto frame = static_cast<uint32_t>(frame_ % settings_.frames_in_flight);
  seen_holds_ = false;
  readTime(frame, false);
  lookWhetherAnyIsHeld(frame);
  const auto stamp = [&](uint32_t query) {
    if (queries_) vkCmdWriteTimestamp(c, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries_, kQueries * frame + query);
  };
  if (queries_) vkCmdResetQueryPool(c, queries_, kQueries * frame, kQueries);
  separate(c);
  stamp(0);
  recordCopies(c);
  separate(c);
  if (changed_) recordChange(c);
  if (correction_ && correction_->recordChange(c, frame, iterations, changed_ || has_radiosity_ || holding_)) {
    vkCmdFillBuffer(c, radiosity_[now_].handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, held_.handle(), 0, VK_WHOLE_SIZE, 0);
    to_hold_ = holding_ = false;
    separate(c);
  }
  if (has_radiosity_) {
    vkCmdCopyBuffer(c, staging_.handle(), radiosity_[now_].handle(), 1, copies_to_radiosity_.data());
    copies_to_radiosity_.clear();
    separate(c);
  }
  if (to_hold_) recordHold(c);
  if (has_later_source_) {
    vkCmdCopyBuffer(c, staging_.handle(), source_.handle(), 1, copies_to_later_source_.data());
    copies_to_later_source_.clear();
    separate(c);
  }
  if (passes && holding_) recordEase(c, frame);
  changed_ = all_ = has_source_ = has_later_source_ = has_radiosity_ = has_emission_ = false;
  left_ = 0;
  stamp(1);
  for (int i = 0; i < iterations; ++i) recordIteration(c, i == 0, omega());
  if (iterations > 0) stepped_ = true;
  if (correction_) correction_->recordEnd(c, frame, iterations);
  stamp(2);
  timed_[frame] = 1;
  const shaders::FadePush fades{fading_tiles_ > 0 ? recordNumber() : 0};
  if (fading_tiles_ > 0) {
    fade_.dispatch(c, fade_set_, &fades, std::exchange(fading_tiles_, 0));
    separate(c);
  }
  const shaders::ShinePush push{slots_, iterations > 0, fades.record};
  shine_.dispatch(c, shine_set_[now_], &push, groupsOf(slots_, shaders::kGatherGroup));
  barrier(c, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT,
          VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT);
  barrier(c, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT,
          VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT);  // faults_, last_holding_
  ++frame_;
  region_used_ = 0;
  return {};
}

void VulkanGather::recordSeen(VkCommandBuffer c) {
  const VkBufferCopy copy{0, 0, slots_ * sizeof(Vec4)};
  vkCmdCopyBuffer(c, radiosity_[now_].handle(), seen_.handle(), 1, &copy);
}

template <class Omega>
Result<void> VulkanGather::runSteps(int k, Omega&& omega, bool passes) {
  double ms = 0;
  for (int done = 0; done < k;) {
    const int n = std::min(k - done, kIterationsPerSubmit);
    const auto frame = static_cast<uint32_t>(frame_ % settings_.frames_in_flight);
    Result<void> recorded;
    auto took = context_->run([&](VkCommandBuffer c) {
      recorded = recordSteps(c, n, omega, std::exchange(passes, false));
      if (recorded && done + n == k) recordSeen(c);
    });
    if (!recorded) return recorded;
    if (!took) return took.error();
    last_ms_ = *took;
    readTime(frame, true);
    ms += last_ms_;
    done += n;
    seen_holds_ = done == k;
  }
  last_ms_ = ms;
  return {};
}

// A Jacobi step; the norm of its change over the leaves.
Result<double> VulkanGather::runMeasuredStep() {
  if (auto ran = runSteps(1, [] { return 1.0f; }); !ran) return ran.error();
  auto took = context_->run([&](VkCommandBuffer c) {
    const shaders::ChangePush push{slots_};
    change_.dispatch(c, change_set_[1 - now_], &push, groupsOf(slots_, shaders::kGatherGroup));
    barrier(c, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_ACCESS_SHADER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
            VK_ACCESS_HOST_READ_BIT);
  });
  if (!took) return took.error();
  double sum = 0;
  for (uint32_t g = 0; g < groupsOf(slots_, shaders::kGatherGroup); ++g) {
    float part = 0;
    std::memcpy(&part, changes_.mapped() + g * sizeof(part), sizeof(part));
    sum += static_cast<double>(part);
  }
  return std::sqrt(sum);
}

Result<void> VulkanGather::iterate(int k) {
  return runSteps(k, [] { return 1.0f; }, true);
}

Result<void> VulkanGather::approach(int k) {
  if (correction_ || !pace_.suits(k)) return iterate(k);
  const auto first = runMeasuredStep();
  if (!first) return first.error();
  double ms = last_ms_;
  const auto second = runMeasuredStep();
  if (!second) return second.error();
  ms += last_ms_;
  pace_.learn(*first, *second);
  if (auto ran = runSteps(k - 2, [this] { return pace_.omega(); }); !ran) return ran;
  last_ms_ += ms;
  return {};
}

Result<void> VulkanGather::radiosity(std::span<Vec4> out) {
  FF_CHECK_EQ(out.size(), size_t{slots_});
  if (auto r = flush(); !r) return r;
  if (!seen_holds_)
    if (auto ms = context_->run([&](VkCommandBuffer c) { recordSeen(c); }); !ms) return ms.error();
  seen_holds_ = true;
  std::memcpy(out.data(), seen_.mapped(), out.size_bytes());
  return {};
}

Result<std::vector<uint32_t>> VulkanGather::row(uint32_t slot) {
  if (auto r = flush(); !r) return r.error();
  shaders::GatherRow row{};
  if (auto r = download(*context_, rows_, slot * sizeof(row), std::as_writable_bytes(std::span(&row, 1))); !r)
    return r.error();
  std::vector<uint32_t> entries(row.entries);
  if (auto r = download(*context_, entries_, row.segment * segment_bytes_ + row.first * kVectorBytes,
                        std::as_writable_bytes(std::span(entries)));
      !r)
    return r.error();
  return entries;
}

}  // namespace

VulkanGatherSettings gatherRoomFor(const formats::World& world, uint32_t max_slots) {
  uint64_t nodes = 0, entries = 0, tiles = 0;
  for (uint32_t level = 0; level < world.levels().size(); ++level) {
    nodes += world.levels()[level].nodes;
    entries += world.levels()[level].entries;
    tiles += world.levels()[level].tiles;
  }
  const uint64_t in_cut = std::min<uint64_t>(nodes, max_slots), a_row = entries / std::max<uint64_t>(nodes, 1) + 1;
  VulkanGatherSettings s;
  s.slots = static_cast<uint32_t>(in_cut);
  s.tiles = static_cast<uint32_t>(std::min<uint64_t>(tiles + 1, 4096));
  s.pages = static_cast<uint32_t>(std::min<uint64_t>(tiles + 1, 65536));
  // A word an entry, about a run of one word for every four of them; row starts and nodes 36 bytes.
  s.packed_bytes = ((a_row * 3 + 36) * in_cut + std::min<uint64_t>(tiles, 65536) * 8) * 3 / 2 + (1 << 16);
  s.entry_bytes = (a_row + 2 * shaders::kEntriesPerLoad) * 4 * in_cut * 3 / 2 + (1 << 16);
  return s;
}

Result<std::unique_ptr<VulkanRecorder>> makeVulkanRecorder(std::shared_ptr<VkContext> context,
                                                           const VulkanGatherSettings& settings) {
  return makeVulkanRecorder(std::move(context), settings, nullptr);
}

Result<std::unique_ptr<VulkanRecorder>> makeVulkanRecorder(std::shared_ptr<VkContext> context,
                                                           const VulkanGatherSettings& settings,
                                                           std::unique_ptr<GatherCorrection> correction) {
  auto gather = std::make_unique<VulkanGather>(std::move(context), settings, std::move(correction));
  if (auto r = gather->start(); !r) return r.error();
  return std::unique_ptr<VulkanRecorder>(std::move(gather));
}

Result<std::unique_ptr<Solver>> makeVulkanGather(std::shared_ptr<VkContext> context,
                                                 const VulkanGatherSettings& settings) {
  auto recorder = makeVulkanRecorder(std::move(context), settings);
  if (!recorder) return recorder.error();
  return std::unique_ptr<Solver>(std::move(*recorder));
}

Result<std::vector<uint32_t>> resolvedRow(VulkanRecorder& recorder, uint32_t slot) {
  return static_cast<VulkanGather&>(recorder).row(slot);
}

Result<void> fillMatrix(VulkanRecorder& recorder, float value) {
  return static_cast<VulkanGather&>(recorder).fillMatrix(value);
}

}  // namespace ff::runtime
