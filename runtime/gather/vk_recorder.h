// Solvers for engines, gather and the dense one with all bounces: a frame's work goes into the caller's command buffer,
// nothing waits.
//
// Per frame: update() where the cut changed, setSource() where the light changed, then record(). These write to a ring
// of `frames_in_flight` staging regions: when a frame begins, the command buffer recorded frames_in_flight records ago
// must have finished. Command buffers must run in the order in which they were recorded, on one queue.
#pragma once
#include <vulkan/vulkan.h>

#include <memory>

#include "runtime/dense/dense_solver.h"
#include "runtime/gather/vk_gather.h"
#include "shaders/shared.h"

namespace ff::runtime {

class VkContext;

class VulkanRecorder : public Solver {
 public:
  // Records uploads, resolving and k iterations, outside of a render pass. What it writes is visible to all later commands.
  // A second update() before a record() waits for the device to take up the first; so does radiosity().
  virtual Result<void> record(VkCommandBuffer commands, int iterations) = 0;
  // What slots emit, a vec4 each, W/m2: from the next record() on it is added to what radiosityBuffer() holds, and to nothing
  // else. After an update() it has to be set again, in one of these two ways.
  virtual Result<void> setEmission(std::span<const Vec4> emission) = 0;
  // The same where only nodes that entered by the last update() have other values than were given before.
  virtual Result<void> setEnteredEmission(std::span<const Vec4> emission, const MatrixChange& change) = 0;
  // In what the next record() leaves in radiosityBuffer(), and in that alone: how much of what these slots reflect is their own, from 0 to 1; the
  // rest is what their parents show, as the same irradiance on the slots' albedo (cut_fade.h). Once a record(), of as many tiles as there is room for at most.
  virtual void setFading(std::span<const shaders::FadingSlots> fading) = 0;
  // Radiosity per slot after the last recorded iteration, reflected and emitted: a vec4 each (w is 0), W/m2. Always the same
  // buffer.
  virtual VkBuffer radiosityBuffer() const = 0;
  // The same without what slots emit, as the last record() leaves it; another buffer after the next.
  virtual VkBuffer reflectedBuffer() const = 0;
  // M per slot, a vec4 each: what setSource() fills, and setEnteredSource() for what entered. The caller's shaders may write it instead, between records.
  virtual VkBuffer sourceBuffer() const = 0;
  // As lastMs(), of what the last record() did before its iterations: uploads, resolving, warm start.
  virtual double lastChangeMs() const = 0;
  // Largest |M + C F B - B| over the largest B of any channel, before the last step of the record frames_in_flight ago,
  // over all leaves; negative: not measured (gather never is).
  virtual double residual() const = 0;
  virtual const DenseStats* dense() const = 0;  // null: gather. Lags by frames_in_flight records.
};

Result<std::unique_ptr<VulkanRecorder>> makeVulkanRecorder(std::shared_ptr<VkContext> context,
                                                           const VulkanGatherSettings& settings = {});

// The same with all bounces in a step (dense/vk_dense_step.h): leaves enter a dense matrix, kRebuildBlocks blocks a
// record. Errors: those of both.
Result<std::unique_ptr<VulkanRecorder>> makeVulkanDenseRecorder(std::shared_ptr<VkContext> context,
                                                                const VulkanGatherSettings& room,
                                                                const MultibounceSettings& settings);

// For tests: the entries of a slot's row as the device resolved them. Waits.
Result<std::vector<uint32_t>> resolvedRow(VulkanRecorder& recorder, uint32_t slot);
// For tests: spoils the matrix of a dense recorder. Waits.
Result<void> fillMatrix(VulkanRecorder& recorder, float value);

}  // namespace ff::runtime
