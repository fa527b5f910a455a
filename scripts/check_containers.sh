#!/bin/bash
# Builds the image and runs the compose files with podman: one node through upload, kill and restart; the
# cluster through a rolling restart under load, without a failed request, kills and a restart of PostgreSQL;
# and the package's unit under a systemd in a container.
#
# usage: scripts/check_containers.sh [one-node|systemd|cluster]    Default: all.
# STRATA_CHECK_IMAGE names an image that was built already; "systemd" needs the package in build/package/deb.
# STRATA_DEBIAN_MIRROR names another mirror. Exit status 77, and the reason, where podman or what it needs
# is missing. Leaves the images, which are the next run's cache; `podman image prune` removes them.
set -euo pipefail
cd "$(dirname "$0")/.."
mirror=${STRATA_DEBIAN_MIRROR:-}  # Empty: debootstrap's own.
base=docker.io/library/debian:bookworm-slim

skip() {
  echo "Skipped: $1."
  exit 77
}
for program in podman podman-compose python3 curl; do
  command -v "$program" >/dev/null || skip "$program is missing: scripts/setup.sh containers"
done
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
# What a machine may allow: descriptors and processes within its own limits, runc where crun cannot work.
cat >"$scratch/containers.conf" <<'CONF'
[containers]
default_ulimits = ["nofile=20000:20000", "nproc=4096:4096"]
CONF
if command -v runc >/dev/null; then
  printf '[engine]\nruntime = "runc"\n' >>"$scratch/containers.conf"
fi
export CONTAINERS_CONF=${CONTAINERS_CONF:-$scratch/containers.conf}
podman info >/dev/null 2>"$scratch/error" || skip "podman does not run here: $(tail -n 1 "$scratch/error")"

if ! podman image exists "$base" && ! podman pull -q "$base" 2>/dev/null; then
  command -v debootstrap >/dev/null || skip "no registry and no debootstrap: scripts/setup.sh package"
  [ "$(id -u)" -eq 0 ] || skip "no registry, and debootstrap needs root"
  echo "--- No registry: a base image by debootstrap"
  debootstrap --variant=minbase bookworm "$scratch/base" ${mirror:+"$mirror"} >"$scratch/debootstrap.log"
  # As the slim image: without documents but licences, languages and what apt keeps.
  find "$scratch/base/usr/share/doc" -type f ! -name copyright -delete
  rm -rf "$scratch"/base/usr/share/{man,info,locale} "$scratch"/base/var/lib/apt/lists/* \
    "$scratch"/base/var/cache/apt/* "$scratch"/base/var/log/*
  tar -C "$scratch/base" -c . | podman import - "$base" >/dev/null
  rm -rf "$scratch/base"
fi

build() {  # NAME DOCKERFILE FOLDER
  echo "--- Building $1"
  podman build -q --pull=never --format docker --network host -t "$1" -f "$2" "$3" >/dev/null
}
if [ -n "${STRATA_CHECK_IMAGE:-}" ]; then
  export STRATA_IMAGE=$STRATA_CHECK_IMAGE
else
  export STRATA_IMAGE=localhost/strata
  build "$STRATA_IMAGE" docker/Dockerfile .
fi
parts=${1:-one-node systemd cluster}
case $parts in
  *cluster*)
    export STRATA_POSTGRES_IMAGE=localhost/strata-check-postgres STRATA_NGINX_IMAGE=localhost/strata-check-nginx
    build "$STRATA_POSTGRES_IMAGE" tests/containers/postgres.Dockerfile tests/containers
    build "$STRATA_NGINX_IMAGE" tests/containers/nginx.Dockerfile tests/containers
    ;;
esac
case $parts in
  *systemd*)
    package=(build/package/deb/strata_*.deb)
    [ -e "${package[0]}" ] || { echo "No package: cpack --preset package"; exit 1; }
    mkdir "$scratch/systemd"
    cp "${package[0]}" "$scratch/systemd/strata.deb"
    build localhost/strata-check-systemd tests/containers/systemd.Dockerfile "$scratch/systemd"
    ;;
esac
for part in $parts; do
  echo "--- ${part}"
  python3 "tests/containers/${part//-/_}_check.py"
done
