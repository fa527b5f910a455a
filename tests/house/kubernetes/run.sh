#!/bin/sh
# Holds docker/kubernetes against Kubernetes' schemas. Ends with 77, and says why, where what it needs is missing.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
skip() {
  echo "skipped: $1"
  exit 77
}
command -v node >/dev/null || skip "node is missing"
[ "$(node -p 'Number(process.versions.node.split(".")[0]) >= 20')" = true ] ||
  skip "node is older than 20: $(node --version)"
[ -d "$here/node_modules/kubernetes-models" ] ||
  skip "the packages are missing: npm ci in tests/house/kubernetes"
manifests=$here/../../../docker/kubernetes
node "$here/check.mjs" --self-test "$manifests/strata.yaml"
exec node "$here/check.mjs" "$manifests"/*.yaml
