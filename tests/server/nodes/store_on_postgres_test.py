#!/usr/bin/env python3
"""Runs the stores' own tests over PostgreSQL: what they state holds over both databases."""
import os
import subprocess
import sys

import cluster


def main():
    cluster.skip_without_postgres()
    postgres = cluster.Cluster()
    try:
        environment = {**os.environ, 'STRATA_TEST_POSTGRES': postgres.url()}
        failed = [program for program in sys.argv[1:]
                  if subprocess.run([program, '--gtest_brief=1'], env=environment, timeout=500).returncode]
    finally:
        postgres.stop()
    print('failed: ' + ', '.join(failed) if failed else 'all hold over PostgreSQL')
    return bool(failed)


if __name__ == '__main__':
    sys.exit(main())
