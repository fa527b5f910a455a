#!/bin/sh
# Holds docker/kubernetes against Kubernetes' schemas. Ends with 77, and says why, where what it needs is missing.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
. "$here/../../support/npm.sh"

need_node 20
[ -d "$here/node_modules/kubernetes-models" ] ||
  skip "the packages are missing: npm ci in tests/house/kubernetes"
manifests=$here/../../../docker/kubernetes
node "$here/check.mjs" --self-test "$manifests/strata.yaml"
exec node "$here/check.mjs" "$manifests"/*.yaml
