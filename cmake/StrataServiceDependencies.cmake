# What `strata serve` links, beyond the command.
find_package(Protobuf REQUIRED)
find_package(gRPC REQUIRED CONFIG)
find_package(Boost 1.74 REQUIRED)
# Buckets: requests signed by libcurl, answers in XML.
find_package(CURL 7.86 REQUIRED)
find_package(pugixml REQUIRED CONFIG)
find_package(OpenSSL REQUIRED COMPONENTS Crypto SSL)
find_package(spdlog REQUIRED CONFIG)
find_package(prometheus-cpp REQUIRED CONFIG COMPONENTS core)
find_package(tomlplusplus REQUIRED CONFIG)
