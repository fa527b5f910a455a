# `cpack --preset package`: strata_VERSION_ARCH.deb, the programs, and libstrata-dev_VERSION_ARCH.deb, the
# library. What only a package holds (manual, completion, service) is excluded from `cmake --install`.
set(CPACK_PACKAGE_CONTACT "Strata maintainers <maintainers@strata.example>" CACHE STRING
  "Maintainer of the packages: name <address>")

# The library leaves its own libraries to the last link, so that who builds against it needs their
# headers: the package of each find_package in StrataLibraryDependencies.cmake; "-" is the compiler's own.
set(strata_library_packages
  Threads=- TBB=libtbb-dev tl-expected=libexpected-dev hwy=libhwy-dev FastFloat=libfast-float-dev
  draco=libdraco-dev ZLIB=zlib1g-dev zstd=libzstd-dev PNG=libpng-dev JPEG=libjpeg62-turbo-dev WebP=libwebp-dev
  LibArchive=libarchive-dev
  EXPAT=libexpat1-dev meshoptimizer=libmeshoptimizer-dev nlohmann_json=nlohmann-json3-dev OpenSSL=libssl-dev
  OpenVDB=libopenvdb-dev,libboost-iostreams-dev)
set(strata_dev_depends "")
file(STRINGS cmake/StrataLibraryDependencies.cmake strata_finds REGEX "^ *find_package\\(")
foreach(find IN LISTS strata_finds)
  string(REGEX REPLACE "^ *find_package\\(([^ )]+).*" "\\1" name "${find}")
  set(rows ${strata_library_packages})
  list(FILTER rows INCLUDE REGEX "^${name}=")
  if(NOT rows)
    message(FATAL_ERROR "cmake/StrataPackage.cmake: no Debian package stands for ${name}")
  endif()
  string(REGEX REPLACE "^[^=]*=" "" packages "${rows}")
  string(REPLACE "," ";" packages "${packages}")
  list(APPEND strata_dev_depends ${packages})
endforeach()
list(REMOVE_ITEM strata_dev_depends -)
list(JOIN strata_dev_depends ", " strata_dev_depends)

# Dates inside the packages are the source's, so that two builds are the same.
if(DEFINED ENV{SOURCE_DATE_EPOCH})
  set(strata_epoch $ENV{SOURCE_DATE_EPOCH})
else()
  execute_process(COMMAND git log -1 --format=%ct WORKING_DIRECTORY ${PROJECT_SOURCE_DIR}
    OUTPUT_VARIABLE strata_epoch OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
endif()
if(NOT strata_epoch)
  string(TIMESTAMP strata_epoch "%s" UTC)
endif()
execute_process(COMMAND date -u -R -d @${strata_epoch} OUTPUT_VARIABLE strata_changelog_date
  OUTPUT_STRIP_TRAILING_WHITESPACE)

# Debian wants its documents packed, and without the time of packing.
set(strata_debian ${PROJECT_BINARY_DIR}/debian)
file(MAKE_DIRECTORY ${strata_debian}/man)
configure_file(packaging/debian/changelog.in ${strata_debian}/changelog.Debian @ONLY)
function(strata_gzip from to)
  execute_process(COMMAND gzip -9nc ${from} OUTPUT_FILE ${to} COMMAND_ERROR_IS_FATAL ANY)
endfunction()
strata_gzip(${strata_debian}/changelog.Debian ${strata_debian}/changelog.Debian.gz)
strata_gzip(${PROJECT_SOURCE_DIR}/CHANGELOG.md ${strata_debian}/changelog.gz)
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/CHANGELOG.md)

# --- What goes in --------------------------------------------------------------------------------

function(strata_package_files component package)
  install(FILES packaging/debian/copyright ${strata_debian}/changelog.gz
    ${strata_debian}/changelog.Debian.gz
    DESTINATION share/doc/${package} COMPONENT ${component} EXCLUDE_FROM_ALL)
  install(FILES packaging/debian/${package}.lintian-overrides RENAME ${package}
    DESTINATION share/lintian/overrides COMPONENT ${component} EXCLUDE_FROM_ALL)
endfunction()
strata_package_files(strata strata)
strata_package_files(dev libstrata-dev)

# The manual's pages exist once the build is done: they are packed on the way.
install(CODE "
  file(GLOB pages ${STRATA_PAGES_FOLDER}/man/*.1)
  foreach(page IN LISTS pages)
    get_filename_component(name \${page} NAME)
    execute_process(COMMAND gzip -9nc \${page} OUTPUT_FILE ${strata_debian}/man/\${name}.gz
      COMMAND_ERROR_IS_FATAL ANY)
  endforeach()" COMPONENT strata EXCLUDE_FROM_ALL)
install(DIRECTORY ${strata_debian}/man/ DESTINATION share/man/man1 COMPONENT strata EXCLUDE_FROM_ALL)
install(FILES ${STRATA_PAGES_FOLDER}/completion/strata
  DESTINATION share/bash-completion/completions COMPONENT strata EXCLUDE_FROM_ALL)
install(FILES ${STRATA_PAGES_FOLDER}/completion/_strata
  DESTINATION share/zsh/vendor-completions COMPONENT strata EXCLUDE_FROM_ALL)
install(FILES ${STRATA_PAGES_FOLDER}/completion/strata.fish
  DESTINATION share/fish/vendor_completions.d COMPONENT strata EXCLUDE_FROM_ALL)
install(FILES packaging/strata.toml
  DESTINATION /etc/strata COMPONENT strata EXCLUDE_FROM_ALL)
install(FILES packaging/strata.service
  DESTINATION lib/systemd/system COMPONENT strata EXCLUDE_FROM_ALL)

# --- How it is packed ----------------------------------------------------------------------------

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME strata)
set(CPACK_PACKAGE_VENDOR "Strata maintainers")
set(CPACK_PACKAGE_DIRECTORY ${PROJECT_BINARY_DIR}/deb)
set(CPACK_COMPONENTS_ALL strata dev)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_SET_DESTDIR ON)  # /etc is not below the prefix.
set(CPACK_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)

set(CPACK_DEBIAN_STRATA_PACKAGE_NAME strata)
set(CPACK_DEBIAN_STRATA_PACKAGE_SECTION graphics)
set(CPACK_DEBIAN_STRATA_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_STRATA_PACKAGE_CONTROL_EXTRA
  ${PROJECT_SOURCE_DIR}/packaging/debian/postinst ${PROJECT_SOURCE_DIR}/packaging/debian/prerm
  ${PROJECT_SOURCE_DIR}/packaging/debian/postrm ${PROJECT_SOURCE_DIR}/packaging/debian/conffiles)
set(strata_description
"Strata lays a lattice of cells over the surface of a mesh and draws one sample
per cell, then removes samples that are too close together. The same surface,
options and seed give the same samples on every machine.
.
")
set(CPACK_DEBIAN_STRATA_DESCRIPTION
"${strata_description}This package holds the command, and the service that answers over HTTP and
gRPC with a viewer for browsers. The service is not enabled by installing it.")

set(CPACK_DEBIAN_DEV_PACKAGE_NAME libstrata-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS "${strata_dev_depends}")
set(CPACK_DEBIAN_DEV_PACKAGE_SUGGESTS "strata (= ${PROJECT_VERSION}-1)")
set(CPACK_DEBIAN_DEV_DESCRIPTION
"${strata_description}This package holds the static libraries, their headers and a CMake package
with the target strata::strata.")
include(CPack)
