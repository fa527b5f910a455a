# Tests of what leaves: output files, sample formats, pictures.
find_package(Python3 COMPONENTS Interpreter)
if(EXISTS /usr/bin/python3)
  set(strata_test_python /usr/bin/python3)  # The one that Debian's python3-numpy belongs to.
else()
  set(strata_test_python "${Python3_EXECUTABLE}")
endif()
function(strata_writer_test name)
  add_executable(${name} ${name}.cc)
  target_link_libraries(${name}
    PRIVATE strata_compile strata_io draco::draco nlohmann_json::nlohmann_json PNG::PNG GTest::gtest_main)
  target_compile_definitions(${name} PRIVATE STRATA_TEST_PYTHON="${strata_test_python}"
    STRATA_SOURCE_DIR="${PROJECT_SOURCE_DIR}")
  gtest_discover_tests(${name})
endfunction()

strata_writer_test(atomic_file_test)
strata_writer_test(carried_columns_test)
strata_writer_test(draco_writer_test)
strata_writer_test(float_grid_test)
strata_writer_test(glb_test)
strata_writer_test(npz_writer_test)
strata_writer_test(picture_test)
strata_writer_test(sample_writer_test)
strata_writer_test(tile_writer_test)
strata_writer_test(writer_memory_test)
