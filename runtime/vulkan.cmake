# The Vulkan half of the room. Callers link ff_runtime_vulkan; only those that include vulkan/device.h need vulkan.h.
ff_room(ff_runtime_vulkan
  dense/vk_baseline.cpp dense/vk_bounce_steps.cpp dense/vk_dense_step.cpp dense/vk_multibounce.cpp dense/vk_plain_local.cpp dense/vk_seed.cpp
  gather/gather_layout.cpp gather/vk_gather.cpp vulkan/buffer.cpp vulkan/device.cpp vulkan/pipeline.cpp)
target_link_libraries(ff_runtime_vulkan PUBLIC ff_runtime PRIVATE Vulkan::Vulkan)
foreach(step ease fade gather gather_enter gather_kinds gather_change gather_leave pace pace_limit refine resolve shine)
  ff_embed_spirv(ff_runtime_vulkan shaders/${step}.comp NAME ${step}_comp)
endforeach()
ff_embed_spirv(ff_runtime_vulkan shaders/gather.comp NAME gather_hold_comp DEFINES HOLD=1)
foreach(step tall wide scatter corner solve apply fold relight pending changed residual correct)
  ff_embed_spirv(ff_runtime_vulkan shaders/bounce_${step}.comp NAME bounce_${step}_comp)
endforeach()
foreach(step tall wide solve apply fold relight changed)
  ff_embed_spirv(ff_runtime_vulkan shaders/bounce_${step}.comp NAME bounce_${step}_half_comp DEFINES HALF=1)
endforeach()
ff_embed_spirv(ff_runtime_vulkan shaders/bounce_relight.comp NAME bounce_relight_luminance_comp DEFINES LUMINANCE=1)
ff_embed_spirv(ff_runtime_vulkan shaders/bounce_relight.comp NAME bounce_relight_luminance_half_comp
               DEFINES HALF=1 LUMINANCE=1)
foreach(step double triple column row outer write delete relight)
  ff_embed_spirv(ff_runtime_vulkan shaders/seed_${step}.comp NAME seed_${step}_comp)
endforeach()
foreach(step scatter delete)
  ff_embed_spirv(ff_runtime_vulkan shaders/plain_${step}.comp NAME plain_${step}_comp)
  ff_embed_spirv(ff_runtime_vulkan shaders/plain_${step}.comp NAME plain_${step}_half_comp DEFINES HALF=1)
endforeach()
ff_room(ff_formfield_vulkan api/formfield_vulkan.cpp)
target_include_directories(ff_formfield_vulkan PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/api)  # formfield_vulkan.h's "formfield.h"
target_link_libraries(ff_formfield_vulkan PUBLIC ff_formfield PRIVATE ff_runtime ff_runtime_vulkan Vulkan::Vulkan)
