# ffview: its parts on scenes made by hand, then the whole road on a small town, under the validation layers.
file(GLOB FF_LAVAPIPE /usr/share/vulkan/icd.d/lvp_icd.*.json)
set(FF_VULKAN_ENVIRONMENT "")
if(FF_LAVAPIPE)
  set(FF_VULKAN_ENVIRONMENT VK_DRIVER_FILES=${FF_LAVAPIPE})
endif()
ff_test(view_test view/camera_test.cpp view/light_test.cpp view/lights_test.cpp view/picture_test.cpp view/solver_test.cpp view/weld_test.cpp
  LIBS ff_view ff_random_world)
add_executable(view_draw_test view/draw_test.cpp)
target_link_libraries(view_draw_test PRIVATE ff_options ff_view GTest::gtest_main)
add_test(NAME view_draw_test COMMAND view_draw_test)
set_tests_properties(view_draw_test PROPERTIES ENVIRONMENT "${FF_VULKAN_ENVIRONMENT}" TIMEOUT 300
  SKIP_REGULAR_EXPRESSION "\\[  SKIPPED \\]")
if(FORMFIELD_BAKE)
  add_test(NAME ffview_town COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/ffview_town.sh $<TARGET_FILE:ffscene> $<TARGET_FILE:ffbake>
    $<TARGET_FILE:ffview> ${CMAKE_CURRENT_BINARY_DIR}/ffview_town)
  set_tests_properties(ffview_town PROPERTIES ENVIRONMENT "${FF_VULKAN_ENVIRONMENT}" TIMEOUT 600 SKIP_RETURN_CODE 77)
endif()
