#!/bin/bash
# Proves the Debian packages on a fresh Debian 12: builds them, holds them against lintian, installs
# them in a chroot of their own, samples a mesh, starts and stops the service, builds the README's
# program against libstrata-dev, and looks for what a purge leaves behind.
#
# usage: scripts/check_package.sh [FOLDER]    Needs root. FOLDER (default build/package/chroot) keeps
# the fresh system for the next time. STRATA_DEBIAN_MIRROR names another mirror.
# Exit status 77: root, debootstrap or the right to mount is missing.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$(realpath -m "${1:-build/package/chroot}")
mirror=${STRATA_DEBIAN_MIRROR:-}  # Empty: debootstrap's own.
root=$folder/root

skip() {
  echo "Skipped: $1."
  exit 77
}
[ "$(id -u)" -eq 0 ] || skip "it needs root"
for program in debootstrap lintian dpkg-shlibdeps unshare; do
  command -v "$program" >/dev/null || skip "$program is missing: scripts/setup.sh package"
done
unshare --mount true 2>/dev/null || skip "mounting is not allowed here"

step() { echo "--- $1"; }
# shellcheck disable=SC2016  # What is quoted is for the shell inside.
inside() {  # A shell's words, in a mount namespace that ends with them: no mount is left over.
  unshare --mount --pid --fork sh -euc '
    root=$1
    mount --make-rprivate /
    mount -t proc proc "$root/proc"
    mount -t tmpfs tmpfs "$root/dev/shm"
    exec chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 \
      DEBIAN_FRONTEND=noninteractive bash -euo pipefail -c "$2"' sh "$root" "$1"
}

step "Packages"
cmake --preset package
cmake --build --preset package
rm -rf build/package/deb
cpack --preset package
packages=(build/package/deb/*.deb)
[ ${#packages[@]} -eq 2 ] || { echo "expected 2 packages, found ${packages[*]}"; exit 1; }

step "lintian"
lintian --allow-root --fail-on error,warning "${packages[@]}"

step "A fresh Debian 12"
mkdir -p "$folder"
if [ ! -e "$folder/fresh.tar" ]; then
  rm -rf "$folder/base"
  debootstrap --variant=minbase bookworm "$folder/base" ${mirror:+"$mirror"} >"$folder/debootstrap.log"
  tar -C "$folder/base" -cf "$folder/fresh.tar.part" .
  mv "$folder/fresh.tar.part" "$folder/fresh.tar"
  rm -rf "$folder/base"
fi
rm -rf "$root"
mkdir "$root"
trap 'rm -rf "$root"' EXIT
tar -C "$root" -xf "$folder/fresh.tar"
cp /etc/resolv.conf "$root/etc/resolv.conf"
printf '#!/bin/sh\nexit 101\n' >"$root/usr/sbin/policy-rc.d"
chmod 755 "$root/usr/sbin/policy-rc.d"
mkdir "$root/strata"
cp "${packages[@]}" models/spot.obj "$root/strata/"
inside 'apt-get -q update'
files() { (cd "$root" && find etc usr var -path var/cache/apt -prune -o -path var/lib/apt -prune -o \
  -path var/lib/dpkg -prune -o -path var/log -prune -o -print | sort); }
files >"$folder/before"

step "strata: install, sample, look at the manual's files"
inside 'apt-get -q -y install --no-install-recommends /strata/strata_*.deb'
inside 'cd /strata && strata --version && strata info spot.obj &&
  strata sample spot.obj -o spot.ply --resolution 64 --quiet &&
  strata sample spot.obj -o spot.vdb --resolution 64 --quiet'
for format in ply vdb; do
  build/package/server/strata sample models/spot.obj -o "$folder/here.$format" --resolution 64 --quiet
  cmp "$folder/here.$format" "$root/strata/spot.$format"
done
for page in strata strata-sample strata-serve; do
  gzip -t "$root/usr/share/man/man1/$page.1.gz" 2>/dev/null || echo "note: $page(1) is left out by the chroot's dpkg"
done

step "strata: the service starts, answers, ends, as a user without rights"
inside 'install -d -o nobody -g nogroup /var/lib/strata /var/cache/strata
  setpriv --reuid=nobody --regid=nogroup --clear-groups --no-new-privs --bounding-set=-all \
    strata serve --config /etc/strata/strata.toml --http 127.0.0.1:0 --grpc 127.0.0.1:0 2>/strata/log &
  service=$!
  for try in $(seq 300); do
    port=$(sed -n "s/.* http=127.0.0.1:\([0-9]*\).*/\1/p" /strata/log)
    [ -z "$port" ] || break
    kill -0 $service || { cat /strata/log; exit 1; }
    sleep 0.1
  done
  strata health "http://127.0.0.1:$port/readyz"
  kill -TERM $service
  wait $service
  grep -c stopped /strata/log'

step "strata: remove keeps data and configuration, purge keeps nothing"
inside 'touch /var/lib/strata/kept; apt-get -q -y remove strata
  [ -e /etc/strata/strata.toml ] && [ -e /var/lib/strata/kept ] && ! command -v strata
  apt-get -q -y purge strata; apt-get -q -y autoremove --purge'
files >"$folder/after"
# What other packages' scripts leave (caches of ld.so, users) is not Strata's.
if left=$(comm -13 "$folder/before" "$folder/after" | grep -i strata); then
  echo "A purge leaves: $left"
  exit 1
fi

step "libstrata-dev: the README's program"
inside 'apt-get -q -y install --no-install-recommends /strata/libstrata-dev_*.deb g++ cmake make'
PYTHONPATH=tests/house python3 - "$root/strata" <<'PYTHON'
import pathlib
import sys
from marked_blocks import marked_blocks
blocks = marked_blocks('.')
for name in ('CMakeLists.txt', 'points.cc'):
    pathlib.Path(sys.argv[1], name).write_text(blocks[name])
PYTHON
inside 'cd /strata && cmake -S . -B program && cmake --build program && program/points spot.obj points.ply'
cmp <(tail -c 1000 "$folder/here.ply") <(tail -c 1000 "$root/strata/points.ply")
inside 'apt-get -q -y purge libstrata-dev'
if [ -e "$root/usr/include/strata" ]; then
  echo "A purge of libstrata-dev leaves its headers"
  exit 1
fi
echo "Both packages install, work and go away."
