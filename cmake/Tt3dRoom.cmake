# One target per room. A room exposes only include/<room>. Including a room that is not linked,
# directly or through another, therefore does not compile.

# -Wrestrict: g++ 12 gives false warnings for std::string concatenation (GCC bug 105651).
set(TT3D_WARNINGS -Wall -Wextra -Wshadow -Wconversion -Wno-sign-conversion -Wno-restrict -Werror)
# -Wdangling-reference: g++ 13 and 14 warn of references to members of an argument that lives on. The
# others depend on what the optimiser inlines from the standard library; they stay warnings.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_GREATER_EQUAL 13)
  list(APPEND TT3D_WARNINGS -Wno-dangling-reference -Wno-error=array-bounds
       -Wno-error=stringop-overflow -Wno-error=stringop-overread -Wno-error=maybe-uninitialized
       -Wno-error=free-nonheap-object)
endif()
if(TT3D_SANITIZE)
  # The checks that the sanitizers insert make g++ 12 warn where nothing is wrong.
  list(REMOVE_ITEM TT3D_WARNINGS -Werror)
endif()

# CUDA code must give the CPU's bits (both must agree on coverage): no contraction of a * b + c, as
# on the CPU. Line tables are for profilers; warnings are errors.
set(TT3D_CUDA_FLAGS -fmad=false -lineinfo --expt-relaxed-constexpr
    "SHELL:-Werror all-warnings" -Xcompiler=-Wall,-Wextra,-Werror)

# tt3d_room(NAME [TORCH] SOURCES a.cpp ... [CUDA a.cu ...] [LINK rooms...] [LIBS libraries...])
# CUDA: sources for a build with TT3D_CUDA.
function(tt3d_room name)
  cmake_parse_arguments(ROOM "TORCH" "" "SOURCES;CUDA;LINK;LIBS" ${ARGN})
  if(TT3D_CUDA)
    list(APPEND ROOM_SOURCES ${ROOM_CUDA})
  endif()
  add_library(tt3d_${name} STATIC ${ROOM_SOURCES})
  target_include_directories(tt3d_${name}
    PUBLIC "$<BUILD_INTERFACE:${CMAKE_SOURCE_DIR}/include/${name}>" "$<INSTALL_INTERFACE:include>"
    PRIVATE "${CMAKE_CURRENT_SOURCE_DIR}")
  target_compile_features(tt3d_${name} PUBLIC cxx_std_20)
  tt3d_unity(tt3d_${name})
  if(TT3D_CUDA)
    tt3d_cuda_side(tt3d_${name})
  endif()
  # An installed room is the target tt3d::NAME; its headers are in include/tt3d.
  set_target_properties(tt3d_${name} PROPERTIES EXPORT_NAME ${name})
  install(TARGETS tt3d_${name} EXPORT tt3d)
  install(DIRECTORY "${CMAKE_SOURCE_DIR}/include/${name}/tt3d" TYPE INCLUDE)
  foreach(_room IN LISTS ROOM_LINK)
    target_link_libraries(tt3d_${name} PUBLIC tt3d_${_room})
  endforeach()
  target_link_libraries(tt3d_${name} PRIVATE ${ROOM_LIBS})
  target_compile_options(tt3d_${name} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:${TT3D_WARNINGS}>
                                              $<$<COMPILE_LANGUAGE:CUDA>:${TT3D_CUDA_FLAGS}>)
  if(ROOM_TORCH)
    target_link_libraries(tt3d_${name} PUBLIC TorchLibs::cpu)
    tt3d_torch_pch(tt3d_${name})
  endif()
endfunction()

# Compiles the sources of a target in groups of eight, so that headers are parsed and templates
# instantiated once a group (decision 27). Kernels stay on their own: their code must not depend on
# their neighbours.
function(tt3d_unity target)
  if(NOT TT3D_UNITY)
    return()
  endif()
  set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 8)
  get_target_property(_sources ${target} SOURCES)
  list(FILTER _sources INCLUDE REGEX "_cpu\\.cpp$")
  set_source_files_properties(${_sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
endfunction()

# Adds the target's CUDA files, and the sources that choose an executor or have a branch for CUDA, to
# the objects of target cuda_side. These sources are compiled on their own. ALL: every source.
function(tt3d_cuda_side target)
  cmake_parse_arguments(SIDE "ALL" "" "" ${ARGN})
  get_target_property(_sources ${target} SOURCES)
  foreach(_source IN LISTS _sources)
    if(_source MATCHES "\\.cpp$" AND NOT IS_ABSOLUTE "${_source}")
      file(STRINGS "${CMAKE_CURRENT_SOURCE_DIR}/${_source}" _branch REGEX
           "ifdef TT3D_CUDA|/cuda/|on_device_of|for_each_index_on|current_cuda")
      set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS
                   "${CMAKE_CURRENT_SOURCE_DIR}/${_source}")
    else()
      set(_branch "")
    endif()
    if(SIDE_ALL OR _branch OR _source MATCHES "\\.cu$")
      set_source_files_properties("${_source}" PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
      set_property(GLOBAL APPEND PROPERTY TT3D_CUDA_OBJECTS
                   "${CMAKE_CURRENT_BINARY_DIR}/CMakeFiles/${target}.dir/${_source}.o")
    endif()
  endforeach()
endfunction()

# Parsing ATen takes seconds per file. It is parsed once (tt3d_torch_pch_owner, src/device), and all
# targets that use torch share the result.
function(tt3d_torch_pch target)
  target_precompile_headers(${target} REUSE_FROM tt3d_torch_pch_owner)
endfunction()

# tt3d_test(NAME SOURCES a_test.cpp ... LINK rooms...): one GoogleTest program per room.
function(tt3d_test name)
  cmake_parse_arguments(TEST "" "" "SOURCES;LINK;LIBS" ${ARGN})
  add_executable(${name}_test ${TEST_SOURCES})
  foreach(_room IN LISTS TEST_LINK)
    target_link_libraries(${name}_test PRIVATE tt3d_${_room})
  endforeach()
  target_link_libraries(${name}_test PRIVATE tt3d_test_support ${TEST_LIBS} GTest::gtest_main)
  target_include_directories(${name}_test PRIVATE "${CMAKE_SOURCE_DIR}/tests"
                                                  "${CMAKE_SOURCE_DIR}/src")
  target_compile_options(${name}_test PRIVATE ${TT3D_WARNINGS})
  # -O1 compiles the tests' own code faster; what they test keeps -O3. From version 13, g++ cannot use
  # a precompiled header of another level.
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
    target_compile_options(${name}_test PRIVATE $<$<CONFIG:Release>:-O1>)
  endif()
  target_compile_definitions(${name}_test PRIVATE
    TT3D_SOURCE_DIR="${CMAKE_SOURCE_DIR}" TT3D_BINARY_DIR="${CMAKE_BINARY_DIR}")
  tt3d_torch_pch(${name}_test)
  tt3d_unity(${name}_test)
  gtest_discover_tests(${name}_test DISCOVERY_TIMEOUT 60 PROPERTIES TIMEOUT 600)
endfunction()
