#include "runtime/dense/vk_dense_step.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "bounce_correct_comp.h"
#include "bounce_residual_comp.h"
#include "runtime/dense/bounce_monitor.h"
#include "runtime/dense/vk_bounce_steps.h"
#include "runtime/vulkan/device.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kFewestProbed = 16;  // nodes on places: one for each sixteenth

class DenseStep final : public GatherCorrection {
 public:
  DenseStep(std::shared_ptr<VkContext> context, std::unique_ptr<VulkanBounceSteps> steps, uint32_t blocks)
      : context_(std::move(context)),
        steps_(std::move(steps)),
        blocks_(blocks),
        places_(steps_->settings().places),
        probe_(steps_->settings().places, defaultProbeLimit(steps_->name())),
        probe_y_(steps_->settings().places),
        entered_by_(steps_->settings().places),
        name_("dense: " + steps_->name()) {}

  Result<void> start(const GatherBuffers& buffers) override;
  void update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh) override;
  bool recordChange(VkCommandBuffer c, uint32_t frame, int iterations, bool disturbed) override;
  void recordStep(VkCommandBuffer c, uint32_t now, bool first) override;
  void recordEnd(VkCommandBuffer c, uint32_t frame, int iterations) override;
  const DenseStats& stats() const override { return stats_; }
  double residual() const override { return residual_; }
  uint64_t uploadedBytes() const override { return uploaded_bytes_; }
  const char* name() const override { return name_.c_str(); }
  Result<void> fillMatrix(float value) override;

 private:
  // What a frame in flight will bring back, in this order: the status of each block that enters, `corrupt`, y of the
  // probe, sums.
  struct Region {
    bool recorded = false, measured = false, comparable = false, rebuilding = false, probed = false;
    uint32_t slots = 0, blocks = 0;
    uint64_t generation = 0, first_block = 0;
  };
  // A staging region: the slots by place; x of the probe and the places that it is not 0 at; what blocks need.
  uint64_t channelBytes() const { return uint64_t{steps_->stride()} * sizeof(float); }
  uint64_t blocksAt() const { return 5 * channelBytes(); }
  uint64_t upBytes() const { return blocksAt() + steps_->maxWords() * sizeof(uint32_t); }
  uint64_t probeAt() const { return (blocks_ + 1) * sizeof(uint32_t); }
  uint64_t sumsAt() const { return probeAt() + 3 * channelBytes(); }
  uint64_t backBytes() const {
    return sumsAt() + groupsOf(slots_room_, shaders::kBounceGroup) * sizeof(shaders::StepSums);
  }
  void read(uint32_t frame, bool may_judge);
  bool addUp(Region& region, const std::byte* sums);
  void watch(const Region& region);
  void judge(const std::byte* y);
  void recordProbe(VkCommandBuffer c, uint32_t frame);
  void forget();
  void startOver(std::string why);
  void recordLeaving(VkCommandBuffer c, uint32_t frame);
  void recordEntering(VkCommandBuffer c, uint32_t frame);
  void recordBlock(VkCommandBuffer c, const VulkanBounceSteps::Block& block, uint32_t frame);
  // Words of the frame's staging region, from where it is still free.
  uint32_t* room(uint32_t frame) {
    return reinterpret_cast<uint32_t*>(up_.mapped() + frame * upBytes() + blocksAt()) + words_used_;
  }
  uint64_t wordsLeft() const { return steps_->maxWords() - words_used_; }

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  std::unique_ptr<VulkanBounceSteps> steps_;
  ComputePipeline residual_pass_, correct_;
  Buffer slots_, last_source_, sums_, up_, back_;
  StorageSets sets_;
  VkDescriptorSet residual_set_[2] = {}, correct_set_[2] = {};  // [now]: before the step
  uint32_t slots_room_ = 0;
  const uint32_t blocks_;  // that enter a frame

  const LocalMatrix* matrix_ = nullptr;
  CutPlaces places_;
  SparseRows rows_{1};  // for the probe, on the caller's thread
  BounceMonitor probe_;
  std::vector<Vec4> probe_y_;  // by place
  bool probing_ = false;       // one is on its way
  bool probe_holds_ = false;   // and its places and rows are still those that it was drawn for
  bool rows_hold_ = false;     // rows_ has taken up the matrix
  std::vector<uint64_t> entered_by_;  // per place: the number of the block that it entered by
  std::vector<Region> regions_;
  uint64_t block_ = 0;       // number of the last block that entered
  uint64_t generation_ = 0;  // of the matrix: how often it was cleared
  uint64_t words_used_ = 0;  // of the staging region
  uint64_t uploaded_bytes_ = 0;
  bool clear_ = false, restart_ = false, places_changed_ = true, rebuilding_ = false, disturbed_ = false;
  double before_ = -1;  // the residual that came back last; -1: not to be compared with
  double residual_ = -1;
  DenseStats stats_;
  std::string name_;
};

Result<void> DenseStep::start(const GatherBuffers& buffers) {
  slots_room_ = buffers.slots;
  regions_.resize(buffers.frames_in_flight);
  struct Wanted {
    Buffer* buffer;
    uint64_t bytes;
    MemoryUse use = MemoryUse::kDevice;
  };
  const Wanted list[] = {
      {&slots_, steps_->stride() * sizeof(uint32_t)},
      {&last_source_, slots_room_ * sizeof(Vec4)},
      {&sums_, groupsOf(std::max(slots_room_, steps_->stride()), shaders::kBounceGroup) * sizeof(shaders::StepSums)},
      {&up_, upBytes() * regions_.size(), MemoryUse::kHost},
      {&back_, backBytes() * regions_.size(), MemoryUse::kHost}};
  for (const Wanted& w : list) {
    auto b = Buffer::create(*context_, w.bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, w.use);
    if (!b) return b.error();
    *w.buffer = std::move(*b);
  }
  const auto whole = [](VkBuffer b) { return VkDescriptorBufferInfo{b, 0, VK_WHOLE_SIZE}; };
  constexpr uint32_t kResidualBuffers = 8, kCorrectBuffers = 5;
  auto residual =
      ComputePipeline::create(*context_, bounce_residual_comp, kResidualBuffers, sizeof(shaders::CorrectPush));
  if (!residual) return residual.error();
  residual_pass_ = std::move(*residual);
  auto correct = ComputePipeline::create(*context_, bounce_correct_comp, kCorrectBuffers, sizeof(shaders::CorrectPush));
  if (!correct) return correct.error();
  correct_ = std::move(*correct);
  auto sets = StorageSets::create(*context_, 4, 2 * (kResidualBuffers + kCorrectBuffers));
  if (!sets) return sets.error();
  sets_ = std::move(*sets);
  const VkDescriptorBufferInfo slots = whole(slots_.handle()), vectors = whole(steps_->vectors().handle());
  for (uint32_t now = 0; now < 2; ++now) {
    const VkDescriptorBufferInfo before = whole(buffers.radiosity[now]), after = whole(buffers.radiosity[1 - now]);
    const VkDescriptorBufferInfo read[kResidualBuffers] = {slots,
                                                           before,
                                                           after,
                                                           whole(buffers.source),
                                                           whole(last_source_.handle()),
                                                           whole(buffers.kinds),
                                                           vectors,
                                                           whole(sums_.handle())};
    const VkDescriptorBufferInfo written[kCorrectBuffers] = {slots, vectors, whole(buffers.albedo), after,
                                                             whole(steps_->status().handle())};
    auto residual_set = sets_.make(residual_pass_.setLayout(), read);
    if (!residual_set) return residual_set.error();
    residual_set_[now] = *residual_set;
    auto correct_set = sets_.make(correct_.setLayout(), written);
    if (!correct_set) return correct_set.error();
    correct_set_[now] = *correct_set;
  }
  auto cleared = context_->run([&](VkCommandBuffer c) {
    vkCmdFillBuffer(c, slots_.handle(), 0, VK_WHOLE_SIZE, kNoSlot);
    vkCmdFillBuffer(c, last_source_.handle(), 0, VK_WHOLE_SIZE, 0);
    vkCmdFillBuffer(c, sums_.handle(), 0, VK_WHOLE_SIZE, 0);
  });
  if (!cleared) return cleared.error();
  return {};
}

void DenseStep::update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh) {
  matrix_ = &matrix;
  const auto leaving = places_.update(matrix, change, afresh);
  stats_.left += leaving.size();
  if (!leaving.empty()) probe_.nodesLeft();
  if (afresh) {
    clear_ = true;
    ++generation_;
    probe_.builtAnew();
  }
  probe_holds_ = rows_hold_ = false;
  places_changed_ = true;
}

// The matrix is empty from the next record on; its leaves wait. What older frames bring back is of no interest.
void DenseStep::forget() {
  places_.clear();
  clear_ = places_changed_ = true;
  ++generation_;
  before_ = -1;
  probe_.builtAnew();
  probe_holds_ = false;
}

void DenseStep::startOver(std::string why) {
  ++stats_.rebuilds;
  stats_.last_event = std::move(why);
  rebuilding_ = true;
  forget();
}

// What the region's last frame has brought back. The rows may be read if may_judge.
void DenseStep::read(uint32_t frame, bool may_judge) {
  Region& region = regions_[frame];
  if (region.probed) probing_ = false;
  if (!std::exchange(region.recorded, false) || region.generation != generation_) return;
  const std::byte* const back = back_.mapped() + frame * backBytes();
  const auto word = [&](uint32_t at) {
    uint32_t value = 0;
    std::memcpy(&value, back + at * sizeof(value), sizeof(value));
    return value;
  };
  if (region.measured && !addUp(region, back + sumsAt())) {  // nothing of B can be kept
    restart_ = true;
    return startOver("radiosity was not finite");
  }
  if (const uint32_t corrupt = word(blocks_); corrupt != 0)
    return startOver(corrupt == shaders::kSpoiltPrecision ? whyRefused(true) : "the matrix is not finite");
  for (uint32_t b = 0; b < region.blocks; ++b) {
    if (word(b) == 0) continue;
    for (uint32_t place = 0; place < entered_by_.size(); ++place)
      if (entered_by_[place] == region.first_block + b && places_.slotOf(place) != kNoSlot) places_.giveUp(place);
    places_changed_ = true;
    probe_holds_ = false;
    probe_.nodesLeft();
    ++stats_.refused;
    stats_.last_event = whyRefused(false);
  }
  if (region.measured) watch(region);
  if (region.probed && probe_holds_ && may_judge) judge(back + probeAt());
}

// Whether they are finite.
bool DenseStep::addUp(Region& region, const std::byte* sums) {
  double left = 0, norm = 0;
  float largest_left = 0, largest = 0;
  for (uint32_t g = 0; g < groupsOf(region.slots, shaders::kBounceGroup); ++g) {
    shaders::StepSums s;
    std::memcpy(&s, sums + g * sizeof(s), sizeof(s));
    left += static_cast<double>(s.left);
    norm += static_cast<double>(s.norm);
    largest_left = std::max(largest_left, s.largest_left);
    largest = std::max(largest, s.largest);
    region.comparable = region.comparable && s.relit == 0;
  }
  if (!std::isfinite(left + norm)) return false;
  residual_ = largest > 0 ? static_cast<double>(largest_left / largest) : 0;
  stats_.residual = norm > 0 ? std::sqrt(left / norm) : 0;
  return true;
}

void DenseStep::watch(const Region& region) {
  const double before = std::exchange(before_, stats_.residual);
  if (!region.comparable || region.rebuilding) return;
  if (std::string why = whyGrown(before, stats_.residual); !why.empty()) startOver(std::move(why));
}

void DenseStep::judge(const std::byte* y) {
  const auto channel = [&](size_t c, size_t place) {
    float e = 0;
    std::memcpy(&e, y + c * channelBytes() + place * sizeof(e), sizeof(e));
    return e;
  };
  if (!std::exchange(rows_hold_, true)) rows_.takeUp(*matrix_);
  for (size_t p = 0; p < probe_y_.size(); ++p) probe_y_[p] = {channel(0, p), channel(1, p), channel(2, p), 0};
  probe_.judge(*matrix_, places_, rows_, probe_y_);
  stats_.probe = probe_.round();
  if (!probe_.verdict().empty()) startOver(probe_.verdict());
}

// After the frame's steps: the vectors are free again, and the last block's description with them.
void DenseStep::recordProbe(VkCommandBuffer c, uint32_t frame) {
  probe_.draw(places_);
  const uint64_t from = frame * upBytes() + channelBytes();
  auto* const x = reinterpret_cast<float*>(up_.mapped() + from);
  std::memset(x, 0, 3 * channelBytes());
  const std::span<const uint32_t> drawn = probe_.places();
  for (size_t i = 0; i < drawn.size(); ++i) {
    const Vec4& v = probe_.x()[i];
    x[drawn[i]] = v.x;
    x[steps_->stride() + drawn[i]] = v.y;
    x[2 * steps_->stride() + drawn[i]] = v.z;
  }
  std::memcpy(x + 3 * steps_->stride(), drawn.data(), drawn.size_bytes());
  uploaded_bytes_ += 3 * channelBytes() + drawn.size_bytes();
  // Luminance needs all columns after its first product.
  const uint32_t columns = steps_->settings().luminance ? 0 : static_cast<uint32_t>(drawn.size());
  steps_->recordLight(c, up_.handle(), from, columns);
  separate(c);
  steps_->recordProduct(c, columns);
  steps_->recordIrradiance(c, back_.handle(), frame * backBytes() + probeAt());
  regions_[frame].probed = probing_ = probe_holds_ = true;
}

bool DenseStep::recordChange(VkCommandBuffer c, uint32_t frame, int iterations, bool disturbed) {
  read(frame, iterations > 0);
  Region& region = regions_[frame];
  region = {};
  disturbed_ = disturbed_ || disturbed;
  region.comparable = !disturbed_;
  if (iterations > 0) disturbed_ = false;
  region.rebuilding = rebuilding_;
  words_used_ = 0;
  // Nodes that enter cost as much as nodes that leave, and may wait.
  const size_t leaving = places_.givenUp().size();
  const uint64_t leaving_words = groupsOf(static_cast<uint32_t>(leaving), kMaxBlock) * steps_->wordsOf({});
  if ((leaving > size_t{4} * kMaxBlock && leaving > places_.taken()) || leaving_words > wordsLeft()) forget();
  if (clear_) {
    steps_->recordClear(c);
    separate(c);
    clear_ = false;
  }
  region.generation = generation_;
  recordLeaving(c, frame);
  if (iterations > 0) recordEntering(c, frame);
  if (std::exchange(places_changed_, false)) {
    const std::span<const uint32_t> slots = places_.slots();
    std::memcpy(up_.mapped() + frame * upBytes(), slots.data(), slots.size_bytes());
    const VkBufferCopy copy{frame * upBytes(), 0, slots.size_bytes()};
    vkCmdCopyBuffer(c, up_.handle(), slots_.handle(), 1, &copy);
    uploaded_bytes_ += copy.size;
    separate(c);
  }
  rebuilding_ = rebuilding_ && places_.waiting() > 0;
  stats_.waiting = places_.waiting();
  stats_.on_places = places_.taken();
  return std::exchange(restart_, false);
}

void DenseStep::recordBlock(VkCommandBuffer c, const VulkanBounceSteps::Block& block, uint32_t frame) {
  const uint64_t offset = frame * upBytes() + blocksAt() + words_used_ * sizeof(uint32_t);
  words_used_ += block.words;
  uploaded_bytes_ += block.words * sizeof(uint32_t);
  steps_->recordUpload(c, block, up_.handle(), offset);
  separate(c);
  steps_->recordChange(c, block);
  separate(c);
}

void DenseStep::recordLeaving(VkCommandBuffer c, uint32_t frame) {
  const std::span<const uint32_t> leaving = places_.givenUp();
  for (size_t first = 0; first < leaving.size(); first += kMaxBlock) {
    const auto some = leaving.subspan(first, std::min<size_t>(kMaxBlock, leaving.size() - first));
    recordBlock(c, steps_->describe(some, room(frame)), frame);
  }
  places_.forgetGivenUp();
}

void DenseStep::recordEntering(VkCommandBuffer c, uint32_t frame) {
  if (places_.waiting() == 0) return;
  Region& region = regions_[frame];
  region.first_block = block_ + 1;
  const uint32_t chosen = places_.choose(uint64_t{blocks_} * kMaxBlock);
  for (uint32_t first = 0; first < chosen; first += kMaxBlock) {
    const uint32_t count = std::min(kMaxBlock, chosen - first);
    const EnteringBlock block = places_.take(first, count);
    if (steps_->wordsOf(block) > wordsLeft()) {
      places_.unseat(first, count, false);
      return;
    }
    const auto described = steps_->describe(block, room(frame));
    if (!described) {
      places_.unseat(first, count, true);
      ++stats_.refused;
      stats_.last_event = described.error().line();
      continue;
    }
    ++block_;
    for (const uint32_t place : block.places) entered_by_[place] = block_;
    recordBlock(c, *described, frame);
    const VkBufferCopy status{0, frame * backBytes() + region.blocks++ * sizeof(uint32_t), sizeof(uint32_t)};
    vkCmdCopyBuffer(c, steps_->status().handle(), back_.handle(), 1, &status);
    separate(c);
    stats_.entered += count;
    places_changed_ = true;
  }
}

void DenseStep::recordStep(VkCommandBuffer c, uint32_t now, bool first) {
  const shaders::CorrectPush push{steps_->stride(), matrix_->slots(), first};
  const uint32_t groups = groupsOf(std::max(matrix_->slots(), steps_->stride()), shaders::kBounceGroup);
  residual_pass_.dispatch(c, residual_set_[now], &push, groups);
  separate(c);
  if (places_.taken() == 0) return;
  steps_->recordProduct(c, 0);
  correct_.dispatch(c, correct_set_[now], &push, groupsOf(steps_->stride(), shaders::kBounceGroup));
  separate(c);
}

void DenseStep::recordEnd(VkCommandBuffer c, uint32_t frame, int iterations) {
  Region& region = regions_[frame];
  region.recorded = true;
  region.measured = iterations > 0;
  region.slots = region.measured ? matrix_->slots() : 0;
  if (region.measured && !probing_ && !rebuilding_ && places_.taken() >= kFewestProbed) recordProbe(c, frame);
  const VkBufferCopy corrupt{sizeof(uint32_t), frame * backBytes() + blocks_ * sizeof(uint32_t), sizeof(uint32_t)};
  vkCmdCopyBuffer(c, steps_->status().handle(), back_.handle(), 1, &corrupt);
  if (region.measured) {
    const VkBufferCopy sums{0, frame * backBytes() + sumsAt(),
                            groupsOf(region.slots, shaders::kBounceGroup) * sizeof(shaders::StepSums)};
    vkCmdCopyBuffer(c, sums_.handle(), back_.handle(), 1, &sums);
  }
  barrier(c, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_ACCESS_TRANSFER_WRITE_BIT, VK_PIPELINE_STAGE_HOST_BIT,
          VK_ACCESS_HOST_READ_BIT);
}

Result<void> DenseStep::fillMatrix(float value) {
  auto filled = context_->run([&](VkCommandBuffer c) { steps_->recordFill(c, value); });
  return filled ? Result<void>() : filled.error();
}

}  // namespace

Result<std::unique_ptr<GatherCorrection>> makeVulkanDenseStep(std::shared_ptr<VkContext> context,
                                                              const MultibounceSettings& settings, uint32_t blocks) {
  MultibounceSettings whole = settings;
  whole.time_slice = false;
  auto steps = VulkanBounceSteps::create(context, whole);
  if (!steps) return steps.error();
  return std::unique_ptr<GatherCorrection>(std::make_unique<DenseStep>(std::move(context), std::move(*steps), blocks));
}

Result<std::unique_ptr<VulkanRecorder>> makeVulkanDenseRecorder(std::shared_ptr<VkContext> context,
                                                                const VulkanGatherSettings& room,
                                                                const MultibounceSettings& settings) {
  auto step = makeVulkanDenseStep(context, settings);
  if (!step) return step.error();
  return makeVulkanRecorder(std::move(context), room, std::move(*step));
}

}  // namespace ff::runtime
