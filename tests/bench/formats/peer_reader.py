#!/usr/bin/env python3
"""Reads meshes with a library that nobody here wrote: `peer_reader.py open3d|assimp`.

Takes paths on standard input, one a line, and answers each with a line of JSON: triangles, area, and
the bounds of what faces use, or why not. A process of its own, since such libraries may die of a file.
"""
import contextlib
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

FACET = np.dtype([('normal', '<f4', 3), ('corner', '<f4', (3, 3)), ('attribute', '<u2')])


def measure(vertices, triangles):
    """Of triangles (corners' numbers) that name existing, finite vertices."""
    if len(triangles) == 0:
        return {'triangles': 0, 'area': 0.0}
    corners = vertices[triangles]
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    if len(corners) == 0:
        return {'triangles': 0, 'area': 0.0}
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    flat = corners[areas > 0].reshape(-1, 3)
    if len(flat) == 0:
        return {'triangles': 0, 'area': 0.0}
    return {'triangles': len(corners), 'area': float(areas.sum()),
            'min': flat.min(0).tolist(), 'max': flat.max(0).tolist()}


def read_open3d(path):
    import open3d
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    mesh = open3d.io.read_triangle_mesh(path)
    return measure(np.asarray(mesh.vertices, float), np.asarray(mesh.triangles, int))


def read_assimp(path):
    """By the command `assimp`, which writes binary STL with all nodes applied."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / 'out.stl'
        done = subprocess.run(['assimp', 'export', path, out, '-fstlb', '-ptv', '-tri'], capture_output=True,
                              timeout=50)
        if not out.exists():
            died = f', signal {-done.returncode}' if done.returncode < 0 else ''
            return {'error': 'refuses it' + died}
        facets = np.fromfile(out, FACET, offset=84)
    vertices = facets['corner'].reshape(-1, 3).astype(float)
    return measure(vertices, np.arange(len(vertices)).reshape(-1, 3))


def main():
    read = {'open3d': read_open3d, 'assimp': read_assimp}[sys.argv[1]]
    # What libraries print must not get between the answers.
    answers = os.fdopen(os.dup(1), 'w')
    os.dup2(2, 1)
    for line in sys.stdin:
        try:
            with contextlib.redirect_stdout(sys.stderr):
                answer = read(line.rstrip('\n'))
        except Exception as error:  # Any failure is the answer.
            answer = {'error': f'{type(error).__name__}: {error}'.split('\n')[0][:200]}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == '__main__':
    main()
