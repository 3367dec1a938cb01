# The Vulkan half of the room. Callers link ff_runtime_vulkan; only those that include vk_device.h need vulkan.h.
ff_room(ff_runtime_vulkan vk_buffer.cpp vk_device.cpp vk_gather.cpp vk_multibounce.cpp vk_pipeline.cpp)
target_link_libraries(ff_runtime_vulkan PUBLIC ff_runtime PRIVATE Vulkan::Vulkan)
ff_embed_spirv(ff_runtime_vulkan shaders/gather.comp NAME gather_comp)
ff_embed_spirv(ff_runtime_vulkan shaders/refine.comp NAME refine_comp)
foreach(step tall wide scatter corner solve apply fold relight pending changed)
  ff_embed_spirv(ff_runtime_vulkan shaders/bounce_${step}.comp NAME bounce_${step}_comp)
endforeach()
foreach(step tall wide solve apply fold relight changed)
  ff_embed_spirv(ff_runtime_vulkan shaders/bounce_${step}.comp NAME bounce_${step}_half_comp DEFINES HALF=1)
endforeach()
ff_embed_spirv(ff_runtime_vulkan shaders/bounce_relight.comp NAME bounce_relight_luminance_comp DEFINES LUMINANCE=1)
ff_embed_spirv(ff_runtime_vulkan shaders/bounce_relight.comp NAME bounce_relight_luminance_half_comp
               DEFINES HALF=1 LUMINANCE=1)
