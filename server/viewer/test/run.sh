#!/bin/sh
# Runs one of the viewer's tests: units, dist or page. usage: run.sh TEST STRATA
# Ends with 77, and says why, where what it needs is missing.
set -eu
test=$1
viewer=$(cd "$(dirname "$0")/.." && pwd)
. "$viewer/../../tests/support/npm.sh"

need_node 20
if [ "$test" != units ]; then
  [ -d "$viewer/node_modules/vite" ] || skip "the packages are missing: npm ci in server/viewer"
fi
if [ "$test" = page ]; then
  [ -x "${CHROMIUM:-/usr/bin/chromium}" ] || skip "chromium is missing: scripts/setup.sh viewer"
fi
STRATA=$2 exec node --test --test-reporter spec "$viewer/test/${test}_test.mjs"
