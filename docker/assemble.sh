#!/bin/sh
# Inside a build stage that has strata.deb installed: puts what the image needs, and nothing else, below ROOT. That
# is: the programs, the shared libraries that they load, a shell with a few tools (busybox) for the schedulers'
# templates, certificates of authorities, the licences, and for scanners the records of the packages
# that all this is from.
# usage: assemble.sh ROOT [VDB]    With VDB (not empty) what writes vdb, too, and OpenVDB's library.
set -eu
root=$1
without=/strata-vdb$
[ -z "${2:-}" ] || without='^$'
tools='[ cat cp date df du echo env expr false head hostname id kill ls mkdir mv nproc printf ps pwd rm rmdir
  sed seq sh sha256sum sleep sort stat tail tee test touch tr true uname wc'

# Debian 12 merges /lib, /bin into /usr: the copy has the same links, and files by their real folders.
mkdir -p "$root/usr"
for link in bin lib lib64 sbin; do
  [ ! -L "/$link" ] || ln -s "usr/$link" "$root/$link"
done
keep() {  # What is at the name, under the same name.
  folder=$(realpath "$(dirname "$1")")
  mkdir -p "$root$folder"
  cp -L --preserve=mode,timestamps "$1" "$root$folder/$(basename "$1")"
}

programs=$(dpkg-query -L strata | grep '^/usr/bin/\|^/usr/libexec/strata/.' | grep -v "$without" || true)
libraries=$(for program in $programs; do ldd "$program"; done |
  sed -n 's/^.*=> \(\/[^ ]*\) .*$/\1/p; s/^\t\(\/[^ ]*\) .*$/\1/p' | sort -u)
for file in $programs $libraries /bin/busybox /etc/ssl/certs/ca-certificates.crt; do
  keep "$file"
done
for tool in $tools; do
  ln -s busybox "$root/usr/bin/$tool"
done
cp -a --parents /usr/lib/locale/C.utf8 /etc/strata /etc/nsswitch.conf "$root"
ldconfig -r "$root" -X && rm -rf "$root/var/cache/ldconfig"

# Whose files these are: owners, licences.
packages=$(for file in $programs $libraries /bin/busybox; do
  dpkg-query -S "$(realpath "$file")" 2>/dev/null || dpkg-query -S "$file"
done | sed 's/:.*//' | sort -u)
mkdir -p "$root/var/lib/dpkg/status.d"
for package in $packages ca-certificates; do
  dpkg-query -s "$package" >"$root/var/lib/dpkg/status.d/$package"
  keep "/usr/share/doc/$package/copyright"
done
cp -a --parents /usr/share/common-licenses "$root"

printf 'root:x:0:0:root:/:/sbin/nologin\nstrata:x:10001:10001:Strata:/data:/sbin/nologin\n' >"$root/etc/passwd"
printf 'root:x:0:\nstrata:x:10001:\n' >"$root/etc/group"
cp -L /etc/os-release "$root/etc/os-release"
install -d -m 1777 "$root/tmp"
# The service's own, so that fresh volumes are, too.
install -d -o 10001 -g 10001 -m 0700 "$root/data" "$root/scratch"
