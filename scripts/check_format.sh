#!/bin/sh
# Fails when clang-format would change a source file; --fix lets it.
set -eu
cd "$(dirname "$0")/.."
mode="--dry-run -Werror"
[ "${1:-}" != "--fix" ] || mode="-i"
# shellcheck disable=SC2086  # Two words, split on purpose.
find core io server tests -name '*.cc' -o -name '*.h' | sort | xargs clang-format-14 $mode
echo "The format holds."
