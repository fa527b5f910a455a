#!/bin/sh
# Installs what Strata needs on Debian 12, and only what is missing.
# usage: scripts/setup.sh build|test...
set -eu
list=$(dirname "$0")/debian-packages.txt

missing=""
for part in "$@"; do
  for package in $(sed -n "s/^$part  *//p" "$list"); do
    case $(dpkg-query -W -f='${db:Status-Abbrev}' "$package" 2>/dev/null || true) in
      ii*) ;;
      *) missing="$missing $package" ;;
    esac
  done
done
[ -n "$missing" ] || exit 0

as_root=""
if [ "$(id -u)" -ne 0 ]; then
  if ! command -v sudo >/dev/null; then
    echo "These packages are missing, and installing them needs root or sudo:$missing" >&2
    exit 1
  fi
  as_root="sudo"
fi
apt() {
  $as_root env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o DPkg::Lock::Timeout=300 \
    -o Acquire::Retries=3 -o Dpkg::Use-Pty=0 "$@"
}
echo "Installing:$missing"
apt update
# shellcheck disable=SC2086  # A list of names, split on purpose.
apt install --no-install-recommends $missing
