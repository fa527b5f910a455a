# Mesh readers beyond PLY, OBJ, STL and OFF.
target_sources(strata_io PRIVATE
  ${CMAKE_CURRENT_LIST_DIR}/archive_mesh.cc
  ${CMAKE_CURRENT_LIST_DIR}/assimp_child.cc
  ${CMAKE_CURRENT_LIST_DIR}/assimp_reader.cc
  ${CMAKE_CURRENT_LIST_DIR}/assimp_records.cc
  ${CMAKE_CURRENT_LIST_DIR}/base_color.cc
  ${CMAKE_CURRENT_LIST_DIR}/companion_file.cc
  ${CMAKE_CURRENT_LIST_DIR}/draco_header.cc
  ${CMAKE_CURRENT_LIST_DIR}/draco_mesh.cc
  ${CMAKE_CURRENT_LIST_DIR}/drc_reader.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_accessor.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_attributes.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_buffers.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_container.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_document.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_geometry.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_materials.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_pose.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_reader.cc
  ${CMAKE_CURRENT_LIST_DIR}/gltf_scene.cc
  ${CMAKE_CURRENT_LIST_DIR}/image.cc
  ${CMAKE_CURRENT_LIST_DIR}/image_jpeg.cc
  ${CMAKE_CURRENT_LIST_DIR}/image_png.cc
  ${CMAKE_CURRENT_LIST_DIR}/image_webp.cc
  ${CMAKE_CURRENT_LIST_DIR}/json_text.cc
  ${CMAKE_CURRENT_LIST_DIR}/obj_materials.cc
  ${CMAKE_CURRENT_LIST_DIR}/placed_reader.cc
  ${CMAKE_CURRENT_LIST_DIR}/srgb.cc
  ${CMAKE_CURRENT_LIST_DIR}/texture_sampler.cc
  ${CMAKE_CURRENT_LIST_DIR}/three_mf_attributes.cc
  ${CMAKE_CURRENT_LIST_DIR}/three_mf_package.cc
  ${CMAKE_CURRENT_LIST_DIR}/three_mf_reader.cc
  ${CMAKE_CURRENT_LIST_DIR}/xml_stream.cc
  ${CMAKE_CURRENT_LIST_DIR}/zip_archive.cc)
target_link_libraries(strata_io PRIVATE EXPAT::EXPAT JPEG::JPEG meshoptimizer::meshoptimizer
  WebP::webp)
