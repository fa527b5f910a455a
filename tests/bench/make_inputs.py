"""Makes the benchmark's inputs from the scans: `make_inputs.py SCANS FOLDER NAME...`.

A file that stands in FOLDER already is kept: each appears under its name only when complete.
"""
import gzip
import os
import pathlib
import sys

import numpy as np

FACE = np.dtype([('n', 'u1'), ('v', '<i4', 3)])
FACET = np.dtype([('normal', '<f4', 3), ('corner', '<f4', (3, 3)), ('attribute', '<u2')])


def read_scan(path):
    """Vertices (float32) and triangles of an ascii PLY, plain or .gz, whose faces are triangles and
    whose first three vertex properties are x, y, z."""
    raw = gzip.open(path).read() if path.suffix == '.gz' else path.read_bytes()
    header, body = raw.split(b'end_header\n', 1)
    counts, properties, element = {}, 0, None
    for line in header.decode().splitlines():
        words = line.split()
        if words[:1] == ['element']:
            element = words[1]
            counts[element] = int(words[2])
        properties += words[:1] == ['property'] and element == 'vertex'
    numbers = np.array(body.split(), dtype=np.float64)
    n = counts['vertex'] * properties
    vertices = numbers[:n].reshape(-1, properties)[:, :3].astype('<f4')
    faces = numbers[n:n + 4 * counts['face']].reshape(-1, 4)
    assert (faces[:, 0] == 3).all(), f'{path}: a face is no triangle'
    return vertices, faces[:, 1:].astype('<i4')


def copies_of(vertices, triangles, columns, rows):
    """`columns` x `rows` copies side by side, a tenth of their size apart."""
    step = 1.1 * (vertices.max(0) - vertices.min(0))
    for i in range(columns * rows):
        shift = np.array([i % columns, i // columns, 0]) * step
        yield (vertices + shift).astype('<f4'), triangles + i * len(vertices)


def ply_header(encoding, vertices, faces):
    return (f'ply\nformat {encoding} 1.0\nelement vertex {vertices}\nproperty float x\n'
            f'property float y\nproperty float z\nelement face {faces}\n'
            'property list uchar int vertex_indices\nend_header\n').encode()


def write_ply(out, mesh, columns=1, rows=1):
    vertices, triangles = mesh
    n = columns * rows
    out.write(ply_header('binary_little_endian', n * len(vertices), n * len(triangles)))
    for placed, _ in copies_of(vertices, triangles, columns, rows):
        out.write(placed.tobytes())
    for _, renumbered in copies_of(vertices, triangles, columns, rows):
        faces = np.empty(len(renumbered), FACE)
        faces['n'], faces['v'] = 3, renumbered
        out.write(faces.tobytes())


def write_stl(out, mesh, columns, rows):
    out.write(b'binary'.ljust(80) + np.uint32(columns * rows * len(mesh[1])).tobytes())
    for placed, _ in copies_of(*mesh, columns, rows):
        facets = np.zeros(len(mesh[1]), FACET)
        facets['corner'] = placed[mesh[1]]
        out.write(facets.tobytes())


def text_rows(format_string, rows):
    return (format_string * len(rows) % tuple(rows.ravel().tolist())).encode()


def write_obj(out, mesh, columns, rows):
    for placed, _ in copies_of(*mesh, columns, rows):
        out.write(text_rows('v %.7g %.7g %.7g\n', placed))
    for _, renumbered in copies_of(*mesh, columns, rows):
        out.write(text_rows('f %d %d %d\n', renumbered + 1))


def write_ascii_ply(out, mesh, columns, rows):
    n = columns * rows
    out.write(ply_header('ascii', n * len(mesh[0]), n * len(mesh[1])))
    for placed, _ in copies_of(*mesh, columns, rows):
        out.write(text_rows('%.7g %.7g %.7g\n', placed))
    for _, renumbered in copies_of(*mesh, columns, rows):
        out.write(text_rows('3 %d %d %d\n', renumbered))


def write_one_triangle(out, _mesh):
    """Half a square, oblique to every axis: at a resolution of N some 0.9 N^2 cells."""
    facet = np.zeros(1, FACET)
    facet['corner'] = [[0.0, 0.0, 0.0], [1.0, 0.02, 0.31], [0.03, 1.0, 0.17]]
    out.write(b'binary'.ljust(80) + np.uint32(1).tobytes() + facet.tobytes())


# Name -> scan, what writes it.
INPUTS = {
    'bunny.ply': ('bun_zipper.ply', write_ply),
    'dragon.ply': ('dragon_vrip.ply.gz', write_ply),
    'dragons24.ply': ('dragon_vrip.ply.gz', lambda out, mesh: write_ply(out, mesh, 6, 4)),
    'dragons8.stl': ('dragon_vrip.ply.gz', lambda out, mesh: write_stl(out, mesh, 4, 2)),
    'dragons4.obj': ('dragon_vrip.ply.gz', lambda out, mesh: write_obj(out, mesh, 2, 2)),
    'dragons4-ascii.ply': ('dragon_vrip.ply.gz',
                           lambda out, mesh: write_ascii_ply(out, mesh, 2, 2)),
    'triangle.stl': ('bun_zipper.ply', write_one_triangle),
}


def main():
    scans, folder, names = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3:]
    meshes = {}
    for name in names:
        if (folder / name).exists():
            continue
        scan, write = INPUTS[name]
        if scan not in meshes:
            meshes[scan] = read_scan(scans / scan)
        print(f'making {folder / name}', file=sys.stderr)
        unfinished = folder / (name + '.tmp')
        with open(unfinished, 'wb') as out:
            write(out, meshes[scan])
        os.replace(unfinished, folder / name)


if __name__ == '__main__':
    try:
        main()
    except OSError as error:
        sys.exit(f'cannot make an input: {error}')
