# Finds the C++ libraries inside the pinned torch wheel of the virtual environment.
#
# TorchConfig.cmake of a CUDA wheel needs a CUDA toolkit, which CPU users do not have and the
# libraries do not need. This module defines TorchLibs::cpu (headers, libtorch_cpu, libc10), whose
# precompiled ATen header the rooms share. With TT3D_CUDA it also defines TorchLibs::cuda. It is
# installed next to tt3dConfig.cmake, for programs that use the library.

set(TT3D_TORCH_DIR "" CACHE PATH "Folder of the installed torch package (default: that of .venv)")
if(NOT TT3D_TORCH_DIR)
  file(GLOB _torch_candidates "${CMAKE_SOURCE_DIR}/.venv/lib/python3*/site-packages/torch")
  list(LENGTH _torch_candidates _torch_count)
  if(_torch_count EQUAL 0)
    message(FATAL_ERROR "No torch in .venv: run scripts/setup first, or set TT3D_TORCH_DIR")
  endif()
  list(GET _torch_candidates 0 TT3D_TORCH_DIR)
endif()

find_library(TORCH_CPU_LIBRARY torch_cpu PATHS "${TT3D_TORCH_DIR}/lib" NO_DEFAULT_PATH NO_CACHE)
find_library(TORCH_C10_LIBRARY c10 PATHS "${TT3D_TORCH_DIR}/lib" NO_DEFAULT_PATH NO_CACHE)
file(STRINGS "${TT3D_TORCH_DIR}/version.py" _torch_version_line REGEX "^__version__")
string(REGEX MATCH "[0-9]+\\.[0-9]+\\.[0-9]+" TorchLibs_VERSION "${_torch_version_line}")

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(TorchLibs REQUIRED_VARS TORCH_CPU_LIBRARY TORCH_C10_LIBRARY
                                  VERSION_VAR TorchLibs_VERSION)

# The wheel's CPU library is linked against parts of CUDA's runtime, which lie next to torch.
file(GLOB _torch_nvidia "${TT3D_TORCH_DIR}/../nvidia/*/lib")
set(TORCH_LIBS_RPATH "${TT3D_TORCH_DIR}/lib" ${_torch_nvidia})

add_library(TorchLibs::cpu INTERFACE IMPORTED)
target_include_directories(TorchLibs::cpu SYSTEM INTERFACE
  "${TT3D_TORCH_DIR}/include" "${TT3D_TORCH_DIR}/include/torch/csrc/api/include")
target_link_libraries(TorchLibs::cpu INTERFACE "${TORCH_CPU_LIBRARY}" "${TORCH_C10_LIBRARY}")
target_compile_definitions(TorchLibs::cpu INTERFACE _GLIBCXX_USE_CXX11_ABI=1)
# at::parallel_for is a header: without OpenMP it silently becomes a sequential loop. It uses the
# wheel's own libgomp. (The clang of the fuzz targets has no OpenMP; their readers have no parallel
# loops.)
target_compile_options(TorchLibs::cpu INTERFACE $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-fopenmp>)
target_link_libraries(TorchLibs::cpu INTERFACE "${TT3D_TORCH_DIR}/lib/libgomp.so.1")
foreach(_dir IN LISTS TORCH_LIBS_RPATH)
  target_link_options(TorchLibs::cpu INTERFACE "LINKER:-rpath,${_dir}" "LINKER:-rpath-link,${_dir}")
endforeach()

if(TT3D_CUDA)
  find_library(TORCH_CUDA_LIBRARY torch_cuda PATHS "${TT3D_TORCH_DIR}/lib" NO_DEFAULT_PATH NO_CACHE
               REQUIRED)
  find_library(TORCH_C10_CUDA_LIBRARY c10_cuda PATHS "${TT3D_TORCH_DIR}/lib" NO_DEFAULT_PATH
               NO_CACHE REQUIRED)
  find_package(CUDAToolkit REQUIRED)
  add_library(TorchLibs::cuda INTERFACE IMPORTED)
  target_link_libraries(TorchLibs::cuda INTERFACE TorchLibs::cpu
    # The library registers itself in its initialisers; no symbol refers to it.
    "-Wl,--no-as-needed" "${TORCH_CUDA_LIBRARY}" "${TORCH_C10_CUDA_LIBRARY}" "-Wl,--as-needed"
    CUDA::cudart)
endif()
