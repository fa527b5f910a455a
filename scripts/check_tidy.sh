#!/bin/sh
# Runs clang-tidy over the product's sources (needs the package clang-tidy-14 and a configured
# preset asan). Takes minutes, so it is no part of .ci/run.
set -eu
cd "$(dirname "$0")/.."
ls core/*.cc io/*.cc server/*.cc server/*/*.cc | xargs -n1 -P"$(nproc)" clang-tidy-14 -p build/asan --quiet
echo "The checks hold."
