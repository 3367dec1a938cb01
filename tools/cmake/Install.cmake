# What `cmake --install` puts down: the C interface (formfield.h), the static libraries behind it, a CMake package
# (find_package(Formfield), Formfield::runtime; with COMPONENTS vulkan also Formfield::vulkan) and pkg-config files
# (formfield, formfield-vulkan). Nothing of the baker's.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

# ff_install(TARGET EXPORT_SET NAME FILE): NAME in Formfield::, FILE as in libFILE.a. Static, but fit for a plugin.
function(ff_install target set name file)
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} OUTPUT_NAME ${file} POSITION_INDEPENDENT_CODE ON)
  install(TARGETS ${target} EXPORT ${set} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
endfunction()
ff_install(ff_formats FormfieldTargets formats formfield_formats)
ff_install(ff_stream FormfieldTargets stream formfield_stream)
ff_install(ff_runtime FormfieldTargets solvers formfield_solvers)
ff_install(ff_formfield FormfieldTargets runtime formfield)
target_include_directories(ff_formfield INTERFACE $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
ff_install(ff_runtime_vulkan FormfieldVulkanTargets solvers_vulkan formfield_solvers_vulkan)
ff_install(ff_formfield_vulkan FormfieldVulkanTargets vulkan formfield_vulkan)
install(FILES runtime/api/formfield.h runtime/api/formfield_vulkan.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})

if(FORMFIELD_HTTP)
  set(FORMFIELD_CURL CURL:libcurl)
  set(FORMFIELD_CURL_PC " libcurl")
endif()
set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/Formfield)
foreach(set FormfieldTargets FormfieldVulkanTargets)
  install(EXPORT ${set} NAMESPACE Formfield:: DESTINATION ${package_dir})
endforeach()
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/FormfieldConfig.cmake.in generated/FormfieldConfig.cmake
  INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(generated/FormfieldConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/generated/FormfieldConfig.cmake ${CMAKE_BINARY_DIR}/generated/FormfieldConfigVersion.cmake
  DESTINATION ${package_dir})

# From the folder of the .pc files to the prefix: the installed tree may be moved.
file(RELATIVE_PATH formfield_up /prefix/${CMAKE_INSTALL_LIBDIR}/pkgconfig /prefix)
foreach(pc formfield formfield-vulkan)
  configure_file(${CMAKE_CURRENT_LIST_DIR}/${pc}.pc.in generated/${pc}.pc @ONLY)
  install(FILES ${CMAKE_BINARY_DIR}/generated/${pc}.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endforeach()
