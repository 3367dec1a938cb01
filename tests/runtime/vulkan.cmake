# One program, whose parts run on lavapipe where its driver file is found, so that they mean the same on every machine and
# vkCreateInstance does not probe hardware drivers; once per subgroup size that lavapipe can take (4, 8, 16 lanes).
file(GLOB FF_LAVAPIPE /usr/share/vulkan/icd.d/lvp_icd.*.json)
add_executable(vulkan_test api/formfield_vulkan_test.cpp cut/range_allocator_test.cpp dense/vk_bounce_matrix_test.cpp dense/vk_dense_step_test.cpp
  gather/vk_ease_test.cpp gather/vk_gather_test.cpp gather/vk_resolve_test.cpp vulkan/device_test.cpp $<TARGET_OBJECTS:ff_counted_memory>)
ff_compile_quickly(vulkan_test)
# formfield_vulkan.h names its neighbour as an installed header does.
target_include_directories(vulkan_test PRIVATE ${CMAKE_SOURCE_DIR}/runtime/api)
target_link_libraries(vulkan_test PRIVATE ff_options ff_formfield_vulkan ff_runtime_vulkan ff_synthetic_world Vulkan::Vulkan GTest::gtest_main)
# ff_vulkan_test(NAME TESTS pattern WIDTHS bits... ONCE pattern): ONCE are long tests that run at the first width alone.
function(ff_vulkan_test name)
  cmake_parse_arguments(VT "" "TESTS;ONCE" "WIDTHS" ${ARGN})
  set(filter ${VT_TESTS})
  foreach(width ${VT_WIDTHS})
    set(environment LP_NATIVE_VECTOR_WIDTH=${width})
    if(FF_LAVAPIPE)
      list(APPEND environment VK_DRIVER_FILES=${FF_LAVAPIPE})
    endif()
    add_test(NAME ${name}_${width} COMMAND vulkan_test --gtest_filter=${filter})
    if(VT_ONCE)
      set(filter ${VT_TESTS}-${VT_ONCE})
    endif()
    set_tests_properties(${name}_${width} PROPERTIES ENVIRONMENT "${environment}" TIMEOUT 600 COST 40
      SKIP_REGULAR_EXPRESSION "\\[  SKIPPED \\]")
  endforeach()
endfunction()
ff_vulkan_test(vk_dense_step TESTS VkDenseStep* WIDTHS 512 128 ONCE *AfterAWalk:*OnAWalk*:*Memory*:*NotStay:*GoesWrong*:*TheProbe*)
ff_vulkan_test(vk_bounce_matrix TESTS VkBounceMatrix.* WIDTHS 512 128 ONCE *SameBits*)
ff_vulkan_test(vk_gather TESTS VkGather.* WIDTHS 512 128 256 ONCE *SameBits*:*BadNumbers*)
ff_vulkan_test(vk_ease TESTS Vulkan/Ease.*:VkEase.*:VkShine.* WIDTHS 512 128)
ff_vulkan_test(vk_resolve TESTS VkResolve.* WIDTHS 128 256 512)
ff_vulkan_test(vk_device TESTS VkDeviceTest.*:VkContext.*:AdoptedDevice.*:RangeAllocator.* WIDTHS 256)
ff_vulkan_test(formfield_vulkan TESTS *FormfieldVulkan* WIDTHS 256)
