#!/bin/sh
# Runs a test against s3rver, which npm installs into FOLDER.
# usage: run.sh FOLDER COMMAND...   (s3rver's program is passed on as $S3RVER)
# Ends with 77, and says why, where what it needs is missing.
set -eu
folder=$1
shift
here=$(cd "$(dirname "$0")" && pwd)
. "$here/../../support/npm.sh"

need_node
install_packages "$here" "$folder"
S3RVER="$folder/node_modules/s3rver/bin/s3rver.js"
[ -f "$S3RVER" ] || S3RVER="$folder/node_modules/.bin/s3rver"
export S3RVER
exec "$@"
