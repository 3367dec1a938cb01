#include "runtime/vk_gather.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "gather_comp.h"
#include "refine_comp.h"
#include "runtime/vk_buffer.h"
#include "runtime/vk_device.h"
#include "runtime/vk_pipeline.h"
#include "shaders/shared.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kGatherBuffers = 6, kRefineBuffers = 3;  // bindings of gather.comp and refine.comp
constexpr int kIterationsPerSubmit = 32;                    // keeps a submission far below a driver's watchdog
constexpr VkPipelineStageFlags kCompute = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
constexpr uint64_t kVectorBytes = 16;

// The matrix as the shader reads it: rows of leaf slots only, each padded to whole uvec4 so that lanes load 16 bytes.
struct PaddedRows {
  // Rows whose entries lie in one bindable range.
  struct Chunk {
    uint32_t first_row = 0, rows = 0;
    uint64_t first_vector = 0, vectors = 0;
  };
  std::vector<shaders::GatherRow> rows;  // `first` counts from the chunk's start
  std::vector<uint32_t> entries;
  std::vector<Chunk> chunks;
};

PaddedRows padRows(const LocalMatrix& m, uint64_t max_vectors, uint64_t align_vectors) {
  PaddedRows p;
  p.entries.reserve(m.entries.size() + size_t{2} * m.slots());
  PaddedRows::Chunk chunk;
  for (uint32_t slot = 0; slot < m.slots(); ++slot) {
    if (!m.leaf[slot]) continue;
    const uint32_t begin = m.row_start[slot], end = begin + m.row_entries[slot];
    const uint32_t vectors = (end - begin + shaders::kEntriesPerLoad - 1) / shaders::kEntriesPerLoad;
    if (chunk.vectors + vectors > max_vectors && chunk.rows > 0) {
      p.chunks.push_back(chunk);
      const uint64_t next =
          (p.entries.size() / shaders::kEntriesPerLoad + align_vectors - 1) / align_vectors * align_vectors;
      p.entries.resize(next * shaders::kEntriesPerLoad, 0);
      chunk = {static_cast<uint32_t>(p.rows.size()), 0, next, 0};
    }
    p.rows.push_back({static_cast<uint32_t>(chunk.vectors), vectors, slot, m.row_scale[slot]});
    p.entries.insert(p.entries.end(), m.entries.begin() + begin, m.entries.begin() + end);
    // A count of zero adds nothing; the last column is already in the cache.
    if (end > begin)
      p.entries.resize((chunk.first_vector + chunk.vectors + vectors) * shaders::kEntriesPerLoad,
                       m.entries[end - 1] & 0xffff0000u);
    chunk.rows += 1;
    chunk.vectors += vectors;
  }
  if (chunk.rows > 0) p.chunks.push_back(chunk);
  return p;
}

class VulkanGather final : public Solver {
 public:
  VulkanGather(std::shared_ptr<VkContext> context, const VulkanGatherSettings& settings, ComputePipeline gather,
               ComputePipeline refine)
      : context_(std::move(context)), gather_(std::move(gather)), refine_(std::move(refine)) {
    const uint64_t limit = context_->limits().maxStorageBufferRange;
    max_binding_bytes_ = settings.max_binding_bytes ? std::min(settings.max_binding_bytes, limit) : limit;
  }

  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change) override;
  Result<void> setRadiosity(std::span<const Vec4> radiosity) override;
  Result<void> setSource(std::span<const Vec4> source) override;
  Result<void> iterate(int k) override;
  Result<void> radiosity(std::span<Vec4> out) override;
  double lastMs() const override { return last_ms_; }
  const char* name() const override { return name_.c_str(); }

 private:
  Result<void> makeSets();
  void recordIteration(VkCommandBuffer commands) const;

  std::shared_ptr<VkContext> context_;  // first: outlives everything below
  ComputePipeline gather_, refine_;
  std::string name_ = "vulkan: " + context_->deviceName();
  uint64_t max_binding_bytes_ = 0;
  Result<void> setMatrix(const LocalMatrix& m, std::span<const Vec4> warm_start);

  const LocalMatrix* matrix_ = nullptr;
  uint32_t slots_ = 0;  // of the buffers
  std::vector<PaddedRows::Chunk> chunks_;
  Buffer rows_, entries_, albedo_area_, source_, refined_;
  Buffer radiosity_[2];
  uint32_t now_ = 0;  // radiosity_[now_] is the current one
  StorageSets sets_;
  std::vector<VkDescriptorSet> gather_sets_[2];  // [now_][chunk]
  VkDescriptorSet refine_set_[2] = {};           // [buffer to refine]
  double last_ms_ = 0;
};

Result<void> VulkanGather::update(const LocalMatrix& m, const MatrixChange& change) {
  const bool all = std::exchange(matrix_, &m) != &m || change.renumbered;
  std::vector<Vec4> start(all ? 0 : slots_);
  if (!all)
    if (auto read = radiosity(start); !read) return read;
  start.resize(m.slots());
  for (const uint32_t t : change.entered) {  // parents first
    const SlotRange& range = m.tiles[t];
    for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s)
      start[s] = m.parent_slot[s] != kNoSlot ? start[m.parent_slot[s]] : Vec4{};
  }
  return setMatrix(m, start);
}

Result<void> VulkanGather::setRadiosity(std::span<const Vec4> radiosity) {
  FF_CHECK_EQ(radiosity.size(), size_t{slots_});
  return upload(*context_, radiosity_[now_], 0, std::as_bytes(radiosity));
}

Result<void> VulkanGather::setMatrix(const LocalMatrix& m, std::span<const Vec4> warm_start) {
  FF_CHECK_LT(0u, m.slots());
  if (!warm_start.empty()) FF_CHECK_EQ(warm_start.size(), size_t{m.slots()});
  const uint64_t align = std::max(kVectorBytes, uint64_t{context_->limits().minStorageBufferOffsetAlignment});
  PaddedRows padded = padRows(m, max_binding_bytes_ / kVectorBytes, align / kVectorBytes);
  for (const auto& c : padded.chunks)
    if (c.vectors * kVectorBytes > max_binding_bytes_)
      return Error{ErrorCode::kUsage, "", "vulkan", "one row of the matrix exceeds max_binding_bytes", "raise it"};

  std::vector<Vec4> albedo_area(m.albedo);
  for (uint32_t i = 0; i < m.slots(); ++i) albedo_area[i].w = m.area_m2[i];
  std::vector<shaders::RefinedSlot> refined;
  refined.reserve(m.refined.size());
  for (const auto& r : m.refined) refined.push_back({r.slot, r.first_child, r.children});
  const std::vector<Vec4> zero(m.slots());

  // New buffers replace the old ones only when all of them exist, so that a failure leaves the last matrix in place.
  auto rows = makeBuffer(*context_, std::span<const shaders::GatherRow>(padded.rows));
  auto entries = makeBuffer(*context_, std::span<const uint32_t>(padded.entries));
  auto albedo = makeBuffer(*context_, std::span<const Vec4>(albedo_area));
  auto refined_list = makeBuffer(*context_, std::span<const shaders::RefinedSlot>(refined));
  auto source = makeBuffer(*context_, std::span<const Vec4>(zero));
  auto first = makeBuffer(*context_, warm_start.empty() ? std::span<const Vec4>(zero) : warm_start);
  auto second = makeBuffer(*context_, std::span<const Vec4>(zero));
  for (auto* b : {&rows, &entries, &albedo, &refined_list, &source, &first, &second})
    if (!*b) return b->error();
  rows_ = std::move(*rows);
  entries_ = std::move(*entries);
  albedo_area_ = std::move(*albedo);
  refined_ = std::move(*refined_list);
  source_ = std::move(*source);
  radiosity_[0] = std::move(*first);
  radiosity_[1] = std::move(*second);
  now_ = 0;
  chunks_ = std::move(padded.chunks);
  slots_ = m.slots();
  return makeSets();
}

Result<void> VulkanGather::makeSets() {
  const auto chunks = static_cast<uint32_t>(chunks_.size());
  auto sets = StorageSets::create(*context_, 2 * chunks + 2, 2 * chunks * kGatherBuffers + 2 * kRefineBuffers);
  if (!sets) return sets.error();
  sets_ = std::move(*sets);
  const auto whole = [](const Buffer& b) { return VkDescriptorBufferInfo{b.handle(), 0, VK_WHOLE_SIZE}; };
  for (uint32_t now = 0; now < 2; ++now) {
    gather_sets_[now].clear();
    for (const auto& c : chunks_) {
      const VkDescriptorBufferInfo range{entries_.handle(), c.first_vector * kVectorBytes,
                                         std::max<uint64_t>(c.vectors, 1) * kVectorBytes};
      const VkDescriptorBufferInfo buffers[kGatherBuffers] = {
          whole(rows_), range, whole(albedo_area_), whole(source_), whole(radiosity_[now]), whole(radiosity_[1 - now])};
      auto set = sets_.make(gather_.setLayout(), buffers);
      if (!set) return set.error();
      gather_sets_[now].push_back(*set);
    }
    const VkDescriptorBufferInfo buffers[kRefineBuffers] = {whole(refined_), whole(albedo_area_),
                                                            whole(radiosity_[now])};
    auto set = sets_.make(refine_.setLayout(), buffers);
    if (!set) return set.error();
    refine_set_[now] = *set;
  }
  return {};
}

Result<void> VulkanGather::setSource(std::span<const Vec4> source) {
  FF_CHECK_EQ(source.size(), size_t{slots_});
  return upload(*context_, source_, 0, std::as_bytes(source));
}

void VulkanGather::recordIteration(VkCommandBuffer commands) const {
  const uint32_t max_groups = context_->limits().maxComputeWorkGroupCount[0];
  const uint32_t rows_per_group = std::max(1u, shaders::kGatherGroup / std::max(1u, context_->subgroupSize()));
  for (size_t i = 0; i < chunks_.size(); ++i) {  // chunks write different slots: no barrier between them
    const shaders::GatherPush push{chunks_[i].first_row, chunks_[i].rows};
    gather_.dispatch(commands, gather_sets_[now_][i], &push,
                     std::min((push.rows + rows_per_group - 1) / rows_per_group, max_groups));
  }
  for (size_t l = 0; l + 1 < matrix_->refined_level_start.size(); ++l) {
    const shaders::RefinePush push{matrix_->refined_level_start[l],
                                   matrix_->refined_level_start[l + 1] - matrix_->refined_level_start[l]};
    if (push.count == 0) continue;
    barrier(commands, kCompute, VK_ACCESS_SHADER_WRITE_BIT, kCompute, VK_ACCESS_SHADER_READ_BIT);
    refine_.dispatch(commands, refine_set_[1 - now_], &push,
                     (push.count + shaders::kRefineGroup - 1) / shaders::kRefineGroup);
  }
  // The next iteration reads what this one wrote, and overwrites what this one read.
  barrier(commands, kCompute, VK_ACCESS_SHADER_WRITE_BIT, kCompute,
          VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT);
}

Result<void> VulkanGather::iterate(int k) {
  last_ms_ = 0;
  for (int done = 0; done < k;) {
    const int n = std::min(k - done, kIterationsPerSubmit);
    auto ms = context_->run([&](VkCommandBuffer commands) {
      for (int i = 0; i < n; ++i) {
        recordIteration(commands);
        now_ = 1 - now_;
      }
    });
    if (!ms) return ms.error();
    last_ms_ += *ms;
    done += n;
  }
  return {};
}

Result<void> VulkanGather::radiosity(std::span<Vec4> out) {
  FF_CHECK_EQ(out.size(), size_t{slots_});
  return download(*context_, radiosity_[now_], 0, std::as_writable_bytes(out));
}

}  // namespace

Result<std::unique_ptr<Solver>> makeVulkanGather(std::shared_ptr<VkContext> context,
                                                 const VulkanGatherSettings& settings) {
  auto gather = ComputePipeline::create(*context, gather_comp, kGatherBuffers, sizeof(shaders::GatherPush));
  if (!gather) return gather.error();
  auto refine = ComputePipeline::create(*context, refine_comp, kRefineBuffers, sizeof(shaders::RefinePush));
  if (!refine) return refine.error();
  return std::unique_ptr<Solver>(
      std::make_unique<VulkanGather>(std::move(context), settings, std::move(*gather), std::move(*refine)));
}

}  // namespace ff::runtime
