include(StrataLibraryDependencies)
# The command alone uses these.
find_package(CLI11 REQUIRED CONFIG)
