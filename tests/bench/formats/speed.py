#!/usr/bin/env python3
"""How fast each format is read, and in how much memory, against the file's size.

    speed.py STRATA [--triangles N] [--runs N] [--json FILE]

Writes one mesh in every format (make_formats.py), reads each with `strata info` and with `strata sample
--resolution 4`, in turns, and prints a table: MB of the file as it is stored for each second of CPU time (medians;
of assimp's process too), both times over those of binary PLY, and the peak memory over the file's size. The process's
own start is part of it.

`info` reads the triangles once, and the ids that glTF, 3MF and assimp's scenes have in a second pass for their ranges;
`sample` reads formats without a list of vertices in the world (STL, glTF, 3MF, assimp's) twice, first for the
lattice, and races all triangles.
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
        costs, areas = {(p.name, w): [] for p in files for w in ('info', 'sample')}, {}
        out, summary = scratch / 'out.xyz', scratch / 'summary.json'
        for _ in range(arguments.runs):
            for path in files:
                more = ['--assimp'] if path.name in BY_ASSIMP else []
                info = [arguments.strata.resolve(), 'info', path, '--json', *more]
                costs[path.name, 'info'].append(run_once(Command(info), scratch))
                areas[path.name] = json.loads((scratch / 'stdout').read_text())['area']
                sample = [arguments.strata.resolve(), 'sample', path, '--resolution', '4', '--attributes', 'none',
                          '-o', out, '--summary', summary, *more]
                costs[path.name, 'sample'].append(run_once(Command(sample), scratch))
        rows = []
        for path in files:
            size = sum((folder / n).stat().st_size for n in [path.name, *COMPANIONS.get(path.name, [])])
            cpu = {w: statistics.median(c.cpu for c in costs[path.name, w]) for w in ('info', 'sample')}
            base = {w: statistics.median(c.cpu for c in costs[BASE, w]) for w in ('info', 'sample')}
            peak = max(c.peak_bytes for w in cpu for c in costs[path.name, w])
            rows.append({'file': path.name, 'mb': size / 1e6, 'mb_per_s': size / 1e6 / cpu['info'], 'cpu': cpu,
                         'info': cpu['info'] / base['info'], 'sample': cpu['sample'] / base['sample'],
                         'peak_mb': peak / 1e6, 'peak_over_size': peak / size, 'area': areas[path.name]})
    print('| file | MB | MB/s of CPU | info / PLY | sample / PLY | peak MB | peak / size |')
    print('| --- | --- | --- | --- | --- | --- | --- |')
    for row in rows:
        print('| {file} | {mb:.1f} | {mb_per_s:.0f} | {info:.1f} | {sample:.1f} | {peak_mb:.0f} | {peak_over_size:.1f} |'
              .format(**row))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    expected = areas[BASE]
    wrong = [r['file'] for r in rows if abs(r['area'] - expected) > 1e-5 * expected]
    if wrong:
        sys.exit(f'these have another area than {expected}: {wrong}')


if __name__ == '__main__':
    main()
