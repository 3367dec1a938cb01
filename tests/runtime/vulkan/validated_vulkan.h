// A Vulkan device under the Khronos layers with synchronisation validation; any message of theirs fails the test.
#pragma once
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "runtime/vulkan/context.h"

namespace ff::runtime {

class ValidatedVulkan : public testing::Test {
 protected:
  void SetUp() override {
    auto c = openVulkan({.device = "auto", .validate = true, .gpu_assisted = false});
    if (!c) GTEST_SKIP() << "no Vulkan device with validation layers, nothing was tested: " << c.error().line();
    context_ = *c;
  }
  void TearDown() override {
    if (!context_) return;
    for (const std::string& message : validationMessages(*context_)) ADD_FAILURE() << message;
  }

  std::shared_ptr<VkContext> context_;
};

}  // namespace ff::runtime
