#!/bin/sh
# Builds oneTBB for ThreadSanitizer, from Debian's source package, into build/tsan-tbb/install.
# Needs: scripts/setup.sh build test, and dpkg-dev (root or sudo are used only to install that).
set -eu
cd "$(dirname "$0")/.."
work=$PWD/build/tsan-tbb
mkdir -p "$work/lists/partial"

if ! command -v dpkg-source >/dev/null; then
  as_root=""
  [ "$(id -u)" -eq 0 ] || as_root="sudo"
  $as_root env DEBIAN_FRONTEND=noninteractive apt-get -q -y install --no-install-recommends dpkg-dev
fi

# The machine's own package sources, as source packages and in lists of our own, so that nothing of
# its configuration changes.
{
  sed -n 's/^deb /deb-src /p' /etc/apt/sources.list 2>/dev/null || true
  for file in /etc/apt/sources.list.d/*.list; do
    [ ! -f "$file" ] || sed -n 's/^deb /deb-src /p' "$file"
  done
  for file in /etc/apt/sources.list.d/*.sources; do
    [ -f "$file" ] || continue
    awk '/^URIs:/ {uri = $2} /^Suites:/ {n = NF; for (i = 2; i <= NF; ++i) suite[i] = $i}
         function emit(  i) { if (uri != "") for (i = 2; i <= n; ++i)
           print "deb-src", uri, suite[i], "main"; uri = "" }
         /^$/ {emit()} END {emit()}' "$file"
  done
} > "$work/sources.list"
apt_source="-o Dir::Etc::SourceList=$work/sources.list -o Dir::Etc::SourceParts=-
            -o Dir::State::Lists=$work/lists -o APT::Sandbox::User="
# shellcheck disable=SC2086  # A list of options, split on purpose.
apt-get -q $apt_source update
cd "$work"
rm -rf onetbb-*/
# shellcheck disable=SC2086
apt-get -q $apt_source source onetbb
cmake -S "$(find . -maxdepth 1 -type d -name 'onetbb-*')" -B "$work/build" -G Ninja \
  -DCMAKE_CXX_COMPILER=clang++-14 -DCMAKE_C_COMPILER=clang-14 -DCMAKE_BUILD_TYPE=RelWithDebInfo \
  -DTBB_SANITIZE=thread -DTBB_TEST=OFF -DTBB_STRICT=OFF \
  -DCMAKE_INSTALL_PREFIX="$work/install" -DCMAKE_INSTALL_LIBDIR=lib
cmake --build "$work/build"
cmake --install "$work/build"
echo "Done. Next: cmake --preset tsan && cmake --build --preset tsan && ctest --preset tsan"
