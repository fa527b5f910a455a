"""How evenly samples lie: two figures that need no taste.

    quality.py FILE.npz|FILE.ply AREA      figures of a file that strata wrote
    quality.py --mesh MESH [--build DIR]   samples MESH at about --points for several --min-distance

- spacing: the smallest distance between two samples over the one that a hexagonal arrangement of as
  many points on as much area would have, sqrt(2 A / (sqrt(3) N)). 1 is perfect, 0 is chance.
- variation: standard deviation over mean of the distance to the nearest sample. 0 is perfect;
  chance gives sqrt(4 / pi - 1) = 0.52.

Distances are straight lines, so the two sides of a thin wall see each other.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

NUMPY_TYPE = {'float': '<f4', 'double': '<f8', 'int': '<i4', 'uint': '<u4', 'uchar': 'u1',
              'char': 'i1', 'short': '<i2', 'ushort': '<u2', 'int32': '<i4', 'uint64': '<u8',
              'float32': '<f4', 'float64': '<f8', 'uint32': '<u4', 'uint8': 'u1'}


def read_ply(path):
    """Positions of a binary little-endian point PLY."""
    raw = path.read_bytes()
    header, body = raw.split(b'end_header\n', 1)
    fields, count = [], 0
    for line in header.decode().splitlines():
        words = line.split()
        if words[:2] == ['element', 'vertex']:
            count = int(words[2])
        elif words[:1] == ['property']:
            fields.append((words[2], NUMPY_TYPE[words[1]]))
    points = np.frombuffer(body, fields, count)
    return np.stack([points[axis] for axis in 'xyz'], 1).astype(np.float64)


def read_points(path):
    return np.load(path)['position'] if path.suffix == '.npz' else read_ply(path)


def nearest_distances(points):
    """Distance from each point to its nearest other, by a grid whose cells hold a few points."""
    extent = points.max(0) - points.min(0)
    nearest = np.full(len(points), np.inf)
    radius = 0.5 * extent.max() / np.sqrt(len(points))
    while True:
        near = within(points, radius)
        nearest = np.minimum(nearest, near)
        if (nearest <= radius).all():
            return nearest
        radius *= 2


def within(points, radius):
    """Distance to the nearest other point in the 27 cells of edge `radius` around, or infinity."""
    cell = np.floor((points - points.min(0)) / radius).astype(np.int64) + 1
    size = cell.max(0) + 2
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    order = np.argsort(key, kind='stable')
    ordered = key[order]
    best = np.full(len(points), np.inf)
    for step in np.ndindex(3, 3, 3):
        shift = ((step[0] - 1) * size[1] + step[1] - 1) * size[2] + step[2] - 1
        begin = np.searchsorted(ordered, key + shift, 'left')
        end = np.searchsorted(ordered, key + shift, 'right')
        for k in range(int((end - begin).max(initial=0))):
            mine = np.flatnonzero(begin + k < end)
            other = order[begin[mine] + k]
            mine, other = mine[mine != other], other[mine != other]
            distance = np.linalg.norm(points[mine] - points[other], axis=1)
            best[mine] = np.minimum(best[mine], distance)
    return best


def figures(points, area):
    """(points, spacing, variation)"""
    nearest = nearest_distances(points)
    ideal = np.sqrt(2 * area / (np.sqrt(3) * len(points)))
    return len(points), nearest.min() / ideal, nearest.std() / nearest.mean()


def sample(strata, mesh, resolution, min_distance, folder):
    """Positions and mesh area."""
    subprocess.run([strata, 'sample', mesh, '-o', folder / 'out.npz', '--summary',
                    folder / 'out.json', '--quiet', '--resolution', str(resolution),
                    '--min-distance', str(min_distance)], check=True)
    summary = json.loads((folder / 'out.json').read_text())
    return np.load(folder / 'out.npz')['position'], summary['mesh']['area']


def sample_about(strata, mesh, wanted, min_distance, folder):
    """Positions, mesh area and resolution: that which comes closest to `wanted` points. Their
    number grows with its square."""
    resolution, best = 64, None
    for _ in range(6):
        points, area = sample(strata, mesh, resolution, min_distance, folder)
        if best is None or abs(len(points) - wanted) < abs(len(best[0]) - wanted):
            best = points, area, resolution
        resolution = max(1, round(resolution * np.sqrt(wanted / len(points))))
    return best


def table(strata, mesh, wanted):
    print('| samples of Strata | points | spacing | variation |\n| --- | --- | --- | --- |')
    with tempfile.TemporaryDirectory() as name:
        for m in (0, 0.5, 0.75, 0.9):
            points, area, n = sample_about(strata, mesh, wanted, m, pathlib.Path(name))
            count, spacing, variation = figures(points, area)
            print(f'| `--resolution {n} --min-distance {m}` | {count:,} | {spacing:.2f} '
                  f'| {variation:.2f} |')
    print(chance(wanted))


def chance(count):
    """A check of this script itself: points strewn over a square, whose figures are known."""
    points = np.random.default_rng(1).random((count, 3)) * [1, 1, 0]
    _, spacing, variation = figures(points, 1.0)
    return f'| chance (a flat square) | {count:,} | {spacing:.2f} | {variation:.2f} |'


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('file', nargs='?', type=pathlib.Path)
    parser.add_argument('area', nargs='?', type=float)
    parser.add_argument('--mesh', type=pathlib.Path)
    parser.add_argument('--points', type=int, default=10000)
    parser.add_argument('--build', type=pathlib.Path,
                        default=pathlib.Path(__file__).resolve().parents[2] / 'build/release')
    options = parser.parse_args()
    if options.mesh:
        table((options.build / 'server/strata').resolve(), options.mesh, options.points)
    elif options.file and options.area:
        print('points {:,}  spacing {:.3f}  variation {:.3f}'.format(
            *figures(read_points(options.file), options.area)))
    else:
        parser.print_usage(sys.stderr)
        sys.exit(2)


if __name__ == '__main__':
    main()
