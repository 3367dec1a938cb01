// What may follow the rows' part of each step of the Vulkan gather, before refined slots become the means of their
// children: dense/vk_dense_step.h. Everything is recorded where the gather records; nothing waits.
#pragma once
#include <vulkan/vulkan.h>

#include <memory>

#include "runtime/dense/dense_solver.h"
#include "runtime/gather/vk_recorder.h"

namespace ff::runtime {

struct GatherBuffers {  // by slot
  VkBuffer kinds, albedo, source, radiosity[2];
  uint32_t slots;  // room in each
  uint32_t frames_in_flight;
};

class GatherCorrection {
 public:
  virtual ~GatherCorrection() = default;
  virtual Result<void> start(const GatherBuffers& buffers) = 0;
  // As Solver::update(); afresh: all of it is new.
  virtual void update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh) = 0;
  // A record() into region `frame` of the ring, whose last commands have finished; the gather's own buffers are up to
  // date. disturbed: the cut or the radiosity are not those that the last record left. No iterations: the matrix may be
  // another one by now, and its update() still to come. Returns whether radiosity has to start from zero.
  virtual bool recordChange(VkCommandBuffer commands, uint32_t frame, int iterations, bool disturbed) = 0;
  // radiosity[1 - now] has M + C F radiosity[now]. Ends separated.
  virtual void recordStep(VkCommandBuffer commands, uint32_t now, bool first) = 0;
  virtual void recordEnd(VkCommandBuffer commands, uint32_t frame, int iterations) = 0;
  virtual const DenseStats& stats() const = 0;
  virtual double residual() const = 0;  // VulkanRecorder::residual()
  virtual uint64_t uploadedBytes() const = 0;  // since the start
  virtual const char* name() const = 0;
  virtual Result<void> fillMatrix(float value) = 0;  // for tests: spoils it; waits
};

Result<std::unique_ptr<VulkanRecorder>> makeVulkanRecorder(std::shared_ptr<VkContext> context,
                                                           const VulkanGatherSettings& settings,
                                                           std::unique_ptr<GatherCorrection> correction);

}  // namespace ff::runtime
