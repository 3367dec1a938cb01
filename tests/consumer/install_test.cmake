# Installs the package from the build tree into a fresh folder, builds the consumers against it through find_package and
# through pkg-config, moves nothing else along, and runs them on a small world.
set(work ${BUILD}/consumer-test)
file(REMOVE_RECURSE ${work})
file(MAKE_DIRECTORY ${work}/pkg-config)

function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE code OUTPUT_VARIABLE out ERROR_VARIABLE out WORKING_DIRECTORY ${work})
  if(NOT code EQUAL 0)
    string(JOIN " " line ${ARGN})
    message(FATAL_ERROR "exit code ${code}: ${line}\n${out}")
  endif()
  set(out "${out}" PARENT_SCOPE)
endfunction()

run(${FFSCENE} town --patches 2k -o town.glb)
run(${FFBAKE} town.glb -o town.ffm --patch-size 1 --rays 256)

# Installed, then moved: nothing may remember where it was.
run(${CMAKE_COMMAND} --install ${BUILD} --config ${CONFIG} --prefix ${work}/first)
file(RENAME ${work}/first ${work}/prefix)

run(${CMAKE_COMMAND} -S ${SOURCE} -B ${work}/cmake -G ${GENERATOR} -DCMAKE_PREFIX_PATH=${work}/prefix
  -DCMAKE_C_COMPILER=${C_COMPILER} -DCMAKE_C_FLAGS=${C_FLAGS} -DCMAKE_BUILD_TYPE=Release)
run(${CMAKE_COMMAND} --build ${work}/cmake)
run(${work}/cmake/consumer town.ffm)
message("${out}")
if(NOT out MATCHES "irradiance from above [0-9.]+")
  message(FATAL_ERROR "the consumer printed no irradiance")
endif()

# Bakers' libraries and Vulkan do not come along.
run(ldd ${work}/cmake/consumer)
if(NOT out MATCHES libzstd)
  message(FATAL_ERROR "expected libzstd among the consumer's libraries:\n${out}")
endif()
foreach(foreign libembree libopenvdb libtbb libvulkan libfmt)
  if(out MATCHES ${foreign})
    message(FATAL_ERROR "the consumer needs ${foreign}:\n${out}")
  endif()
endforeach()
file(GLOB headers RELATIVE ${work}/prefix ${work}/prefix/include/*)
if(NOT headers STREQUAL "include/formfield.h;include/formfield_vulkan.h")
  message(FATAL_ERROR "expected the two headers of the C interface, got: ${headers}")
endif()

# No driver: no Vulkan run (exit code 77).
execute_process(COMMAND ${work}/cmake/consumer_vulkan town.ffm WORKING_DIRECTORY ${work} RESULT_VARIABLE code
  OUTPUT_VARIABLE out ERROR_VARIABLE out)
message("${out}")
if(NOT code EQUAL 0 AND NOT code EQUAL 77)
  message(FATAL_ERROR "consumer_vulkan: exit code ${code}\n${out}")
endif()

file(GLOB_RECURSE pc ${work}/prefix/formfield.pc)
get_filename_component(pc_folder ${pc} DIRECTORY)
separate_arguments(flags UNIX_COMMAND "${C_FLAGS}")
foreach(program consumer:formfield consumer_vulkan:formfield-vulkan)
  string(REPLACE ":" ";" program ${program})
  list(POP_FRONT program name)
  run(${CMAKE_COMMAND} -E env PKG_CONFIG_PATH=${pc_folder} pkg-config --cflags --libs ${program})
  separate_arguments(pc_flags UNIX_COMMAND "${out}")
  run(${C_COMPILER} -std=c99 ${flags} ${SOURCE}/${name}.c -o ${work}/pkg-config/${name} ${pc_flags} -lm)
endforeach()
run(${work}/pkg-config/consumer town.ffm)
message("${out}")
