# ff_bake_import: glTF to Scene. tinygltf, nlohmann-json, Draco and the decoders of pictures are seen by nothing else.
ff_room(ff_bake_import
  gltf_container.cpp gltf_document.cpp gltf_draco.cpp gltf_elements.cpp gltf_images.cpp gltf_import.cpp gltf_instances.cpp
  gltf_json.cpp gltf_lights.cpp gltf_materials.cpp gltf_meshopt.cpp gltf_meshopt_vertices.cpp gltf_objects.cpp gltf_pictures.cpp gltf_reduce_accessors.cpp
  gltf_reduce_materials.cpp
  gltf_reduce_meshes.cpp gltf_reduce_nodes.cpp gltf_surface.cpp tinygltf_implementation.cpp)
target_link_libraries(ff_bake_import PRIVATE draco::draco nlohmann_json::nlohmann_json PkgConfig::XXHASH PkgConfig::TURBOJPEG
  PkgConfig::WEBP)
target_include_directories(ff_bake_import SYSTEM PRIVATE ${STB_INCLUDE_DIRS})
target_compile_definitions(ff_bake_import PRIVATE TINYGLTF_NO_STB_IMAGE TINYGLTF_NO_STB_IMAGE_WRITE TINYGLTF_NO_FS
  TINYGLTF_NO_EXTERNAL_IMAGE)
set_source_files_properties(tinygltf_implementation.cpp PROPERTIES COMPILE_OPTIONS "-w;-O1")  # not our code; a minute less
find_package(meshoptimizer CONFIG QUIET GLOBAL)
if(TARGET meshoptimizer::meshoptimizer)
  target_link_libraries(ff_bake_import PRIVATE meshoptimizer::meshoptimizer)
  target_compile_definitions(ff_bake_import PRIVATE FF_HAVE_MESHOPTIMIZER)
endif()
