// What a recorder is told of what slots show beside what they reflect: what they emit, where that has changed, and how what fades is blended.
#pragma once
#include <utility>
#include <vector>

#include "runtime/gather/vk_recorder.h"
#include "runtime/updater.h"

namespace ff::runtime {

// Of one recorder. Nothing takes memory after the start.
class ShownLight {
 public:
  ShownLight() { fading_.reserve(kMaxSlots / 16); }

  // Before each record(), after the updater has told the recorder of the frame's cut and sources.
  Result<void> tell(VulkanRecorder& recorder, const Updater& updater) {
    updater.fade().fadingSlots(updater.matrix(), fading_);
    recorder.setFading(fading_);
    const uint64_t changes = updater.emissionChange() - std::exchange(emission_, updater.emissionChange());
    if (changes == 0) return {};
    return changes == 1 && updater.emissionEntered() ? recorder.setEnteredEmission(updater.emission(), updater.change()) : recorder.setEmission(updater.emission());
  }

 private:
  std::vector<shaders::FadingSlots> fading_;
  uint64_t emission_ = 0;  // Updater::emissionChange() of what the recorder has
};

}  // namespace ff::runtime
