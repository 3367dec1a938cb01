// Device memory: a few big allocations per memory type, cut up by RangeAllocator; buffers and images on top of it.
// There is one way for bytes to and from the device on every machine: through a staging buffer and copies. (Devices
// whose memory the host can map could do without, but a path that only some machines take is a path that few test.)
#pragma once
#include <vulkan/vulkan.h>

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "formats/result.h"
#include "runtime/cut/range_allocator.h"
#include "runtime/vulkan/handle.h"

namespace ff::runtime {

class VkContext;
class VkHeap;

enum class MemoryUse {
  kDevice,  // fast for the device, not mapped
  kHost,    // mapped and coherent: staging, read-back
};

// A range of a block of the heap's, to which it goes back. Move-only.
class Allocation {
 public:
  Allocation() = default;
  Allocation(Allocation&& other) noexcept { swap(other); }
  Allocation& operator=(Allocation&& other) noexcept {
    swap(other);
    return *this;
  }
  ~Allocation();
  VkDeviceMemory memory() const { return memory_; }
  uint64_t offset() const { return offset_; }
  std::byte* mapped() const { return mapped_; }  // kHost only

 private:
  friend class VkHeap;
  Allocation(VkHeap& heap, VkDeviceMemory memory, uint64_t offset, uint64_t size, std::byte* mapped, size_t block)
      : heap_(&heap), memory_(memory), offset_(offset), size_(size), mapped_(mapped), block_(block) {}
  void swap(Allocation& other) noexcept;
  VkHeap* heap_ = nullptr;
  VkDeviceMemory memory_ = VK_NULL_HANDLE;
  uint64_t offset_ = 0, size_ = 0;
  std::byte* mapped_ = nullptr;
  size_t block_ = 0;
};

// Not thread-safe.
class VkHeap {
 public:
  explicit VkHeap(VkContext& context);
  // Errors (kOutOfDeviceMemory): the device refuses, the heap is full, or the context's memory_bytes would be passed.
  // linear: buffers; otherwise images. The two never share a block, so bufferImageGranularity cannot be violated.
  Result<Allocation> allocate(const VkMemoryRequirements& needs, MemoryUse use, bool linear);
  uint64_t allocatedBytes() const { return allocated_bytes_; }

 private:
  friend class Allocation;
  struct Block {
    Handle<VkDeviceMemory, vkFreeMemory> memory;
    uint32_t type;
    bool linear;
    std::byte* mapped;
    uint64_t size;
    RangeAllocator ranges;
  };
  Allocation allocationOf(size_t block, uint64_t offset, uint64_t size);
  void release(const Allocation& allocation);
  uint64_t bytesLeft(uint32_t type) const;
  void freeBlock(std::unique_ptr<Block>& block);
  void freeEmptyBlocks();
  VkContext& context_;
  VkPhysicalDeviceMemoryProperties properties_{};
  std::vector<std::unique_ptr<Block>> blocks_;  // null where a block was given back
  uint64_t allocated_bytes_ = 0;
};

// Owns a VkBuffer and its memory; move-only. Destroy only when the device no longer uses it (VkContext::run waits).
class Buffer {
 public:
  // bytes > 0; transfer source and destination are always among the usages.
  static Result<Buffer> create(VkContext& context, uint64_t bytes, VkBufferUsageFlags usage,
                               MemoryUse use = MemoryUse::kDevice);
  VkBuffer handle() const { return buffer_; }
  uint64_t bytes() const { return bytes_; }
  std::byte* mapped() const { return allocation_.mapped(); }

 private:
  Allocation allocation_;  // first: goes last
  Handle<VkBuffer, vkDestroyBuffer> buffer_;
  uint64_t bytes_ = 0;
};

// Two-dimensional, one mip level, optimal tiling, with a view of the whole.
class Image {
 public:
  static Result<Image> create(VkContext& context, VkExtent2D extent, VkFormat format, VkImageUsageFlags usage,
                              VkImageAspectFlags aspect);
  VkImage handle() const { return image_; }
  VkImageView view() const { return view_; }
  VkExtent2D extent() const { return extent_; }
  VkFormat format() const { return format_; }

 private:
  Allocation allocation_;  // first: goes last
  Handle<VkImage, vkDestroyImage> image_;
  Handle<VkImageView, vkDestroyImageView> view_;
  VkExtent2D extent_{};
  VkFormat format_ = VK_FORMAT_UNDEFINED;
};

// Copy bytes to or from a device buffer in pieces of at most 16 MiB and wait.
Result<void> upload(VkContext& context, const Buffer& to, uint64_t offset, std::span<const std::byte> bytes);
Result<void> download(VkContext& context, const Buffer& from, uint64_t offset, std::span<std::byte> bytes);

// A device buffer (storage, plus `usage`) that holds `values`; at least one element is allocated, so that an empty list
// can be bound.
template <class T>
Result<Buffer> makeBuffer(VkContext& context, std::span<const T> values, VkBufferUsageFlags usage = 0) {
  auto b = Buffer::create(context, std::max<uint64_t>(values.size_bytes(), std::max<uint64_t>(sizeof(T), 16)),
                          usage | VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
  if (!b) return b;
  if (!values.empty())
    if (auto r = upload(context, *b, 0, std::as_bytes(values)); !r) return r.error();
  return b;
}

// All earlier writes by shaders and copies become visible to later shaders and copies.
void barrier(VkCommandBuffer commands, VkPipelineStageFlags from, VkAccessFlags wrote, VkPipelineStageFlags to,
             VkAccessFlags reads);
// The same for compute shaders and copies, either way: what came before may be read and overwritten.
void separate(VkCommandBuffer commands);

}  // namespace ff::runtime
