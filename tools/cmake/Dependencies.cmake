# Every third-party package, found once.
find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)
find_package(draco CONFIG REQUIRED)
find_package(zstd CONFIG REQUIRED)
find_package(Vulkan 1.3 REQUIRED COMPONENTS glslangValidator)
find_package(CLI11 CONFIG REQUIRED)
find_package(fmt CONFIG REQUIRED)
find_package(nlohmann_json 3 CONFIG REQUIRED)
find_package(tsl-robin-map CONFIG REQUIRED)
pkg_check_modules(XXHASH REQUIRED IMPORTED_TARGET GLOBAL libxxhash)
pkg_check_modules(URING REQUIRED IMPORTED_TARGET GLOBAL liburing)
pkg_check_modules(STB REQUIRED IMPORTED_TARGET GLOBAL stb)
find_package(GTest CONFIG REQUIRED)

if(FORMFIELD_BAKE)
  # The order matters: TBB's own config before OpenVDB's find module.
  find_package(TBB 2021 CONFIG REQUIRED COMPONENTS tbb)
  find_package(embree 3 CONFIG REQUIRED)
  function(ff_find_openvdb)  # a function, because FindOpenVDB sets BUILD_SHARED_LIBS in its caller's scope
    list(APPEND CMAKE_MODULE_PATH "/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/cmake/OpenVDB")
    find_package(OpenVDB 10 REQUIRED)
    set_target_properties(OpenVDB::openvdb PROPERTIES IMPORTED_GLOBAL TRUE)
  endfunction()
  ff_find_openvdb()
  pkg_check_modules(TURBOJPEG REQUIRED IMPORTED_TARGET GLOBAL libturbojpeg)
  pkg_check_modules(WEBP REQUIRED IMPORTED_TARGET GLOBAL libwebp)
  pkg_check_modules(OPENMPI IMPORTED_TARGET GLOBAL ompi-c)  # many ranks: without it ffbake is one process
  find_package(Eigen3 3.4 CONFIG REQUIRED)  # benches: the rival of gather
endif()
