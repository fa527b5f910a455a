#!/usr/bin/env python3
"""How fast each format is read, and in how much memory, against the file's size.

    speed.py STRATA [--triangles N] [--runs N] [--json FILE]

Writes one mesh in every format (make_formats.py), reads each with `strata info`, which goes through all triangles
once, in turns, and prints a table: MB of the file as it is stored for each second of CPU time (medians; of assimp's process
too), the time over that of binary PLY, and the peak memory over the file's size. The process's own start is part of it.
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))

from measure import Command, run_once  # noqa: E402  (the path comes first)

HERE = pathlib.Path(__file__).resolve().parent
BASE = 'grid.ply'
# Beside the file itself.
COMPANIONS = {'grid.gltf': ['grid.bin']}
BY_ASSIMP = {'grid.x'}
NO_MESH = {'grid.bin'}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('strata', type=pathlib.Path)
    parser.add_argument('--triangles', type=int, default=1_000_000)
    parser.add_argument('--runs', type=int, default=5)
    parser.add_argument('--json', type=pathlib.Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, scratch = pathlib.Path(name) / 'meshes', pathlib.Path(name) / 'scratch'
        folder.mkdir(), scratch.mkdir()
        subprocess.run([sys.executable, HERE / 'make_formats.py', folder, str(arguments.triangles)], check=True)
        files = sorted((p for p in folder.iterdir() if p.name not in NO_MESH), key=lambda p: (p.name != BASE, p.name))
        costs, areas = {p.name: [] for p in files}, {}
        for _ in range(arguments.runs):
            for path in files:
                more = ['--assimp'] if path.name in BY_ASSIMP else []
                cost = run_once(Command([arguments.strata.resolve(), 'info', path, '--json', *more]), scratch)
                areas[path.name] = json.loads((scratch / 'stdout').read_text())['area']
                costs[path.name].append(cost)
        rows = []
        for path in files:
            size = sum((folder / n).stat().st_size for n in [path.name, *COMPANIONS.get(path.name, [])])
            cpu = statistics.median(c.cpu for c in costs[path.name])
            peak = max(c.peak_bytes for c in costs[path.name])
            rows.append({'file': path.name, 'mb': size / 1e6, 'mb_per_s': size / 1e6 / cpu, 'cpu': cpu,
                         'over_ply': cpu / statistics.median(c.cpu for c in costs[BASE]),
                         'peak_mb': peak / 1e6, 'peak_over_size': peak / size, 'area': areas[path.name]})
    print('| file | MB | MB/s of CPU | time / binary PLY | peak MB | peak / size |\n| --- | --- | --- | --- | --- | --- |')
    for row in rows:
        print('| {file} | {mb:.1f} | {mb_per_s:.0f} | {over_ply:.1f} | {peak_mb:.0f} | {peak_over_size:.1f} |'
              .format(**row))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    expected = areas[BASE]
    wrong = [r['file'] for r in rows if abs(r['area'] - expected) > 1e-5 * expected]
    if wrong:
        sys.exit(f'these have another area than {expected}: {wrong}')


if __name__ == '__main__':
    main()
