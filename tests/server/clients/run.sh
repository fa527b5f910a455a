#!/bin/sh
# Runs one of the tests with clients from npm: tus or openapi.
# usage: run.sh TEST STRATA FOLDER   (FOLDER takes the packages; several tests may share it)
# Ends with 77, and says why, where what it needs is missing.
set -eu
test=$1 strata=$2 folder=$3
here=$(cd "$(dirname "$0")" && pwd)
. "$here/../../support/npm.sh"

need_node 20
install_packages "$here" "$folder"  # Outside the source.
cp "$here"/*.mjs "$folder/"
cd "$folder"
STRATA=$strata SOURCE=$here/../../.. exec node --test --test-reporter spec "${test}_test.mjs"
