# The Vulkan half of the room. Callers link ff_runtime_vulkan; only those that include vk_device.h need vulkan.h.
ff_room(ff_runtime_vulkan vk_buffer.cpp vk_device.cpp vk_gather.cpp vk_pipeline.cpp)
target_link_libraries(ff_runtime_vulkan PUBLIC ff_runtime PRIVATE Vulkan::Vulkan)
ff_embed_spirv(ff_runtime_vulkan shaders/gather.comp NAME gather_comp)
ff_embed_spirv(ff_runtime_vulkan shaders/refine.comp NAME refine_comp)
