// The one owner of Vulkan objects: a handle that destroys what it holds.
#pragma once
#include <vulkan/vulkan.h>

#include <utility>

namespace ff::runtime {

// One object of a device; kDestroy is its vkDestroy... or vkFree.... Move-only. Goes only when the device no longer uses the object
// (VkContext::run waits) and before the device itself.
template <class T, void(VKAPI_PTR* kDestroy)(VkDevice, T, const VkAllocationCallbacks*)>
class Handle {
 public:
  Handle() = default;
  Handle(Handle&& other) noexcept { swap(other); }
  Handle& operator=(Handle&& other) noexcept {
    swap(other);
    return *this;
  }
  ~Handle() {
    if (object_) kDestroy(device_, object_, nullptr);
  }

  // Where a vkCreate... of this device writes the object. Once, while there is none.
  T* create(VkDevice device) {
    device_ = device;
    return &object_;
  }
  operator T() const { return object_; }  // VK_NULL_HANDLE: none
  VkDevice device() const { return device_; }

 private:
  void swap(Handle& other) noexcept {
    std::swap(device_, other.device_);
    std::swap(object_, other.object_);
  }
  VkDevice device_ = VK_NULL_HANDLE;
  T object_ = VK_NULL_HANDLE;
};

}  // namespace ff::runtime
