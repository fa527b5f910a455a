#!/bin/sh
# Prints the table of jobs larger than memory. `run.sh --help` says what it takes.
# Debian's own interpreter: it is the one that sees Debian's NumPy.
exec /usr/bin/python3 "$(dirname "$0")/outofcore.py" "$@"
