# What libstrata links. Used by this build and, installed beside strataConfig.cmake, by every
# program that finds Strata: its static libraries leave their own libraries to the last link.
find_package(Threads REQUIRED)
find_package(TBB REQUIRED CONFIG)
find_package(tl-expected REQUIRED CONFIG)
find_package(hwy REQUIRED CONFIG)
find_package(FastFloat REQUIRED CONFIG)
find_package(draco REQUIRED CONFIG)
find_package(ZLIB REQUIRED)
find_package(zstd REQUIRED CONFIG)
find_package(PNG REQUIRED)
find_package(LibArchive REQUIRED)
find_package(EXPAT REQUIRED)
find_package(meshoptimizer REQUIRED CONFIG)
find_package(nlohmann_json REQUIRED CONFIG)
find_package(OpenSSL REQUIRED COMPONENTS Crypto)

# Debian's FindOpenVDB lies beside the package, and sets BUILD_SHARED_LIBS in its caller's scope.
list(APPEND CMAKE_MODULE_PATH "/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/cmake/OpenVDB")
set(strata_build_shared_libs "${BUILD_SHARED_LIBS}")
find_package(OpenVDB 10 REQUIRED COMPONENTS openvdb)
set(BUILD_SHARED_LIBS "${strata_build_shared_libs}")
