#!/bin/sh
# Tells nginx.conf which name server this container has, then becomes nginx.
set -eu
sed -n 's/^nameserver *\([0-9.]*\).*/resolver \1 valid=1s ipv6=off;/p' /etc/resolv.conf | head -n 1 >/tmp/resolver.conf
exec nginx -g 'daemon off;'
