# Tests of the readers beyond PLY, OBJ, STL and OFF.
strata_io_test(gltf_reader_test)
target_link_libraries(gltf_reader_test
  PRIVATE meshoptimizer::meshoptimizer nlohmann_json::nlohmann_json)
strata_io_test(drc_reader_test)
target_link_libraries(drc_reader_test PRIVATE draco::draco nlohmann_json::nlohmann_json)
strata_io_test(format_table_test)
strata_io_test(archive_mesh_test)
target_link_libraries(archive_mesh_test
  PRIVATE LibArchive::LibArchive nlohmann_json::nlohmann_json)
if(TARGET strata_assimp)
  strata_io_test(assimp_reader_test)
  target_compile_definitions(assimp_reader_test
    PRIVATE STRATA_ASSIMP_PROGRAM="$<TARGET_FILE:strata_assimp>")
  add_dependencies(assimp_reader_test strata_assimp)
endif()
strata_io_test(gltf_attributes_test)
target_link_libraries(gltf_attributes_test PRIVATE nlohmann_json::nlohmann_json)
strata_io_test(image_test)
target_link_libraries(image_test PRIVATE JPEG::JPEG PNG::PNG WebP::webp)
strata_io_test(texture_test)
target_link_libraries(texture_test
  PRIVATE JPEG::JPEG LibArchive::LibArchive nlohmann_json::nlohmann_json PNG::PNG WebP::webp)
