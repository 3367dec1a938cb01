ff_test(import_test import_geometry_test.cpp import_material_test.cpp import_hostile_test.cpp import_light_test.cpp
  import_picture_test.cpp import_shared_test.cpp
  LIBS ff_bake_import draco::draco nlohmann_json::nlohmann_json PkgConfig::TURBOJPEG PkgConfig::WEBP)
target_include_directories(import_test SYSTEM PRIVATE ${STB_INCLUDE_DIRS})
target_compile_definitions(import_test PRIVATE FF_IMPORT_CHECK="$<TARGET_FILE:ffimport_check>")
add_dependencies(import_test ffimport_check)
if(TARGET meshoptimizer::meshoptimizer)
  target_link_libraries(import_test PRIVATE meshoptimizer::meshoptimizer)
  target_compile_definitions(import_test PRIVATE FF_HAVE_MESHOPTIMIZER)
endif()
ff_test(variants_test variants_test.cpp LIBS ff_bake ff_bake_import draco::draco nlohmann_json::nlohmann_json PkgConfig::WEBP)
target_include_directories(variants_test SYSTEM PRIVATE ${STB_INCLUDE_DIRS})
