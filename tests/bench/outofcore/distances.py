"""Checks the minimum distance on a PLY of samples, in a way of its own.

The file is read a slab of x at a time; of each slab those points stay that the next one can reach.
Points go into a grid of cells as wide as the distance, by sorting, and are compared with those of
the 26 cells around. Prints JSON: points, the smallest distance over the wanted one, and how many pairs
are too close. Needs numpy.
"""
import json
import re
import sys

import numpy as np

AT_ONCE = 1 << 20
# Half of the neighbours in x and y; those in z follow one another in the order of keys.
COLUMNS = [(0, 1), (1, -1), (1, 0), (1, 1)]


def read_header(file):
    """The provenance, the number of points and their type."""
    count, fields, provenance = 0, [], None
    types = {'double': '<f8', 'float': '<f4', 'uint': '<u4', 'int': '<i4', 'uchar': 'u1'}
    for line in file:
        words = line.decode().split()
        if words[0] == 'comment' and words[1] == 'strata':
            provenance = json.loads(line.decode().split(' ', 2)[2])
        elif words[0] == 'element':
            count = int(words[2])
        elif words[0] == 'property':
            fields.append((words[2], types[words[1]]))
        elif words[0] == 'end_header':
            return provenance, count, np.dtype(fields)
    raise ValueError('no end_header')


def ranges(first, last):
    """Every (i, j) with first[i] <= j < last[i], a few arrays at a time."""
    alive = np.flatnonzero(first < last)
    step = 0
    while alive.size:
        yield alive, first[alive] + step
        step += 1
        alive = alive[first[alive] + step < last[alive]]


class Check:
    def __init__(self, distance):
        self.distance = distance
        self.smallest2 = np.inf
        self.close = 0

    def compare(self, points, new):
        """All pairs of which one is among the last `new` points."""
        cell = np.floor(points / self.distance).astype(np.int64)
        cell -= cell.min(axis=0) - 1
        wide = cell.max(axis=0) + 2
        if float(wide[0]) * float(wide[1]) * float(wide[2]) > 2.0**62:
            raise ValueError('too many cells in a slab')
        key = (cell[:, 0] * wide[1] + cell[:, 1]) * wide[2] + cell[:, 2]
        order = np.argsort(key, kind='stable')
        key, points = key[order], points[order]
        fresh = order >= len(points) - new
        index = np.arange(len(key))
        # The rest of the own cell and the next one in z; then the other columns.
        spans = [(index + 1, np.searchsorted(key, key + 1, 'right'))]
        for x, y in COLUMNS:
            around = key + (x * wide[1] + y) * wide[2]
            spans.append((np.searchsorted(key, around - 1, 'left'),
                          np.searchsorted(key, around + 1, 'right')))
        for first, last in spans:
            for i, j in ranges(first, last):
                wanted = fresh[i] | fresh[j]
                i, j = i[wanted], j[wanted]
                squares = ((points[i] - points[j]) ** 2).sum(axis=1)
                if squares.size:
                    self.smallest2 = min(self.smallest2, squares.min())
                # Rounding of positions leaves a few units in the last place.
                self.close += int((squares < (self.distance * (1 - 1e-9)) ** 2).sum())


def check(path, distance):
    with open(path, 'rb', buffering=1 << 20) as file:
        provenance, count, layout = read_header(file)
        edge = provenance['lattice']['edge']
        job = Check(edge * provenance['min_distance'] if distance is None else distance)
        kept, seen, reach = np.empty((0, 3)), 0, -np.inf
        while seen < count:
            rows = np.fromfile(file, layout, min(AT_ONCE, count - seen))
            if rows.size == 0:
                raise ValueError(f'{count - seen} points are missing')
            seen += rows.size
            points = np.column_stack([rows['x'], rows['y'], rows['z']])
            # Blocks of eight cells come in order of x: no later point is further back than this.
            if points[:, 0].min() < reach:
                raise ValueError('the points do not come in slabs of x')
            reach = max(reach, points[:, 0].max() - 10 * edge)
            points = np.concatenate([kept, points])
            job.compare(points, rows.size)
            kept = points[points[:, 0] >= reach - job.distance]
        if file.read(1):
            raise ValueError('bytes follow the points')
    return {'points': count, 'smallest': float(np.sqrt(job.smallest2)) / job.distance,
            'too_close': job.close}


if __name__ == '__main__':
    print(json.dumps(check(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else None)))
