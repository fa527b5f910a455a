#!/bin/sh
# From a fresh Debian 12 to a first result: installs what is missing, builds, samples a model.
set -eu
cd "$(dirname "$0")/.."
scripts/setup.sh build
cmake --preset release -DSTRATA_TESTS=OFF
cmake --build --preset release --target strata

out=build/quickstart
mkdir -p "$out"
build/release/server/strata sample models/spot.obj -o "$out/spot.ply" --resolution 64 \
  --picture "$out/spot.png" --summary "$out/spot.json"
echo
echo "The command:  $PWD/build/release/server/strata"
echo "The samples:  $PWD/$out/spot.ply"
echo "The summary:  $PWD/$out/spot.json"
echo "The picture:  $PWD/$out/spot.png"
