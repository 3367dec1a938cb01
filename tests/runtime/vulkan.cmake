# The Vulkan tests run on lavapipe where its driver file is found, so that they mean the same on every machine and
# vkCreateInstance does not probe hardware drivers; once per subgroup size that lavapipe can take (4, 8, 16 lanes).
file(GLOB FF_LAVAPIPE /usr/share/vulkan/icd.d/lvp_icd.*.json)
ff_test(range_allocator_test range_allocator_test.cpp LIBS ff_runtime_vulkan)
add_executable(vk_gather_test vk_gather_test.cpp)
target_link_libraries(vk_gather_test PRIVATE ff_options ff_runtime_vulkan Vulkan::Vulkan GTest::gtest_main)
foreach(width 128 256 512)
  set(environment LP_NATIVE_VECTOR_WIDTH=${width})
  if(FF_LAVAPIPE)
    list(APPEND environment VK_DRIVER_FILES=${FF_LAVAPIPE})
  endif()
  add_test(NAME vk_gather_test_${width} COMMAND vk_gather_test)
  set_tests_properties(vk_gather_test_${width} PROPERTIES ENVIRONMENT "${environment}" TIMEOUT 300
    SKIP_REGULAR_EXPRESSION "\\[  SKIPPED \\]")
endforeach()
