#!/bin/sh
# Prints the table of speed: ratios measured in one run. `run.sh --help` says what it takes.
# Debian's own interpreter: it is the one that sees Debian's NumPy and Open3D.
exec /usr/bin/python3 "$(dirname "$0")/bench.py" "$@"
