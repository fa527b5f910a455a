#!/bin/sh
# From a fresh Debian 12 to a tested build: installs what is missing, builds with g++ and, under
# AddressSanitizer and UndefinedBehaviorSanitizer, with clang++, and runs both test-suites.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh build test
jobs=$(nproc)

cmake --preset asan
cmake --build --preset asan
cmake --preset ci "-DSTRATA_OTHER_BINARY=$PWD/build/asan/server/strata"
cmake --build --preset ci

status=0
echo "--- Under ASan and UBSan, what is not labelled long"
ctest --preset asan -j "$jobs" -LE long || status=1
echo "--- Everything"
ctest --preset ci -j "$jobs" || status=1
exit "$status"
