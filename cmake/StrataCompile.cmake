# Flags shared by every target. `-ffp-contract=off` is not a matter of taste: without it the
# compiler may fuse a multiply and an add where the processor has the instruction, and samples would
# depend on the processor and on the compiler.
add_library(strata_compile INTERFACE)
target_compile_options(strata_compile INTERFACE
  -ffp-contract=off -fno-fast-math -fno-math-errno -Wall -Wextra -Wpedantic -Wshadow -Wno-unused-parameter)
# g++ 12 sees overlapping copies in `"literal" + std::string` where there are none (its bug 105651).
target_compile_options(strata_compile INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>)
if(STRATA_WERROR)
  target_compile_options(strata_compile INTERFACE -Werror)
endif()
target_include_directories(strata_compile INTERFACE
  $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}> $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/generated>)

# For every target, tests included: a sanitizer must see the whole program.
set(STRATA_SANITIZE "" CACHE STRING "Sanitizers to compile with, as -fsanitize takes them")
if(STRATA_SANITIZE)
  add_compile_options(-fsanitize=${STRATA_SANITIZE} -fno-sanitize-recover=all
    -fno-omit-frame-pointer)
  add_link_options(-fsanitize=${STRATA_SANITIZE})
endif()

# For libFuzzer every object needs its instrumentation, not only the targets in tests/fuzz.
if(STRATA_FUZZ)
  if(NOT CMAKE_CXX_COMPILER_ID MATCHES Clang)
    message(FATAL_ERROR "STRATA_FUZZ needs clang, of which libFuzzer is a part")
  endif()
  add_compile_options(-fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all -g)
  add_link_options(-fsanitize=address,undefined)
endif()
