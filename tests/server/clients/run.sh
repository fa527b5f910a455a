#!/bin/sh
# Runs one of the tests with clients from npm: tus or openapi.
# usage: run.sh TEST STRATA FOLDER   (FOLDER takes the packages; several tests may share it)
# Ends with 77, and says why, where what it needs is missing.
set -eu
test=$1 strata=$2 folder=$3
here=$(cd "$(dirname "$0")" && pwd)
skip() {
  echo "skipped: $1"
  exit 77
}

command -v node >/dev/null || skip "node is missing"
command -v npm >/dev/null || skip "npm is missing"
[ "$(node -p 'Number(process.versions.node.split(".")[0]) >= 20')" = true ] ||
  skip "node is older than 20: $(node --version)"

# The packages lie outside the source, and are installed when the lock file changes. One test at a
# time installs.
mkdir -p "$folder"
exec 9>"$folder/.installing"
flock 9
if ! cmp -s "$here/package-lock.json" "$folder/.installed"; then
  cp "$here/package.json" "$here/package-lock.json" "$here/.npmrc" "$folder/"
  if ! (cd "$folder" && npm ci --ignore-scripts) >"$folder/npm.log" 2>&1; then
    cat "$folder/npm.log"
    npm ping >/dev/null 2>&1 || skip "the package registry is out of reach"
    exit 1
  fi
  cp "$here/package-lock.json" "$folder/.installed"
fi
cp "$here"/*.mjs "$folder/"
flock -u 9
cd "$folder"
STRATA=$strata SOURCE=$here/../../.. exec node --test --test-reporter spec "${test}_test.mjs"
