# `cmake --install`: the command, the two libraries with their public headers, and a CMake package
# with the targets strata::core, strata::io and strata::strata (both).
include(CMakePackageConfigHelpers)

set(strata_public_headers
  core/cell_octree.h core/lattice.h core/memory_account.h core/mesh_attributes.h core/mesh_reader.h core/result.h core/run_context.h
  core/sample_mesh.h core/samples.h core/scratch.h core/summarize_mesh.h core/vec3.h
  io/open_mesh.h io/sample_writer.h)
foreach(header IN LISTS strata_public_headers)
  get_filename_component(folder ${header} DIRECTORY)
  install(FILES ${header} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/strata/${folder} COMPONENT dev)
endforeach()
install(FILES ${PROJECT_BINARY_DIR}/generated/core/version.h
  DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/strata/core COMPONENT dev)

add_library(strata_both INTERFACE)
target_link_libraries(strata_both INTERFACE strata_core strata_io)
set_target_properties(strata_core PROPERTIES EXPORT_NAME core)
set_target_properties(strata_io PROPERTIES EXPORT_NAME io)
set_target_properties(strata_both PROPERTIES EXPORT_NAME strata)
target_include_directories(strata_core INTERFACE
  $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/strata>)
target_compile_features(strata_core INTERFACE cxx_std_20)
add_library(strata::core ALIAS strata_core)
add_library(strata::io ALIAS strata_io)
add_library(strata::strata ALIAS strata_both)

# strata_compile holds flags for this build; it is exported because the libraries name it, and it
# carries nothing into an installed target's users.
install(TARGETS strata_core strata_io strata_both strata_compile EXPORT strataTargets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT dev)
install(TARGETS strata RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT strata)
foreach(helper strata_assimp strata_vdb)
  if(TARGET ${helper})
    install(TARGETS ${helper} RUNTIME DESTINATION ${CMAKE_INSTALL_LIBEXECDIR}/strata COMPONENT strata)
  endif()
endforeach()
if(STRATA_SERVICE)
  install(TARGETS strata_serve_program RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR}
    COMPONENT strata)
endif()

set(strata_package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/strata)
install(EXPORT strataTargets NAMESPACE strata:: DESTINATION ${strata_package_folder}
  COMPONENT dev)
configure_package_config_file(cmake/strataConfig.cmake.in
  ${PROJECT_BINARY_DIR}/strataConfig.cmake INSTALL_DESTINATION ${strata_package_folder})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/strataConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES
  ${PROJECT_BINARY_DIR}/strataConfig.cmake
  ${PROJECT_BINARY_DIR}/strataConfigVersion.cmake
  cmake/StrataLibraryDependencies.cmake
  cmake/FindWebP.cmake
  DESTINATION ${strata_package_folder} COMPONENT dev)
