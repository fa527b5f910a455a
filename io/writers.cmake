# By which samples leave: output files, one writer per format, pictures.
target_sources(strata_io PRIVATE
  ${CMAKE_CURRENT_LIST_DIR}/atomic_file.cc
  ${CMAKE_CURRENT_LIST_DIR}/atomic_folder.cc
  ${CMAKE_CURRENT_LIST_DIR}/carried_columns.cc
  ${CMAKE_CURRENT_LIST_DIR}/checked_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/draco_cloud.cc
  ${CMAKE_CURRENT_LIST_DIR}/draco_in_turn.cc
  ${CMAKE_CURRENT_LIST_DIR}/draco_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/float_grid.cc
  ${CMAKE_CURRENT_LIST_DIR}/glb_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/npz_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/output_place.cc
  ${CMAKE_CURRENT_LIST_DIR}/picture.cc
  ${CMAKE_CURRENT_LIST_DIR}/ply_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/region_folder.cc
  ${CMAKE_CURRENT_LIST_DIR}/row_spooler.cc
  ${CMAKE_CURRENT_LIST_DIR}/sample_rows.cc
  ${CMAKE_CURRENT_LIST_DIR}/sample_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/sha256.cc
  ${CMAKE_CURRENT_LIST_DIR}/splat_canvas.cc
  ${CMAKE_CURRENT_LIST_DIR}/spool.cc
  ${CMAKE_CURRENT_LIST_DIR}/stored_zip.cc
  ${CMAKE_CURRENT_LIST_DIR}/tile_scatter.cc
  ${CMAKE_CURRENT_LIST_DIR}/tile_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/tileset_json.cc
  ${CMAKE_CURRENT_LIST_DIR}/vdb_child.cc
  ${CMAKE_CURRENT_LIST_DIR}/vdb_columns.cc
  ${CMAKE_CURRENT_LIST_DIR}/vdb_writer.cc
  ${CMAKE_CURRENT_LIST_DIR}/xyz_writer.cc)
target_link_libraries(strata_io PRIVATE draco::draco LibArchive::LibArchive
  nlohmann_json::nlohmann_json OpenSSL::Crypto PNG::PNG)
