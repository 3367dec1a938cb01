# ff_embed_spirv(<target> <glsl> NAME <symbol> [DEFINES A=1 ...]): compiles a shader at build time, validates it and
# offers it to <target> as "<symbol>.h" holding `const uint32_t <symbol>[]`. <glsl> is relative to the top folder;
# shaders may #include "shared.h" (GL_GOOGLE_include_directive).
find_program(SPIRV_VAL spirv-val REQUIRED)
function(ff_embed_spirv target source)
  cmake_parse_arguments(ES "" "NAME" "DEFINES" ${ARGN})
  set(glsl ${CMAKE_SOURCE_DIR}/${source})
  set(dir ${CMAKE_BINARY_DIR}/spirv)
  set(spv ${dir}/${ES_NAME}.spv)
  set(hdr ${dir}/${ES_NAME}.h)
  set(defines)
  foreach(d ${ES_DEFINES})
    list(APPEND defines -D${d})
  endforeach()
  add_custom_command(OUTPUT ${spv} ${hdr}  # .spv first: Ninja wants the depfile to name the first output
    COMMAND ${CMAKE_COMMAND} -E make_directory ${dir}
    COMMAND Vulkan::glslangValidator --quiet -V --target-env vulkan1.2 ${defines} --depfile ${spv}.d -o ${spv} ${glsl}
    COMMAND ${SPIRV_VAL} --target-env vulkan1.2 ${spv}
    COMMAND Vulkan::glslangValidator --quiet -V --target-env vulkan1.2 ${defines} --vn ${ES_NAME} -o ${hdr} ${glsl}
    DEPENDS ${glsl} DEPFILE ${spv}.d VERBATIM COMMENT "GLSL ${ES_NAME}")
  target_sources(${target} PRIVATE ${hdr})
  target_include_directories(${target} PRIVATE ${dir})
endfunction()
