include(StrataLibraryDependencies)
# The command alone uses these.
find_package(CLI11 REQUIRED CONFIG)
# The service's stores: jobs, models and results on disk; names checked as UTF-8.
find_package(SQLite3 REQUIRED)
# The same for several processes.
find_package(PostgreSQL REQUIRED)
find_path(UTF8CPP_INCLUDE_DIR utf8cpp/utf8.h REQUIRED)
