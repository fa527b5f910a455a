#!/usr/bin/env python3
"""What `strata batch` costs: two workers against one, and the overhead a model. For an idle machine; the
figures go to docs/batch.md and docs/adr/0018.

usage: batch.py --strata PATH --make-mesh PATH [--models N] [--rounds R] [--folder DIR]"""
import argparse
import json
import os
import pathlib
import resource
import shutil
import statistics
import subprocess
import tempfile
import time

CUBE = ('OFF\n8 6 0\n-0.{0:03d} 0 -0.{1:03d}\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n'
        '4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n')


def make_tiny(folder, count):
    for i in range(count):
        place = folder / f'{i % 100:02d}'
        place.mkdir(parents=True, exist_ok=True)
        (place / f'{i:05d}.off').write_text(CUBE.format(i % 997, i // 997))


def make_medium(folder, make_mesh):
    folder.mkdir()
    for i in range(24):
        subprocess.run([make_mesh, 'sphere', '--triangles', str(60_000 + 997 * i), '-o',
                        folder / f'{i}.ply'], check=True)


def run(strata, repo, out, *options):
    """Wall and processor seconds of one batch from nothing."""
    shutil.rmtree(out, ignore_errors=True)
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run([strata, 'batch', repo, '-o', out, '--pictures', '0', '--quiet', *options],
                   check=True)
    wall = time.monotonic() - started
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def lines(out):
    return [json.loads(line) for line in (out / 'manifest.jsonl').read_text().splitlines()]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--strata', required=True)
    parser.add_argument('--make-mesh', required=True)
    parser.add_argument('--models', type=int, default=10_000)
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--folder', help='where to work; default the system\'s temporary folder')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = pathlib.Path(name)
        out = folder / 'out'
        make_medium(folder / 'medium', options.make_mesh)
        ratios, rates = [], []
        for _ in range(options.rounds):  # In pairs, so that a busy moment meets both.
            one, _ = run(options.strata, folder / 'medium', out, '--resolution', '300', '--jobs', '1')
            two, _ = run(options.strata, folder / 'medium', out, '--resolution', '300', '--jobs', '2')
            ratios.append(one / two)
            rates.append(24 / two)
        print(f'24 models of 60,000 triangles, resolution 300: {statistics.median(rates):.2f} models/s '
              f'on two workers, {statistics.median(ratios):.2f} times one '
              f'({min(ratios):.2f} to {max(ratios):.2f})')
        make_tiny(folder / 'tiny', options.models)
        wall, processor = run(options.strata, folder / 'tiny', out, '--resolution', '8')
        sampled = sum(line['measured']['seconds'] for line in lines(out))
        print(f'{options.models} tiny models: {options.models / wall:.0f} models/s, '
              f'{1e3 * processor / options.models:.2f} ms of processor and '
              f'{1e3 * wall / options.models:.2f} ms of wall time a model')
        lanes = os.cpu_count()
        print(f'of it outside the workers\' own time: '
              f'{1e3 * (wall - sampled / lanes) / options.models:.3f} ms a model on {lanes} workers')
        started = time.monotonic()
        subprocess.run([options.strata, 'batch', folder / 'tiny', '-o', out, '--pictures', '0', '--quiet',
                        '--resolution', '8'], check=True)
        print(f'the same again, nothing to do: {time.monotonic() - started:.2f} s')


if __name__ == '__main__':
    main()
