# Sourced by the tests that need Node or packages of npm. What is missing skips them: status 77.
skip() {
  echo "skipped: $1"
  exit 77
}

# need_node [OLDEST]: Node, and of that major version or a newer one.
need_node() {
  command -v node >/dev/null || skip "node is missing"
  [ "$(node -p "Number(process.versions.node.split('.')[0]) >= ${1:-0}")" = true ] ||
    skip "node is older than $1: $(node --version)"
}

# install_packages FROM INTO: what FROM/package-lock.json names, into the folder INTO, once, and again when
# that file changes. One test at a time installs. Skips where the registry is out of reach.
install_packages() {
  command -v npm >/dev/null || skip "npm is missing"
  mkdir -p "$2"
  exec 9>"$2/.installing"
  flock 9
  if ! cmp -s "$1/package-lock.json" "$2/.installed"; then
    cp "$1/package.json" "$1/package-lock.json" "$1/.npmrc" "$2/"
    if ! (cd "$2" && npm ci --ignore-scripts) >"$2/npm.log" 2>&1; then
      cat "$2/npm.log"
      npm ping >/dev/null 2>&1 || skip "the package registry is out of reach"
      exit 1
    fi
    cp "$1/package-lock.json" "$2/.installed"
  fi
  flock -u 9
  exec 9>&-
}
