#!/bin/sh
# Runs a test against s3rver, which npm installs into FOLDER.
# usage: run.sh FOLDER COMMAND...   (s3rver's program is passed on as $S3RVER)
# Ends with 77, and says why, where what it needs is missing.
set -eu
folder=$1
shift
here=$(cd "$(dirname "$0")" && pwd)
skip() {
  echo "skipped: $1"
  exit 77
}

command -v node >/dev/null || skip "node is missing"
command -v npm >/dev/null || skip "npm is missing"
if ! cmp -s "$here/package-lock.json" "$folder/installed"; then
  mkdir -p "$folder"
  cp "$here/package.json" "$here/package-lock.json" "$here/.npmrc" "$folder"
  (cd "$folder" && npm ci --ignore-scripts --fetch-retries 1 >npm.log 2>&1) ||
    skip "npm ci fails: see $folder/npm.log"
  cp "$here/package-lock.json" "$folder/installed"
fi
S3RVER="$folder/node_modules/s3rver/bin/s3rver.js"
[ -f "$S3RVER" ] || S3RVER="$folder/node_modules/.bin/s3rver"
export S3RVER
exec "$@"
