#include "runtime/vulkan/buffer.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "runtime/vulkan/device.h"

namespace ff::runtime {
namespace {
constexpr uint64_t kBlockBytes = uint64_t{64} << 20;  // larger requests get a block of their own
constexpr uint64_t kStagingBytes = uint64_t{16} << 20;
}  // namespace

VkHeap::VkHeap(VkContext& context) : context_(context) {
  vkGetPhysicalDeviceMemoryProperties(context.physicalDevice(), &properties_);
}

Result<Allocation> VkHeap::allocate(const VkMemoryRequirements& needs, MemoryUse use, bool linear) {
  const VkMemoryPropertyFlags wanted = use == MemoryUse::kDevice
                                           ? VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT
                                           : VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
  // Host memory is read back, too: a cached type, if there is one, is many times faster for that.
  const VkMemoryPropertyFlags liked = use == MemoryUse::kHost ? wanted | VK_MEMORY_PROPERTY_HOST_CACHED_BIT : wanted;
  uint32_t type = VK_MAX_MEMORY_TYPES;
  for (const VkMemoryPropertyFlags flags : {liked, wanted, use == MemoryUse::kDevice ? 0 : wanted}) {
    for (uint32_t t = 0; t < properties_.memoryTypeCount && type == VK_MAX_MEMORY_TYPES; ++t)
      if ((needs.memoryTypeBits >> t & 1) && (properties_.memoryTypes[t].propertyFlags & flags) == flags) type = t;
  }
  if (type == VK_MAX_MEMORY_TYPES) return vkError("choosing a memory type", VK_ERROR_FEATURE_NOT_PRESENT);

  for (size_t i = 0; i < blocks_.size(); ++i) {
    Block* b = blocks_[i].get();
    if (!b || b->type != type || b->linear != linear || (use == MemoryUse::kHost) != (b->mapped != nullptr)) continue;
    if (const auto at = b->ranges.allocate(needs.size, needs.alignment))
      return allocationOf(i, *at, needs.size);
  }
  auto info = zeroed<VkMemoryAllocateInfo>(VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO);
  uint64_t left = bytesLeft(type);
  if (needs.size > left) {
    freeEmptyBlocks();
    left = bytesLeft(type);
  }
  if (needs.size > left) return vkError("vkAllocateMemory", VK_ERROR_OUT_OF_DEVICE_MEMORY);
  // An eighth of a small budget: device memory, host memory and images need a block each.
  const uint64_t block_bytes = context_.memoryBytes() ? std::min(kBlockBytes, context_.memoryBytes() / 8) : kBlockBytes;
  info.allocationSize = std::max(needs.size, std::min(block_bytes, left));
  info.memoryTypeIndex = type;
  const VkDevice device = context_.device();
  Handle<VkDeviceMemory, vkFreeMemory> memory;
  if (const VkResult r = vkAllocateMemory(device, &info, nullptr, memory.create(device)); r != VK_SUCCESS)
    return vkError("vkAllocateMemory", r);
  void* mapped = nullptr;
  if (use == MemoryUse::kHost)
    if (const VkResult r = vkMapMemory(device, memory, 0, VK_WHOLE_SIZE, 0, &mapped); r != VK_SUCCESS)
      return vkError("vkMapMemory", r);
  allocated_bytes_ += info.allocationSize;
  auto block = std::make_unique<Block>(Block{std::move(memory), type, linear, static_cast<std::byte*>(mapped),
                                             info.allocationSize, RangeAllocator(info.allocationSize)});
  const auto at = block->ranges.allocate(needs.size, needs.alignment);
  const auto hole = std::find(blocks_.begin(), blocks_.end(), nullptr);
  const auto index = static_cast<size_t>(hole - blocks_.begin());
  if (hole == blocks_.end())
    blocks_.push_back(std::move(block));
  else
    *hole = std::move(block);
  return allocationOf(index, *at, needs.size);
}

Allocation VkHeap::allocationOf(size_t block, uint64_t offset, uint64_t size) {
  const Block& b = *blocks_[block];
  return {*this, b.memory, offset, size, b.mapped ? b.mapped + offset : nullptr, block};
}

uint64_t VkHeap::bytesLeft(uint32_t type) const {
  const uint32_t heap = properties_.memoryTypes[type].heapIndex;
  uint64_t used = 0;
  for (const auto& b : blocks_)
    if (b && properties_.memoryTypes[b->type].heapIndex == heap) used += b->size;
  uint64_t left = properties_.memoryHeaps[heap].size - std::min(properties_.memoryHeaps[heap].size, used);
  if (const uint64_t budget = context_.memoryBytes())
    left = std::min(left, budget - std::min(budget, allocated_bytes_));
  return left;
}

void VkHeap::freeBlock(std::unique_ptr<Block>& block) {
  allocated_bytes_ -= block->size;
  block.reset();
}

void VkHeap::freeEmptyBlocks() {
  for (auto& b : blocks_)
    if (b && b->ranges.empty()) freeBlock(b);
}

void VkHeap::release(const Allocation& allocation) {
  Block* b = blocks_[allocation.block_].get();
  b->ranges.release(allocation.offset_, allocation.size_);
  if (!b->ranges.empty() || b->size <= kBlockBytes) return;  // ordinary blocks are kept for the next request
  freeBlock(blocks_[allocation.block_]);
}

Allocation::~Allocation() {
  if (heap_) heap_->release(*this);
}

void Allocation::swap(Allocation& other) noexcept {
  std::swap(heap_, other.heap_);
  std::swap(memory_, other.memory_);
  std::swap(offset_, other.offset_);
  std::swap(size_, other.size_);
  std::swap(mapped_, other.mapped_);
  std::swap(block_, other.block_);
}

Result<Buffer> Buffer::create(VkContext& context, uint64_t bytes, VkBufferUsageFlags usage, MemoryUse use) {
  const VkDevice device = context.device();
  Buffer b;
  b.bytes_ = bytes;
  auto info = zeroed<VkBufferCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO);
  info.size = bytes;
  info.usage = usage | VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
  if (const VkResult r = vkCreateBuffer(device, &info, nullptr, b.buffer_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateBuffer", r);
  VkMemoryRequirements needs;
  vkGetBufferMemoryRequirements(device, b.buffer_, &needs);
  auto a = context.heap().allocate(needs, use, /*linear=*/true);
  if (!a) return a.error();
  b.allocation_ = std::move(*a);
  if (const VkResult r = vkBindBufferMemory(device, b.buffer_, b.allocation_.memory(), b.allocation_.offset());
      r != VK_SUCCESS)
    return vkError("vkBindBufferMemory", r);
  return b;
}

Result<Image> Image::create(VkContext& context, VkExtent2D extent, VkFormat format, VkImageUsageFlags usage,
                            VkImageAspectFlags aspect) {
  const VkDevice device = context.device();
  Image i;
  i.extent_ = extent;
  i.format_ = format;
  auto info = zeroed<VkImageCreateInfo>(VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO);
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = format;
  info.extent = {extent.width, extent.height, 1};
  info.mipLevels = info.arrayLayers = 1;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  info.tiling = VK_IMAGE_TILING_OPTIMAL;
  info.usage = usage;
  if (const VkResult r = vkCreateImage(device, &info, nullptr, i.image_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateImage", r);
  VkMemoryRequirements needs;
  vkGetImageMemoryRequirements(device, i.image_, &needs);
  auto a = context.heap().allocate(needs, MemoryUse::kDevice, /*linear=*/false);
  if (!a) return a.error();
  i.allocation_ = std::move(*a);
  if (const VkResult r = vkBindImageMemory(device, i.image_, i.allocation_.memory(), i.allocation_.offset());
      r != VK_SUCCESS)
    return vkError("vkBindImageMemory", r);
  auto view = zeroed<VkImageViewCreateInfo>(VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO);
  view.image = i.image_;
  view.viewType = VK_IMAGE_VIEW_TYPE_2D;
  view.format = format;
  view.subresourceRange = {aspect, 0, 1, 0, 1};
  if (const VkResult r = vkCreateImageView(device, &view, nullptr, i.view_.create(device)); r != VK_SUCCESS)
    return vkError("vkCreateImageView", r);
  return i;
}

Result<void> upload(VkContext& context, const Buffer& to, uint64_t offset, std::span<const std::byte> bytes) {
  if (bytes.empty()) return {};
  auto staging = Buffer::create(context, std::min<uint64_t>(bytes.size(), kStagingBytes), 0, MemoryUse::kHost);
  if (!staging) return staging.error();
  for (uint64_t done = 0; done < bytes.size();) {
    const uint64_t n = std::min<uint64_t>(bytes.size() - done, staging->bytes());
    std::memcpy(staging->mapped(), bytes.data() + done, n);
    auto r = context.run([&](VkCommandBuffer c) {
      const VkBufferCopy copy{0, offset + done, n};
      vkCmdCopyBuffer(c, staging->handle(), to.handle(), 1, &copy);
    });
    if (!r) return r.error();
    done += n;
  }
  return {};
}

Result<void> download(VkContext& context, const Buffer& from, uint64_t offset, std::span<std::byte> bytes) {
  if (bytes.empty()) return {};
  auto staging = Buffer::create(context, std::min<uint64_t>(bytes.size(), kStagingBytes), 0, MemoryUse::kHost);
  if (!staging) return staging.error();
  for (uint64_t done = 0; done < bytes.size();) {
    const uint64_t n = std::min<uint64_t>(bytes.size() - done, staging->bytes());
    auto r = context.run([&](VkCommandBuffer c) {
      const VkBufferCopy copy{offset + done, 0, n};
      vkCmdCopyBuffer(c, from.handle(), staging->handle(), 1, &copy);
    });
    if (!r) return r.error();
    std::memcpy(bytes.data() + done, staging->mapped(), n);
    done += n;
  }
  return {};
}

void barrier(VkCommandBuffer commands, VkPipelineStageFlags from, VkAccessFlags wrote, VkPipelineStageFlags to,
             VkAccessFlags reads) {
  auto b = zeroed<VkMemoryBarrier>(VK_STRUCTURE_TYPE_MEMORY_BARRIER);
  b.srcAccessMask = wrote;
  b.dstAccessMask = reads;
  vkCmdPipelineBarrier(commands, from, to, 0, 1, &b, 0, nullptr, 0, nullptr);
}

void separate(VkCommandBuffer commands) {
  constexpr VkPipelineStageFlags kStages = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
  barrier(commands, kStages, VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT, kStages,
          VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_READ_BIT |
              VK_ACCESS_TRANSFER_WRITE_BIT);
}

Result<double> deviceCopyBandwidth(VkContext& context, uint64_t bytes) {
  auto from = Buffer::create(context, bytes, 0), to = Buffer::create(context, bytes, 0);
  if (!from) return from.error();
  if (!to) return to.error();
  std::array<double, 9> ms{};
  for (double& once : ms) {
    auto took = context.run([&](VkCommandBuffer c) {
      const VkBufferCopy copy{0, 0, bytes};
      vkCmdFillBuffer(c, from->handle(), 0, bytes, 1);  // memory that was never written may not be there at all
      separate(c);
      context.beginTimed(c);
      vkCmdCopyBuffer(c, from->handle(), to->handle(), 1, &copy);
      context.endTimed(c);
    });
    if (!took) return took.error();
    once = context.timedMs();
  }
  std::sort(ms.begin(), ms.end());
  return 2 * static_cast<double>(bytes) / (ms[ms.size() / 2] * 1e-3);
}

}  // namespace ff::runtime
