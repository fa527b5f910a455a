#!/usr/bin/env python3
"""What sending the parts of an upload beside each other gains: two builds of tests/server/s3's s3_tool put the same
file in turns, over a line that holds each answer back. The figures go to docs/adr/0026.

usage: parts.py --tool PATH --other PATH [--megabytes N] [--delay SECONDS] [--rounds N]

The store is that of the tests: in this process, on loopback, signatures checked."""
import argparse
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / 'server' / 's3'))
import store  # noqa: E402


class Line:
    """A store at the end of a line with a delay."""

    def __init__(self, seconds):
        self.seconds = seconds
        self.memory = store.Memory()

    def handle(self, request):
        time.sleep(self.seconds)  # What is measured, not what is waited for.
        return self.memory.handle(request)


def put(tool, file, line):
    started = time.monotonic()
    subprocess.run([tool, 'put', 's3://bucket/object', file], check=True, stdout=subprocess.DEVNULL,
                   env={**os.environ, **line.environment()})
    return time.monotonic() - started


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--tool', required=True)
    parser.add_argument('--other', required=True)
    parser.add_argument('--megabytes', type=int, default=128)
    parser.add_argument('--delay', type=float, default=0.03)
    parser.add_argument('--rounds', type=int, default=5)
    args = parser.parse_args()
    with tempfile.NamedTemporaryFile() as file:
        file.write(os.urandom(1 << 20) * args.megabytes)
        file.flush()
        line = store.Store(Line(args.delay))
        try:
            pairs = [(put(args.tool, file.name, line), put(args.other, file.name, line))
                     for _ in range(args.rounds)]
        finally:
            line.close()
    tool, other = zip(*pairs)
    print(f'{args.megabytes} MiB, answers {1000 * args.delay:.0f} ms late: '
          f'{statistics.median(tool):.2f} s and {statistics.median(other):.2f} s, '
          f'ratio {statistics.median(b / a for a, b in pairs):.2f} '
          f'({min(b / a for a, b in pairs):.2f} to {max(b / a for a, b in pairs):.2f})')


if __name__ == '__main__':
    main()
