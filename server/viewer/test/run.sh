#!/bin/sh
# Runs one of the viewer's tests: units, dist or page. usage: run.sh TEST STRATA
# Ends with 77, and says why, where what it needs is missing.
set -eu
test=$1
viewer=$(cd "$(dirname "$0")/.." && pwd)
skip() {
  echo "skipped: $1"
  exit 77
}

command -v node >/dev/null || skip "node is missing"
[ "$(node -p 'Number(process.versions.node.split(".")[0]) >= 20')" = true ] ||
  skip "node is older than 20: $(node --version)"
if [ "$test" != units ]; then
  [ -d "$viewer/node_modules/vite" ] || skip "the packages are missing: npm ci in server/viewer"
fi
if [ "$test" = page ]; then
  [ -x "${CHROMIUM:-/usr/bin/chromium}" ] || skip "chromium is missing: scripts/setup.sh viewer"
fi
STRATA=$2 exec node --test --test-reporter spec "$viewer/test/${test}_test.mjs"
