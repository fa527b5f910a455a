#!/usr/bin/env python3
"""What carrying attributes costs: CPU time with them over that of positions and normals alone.

    attributes.py STRATA MESH.ply[.gz]... [--runs N] [--resolution N]

Each mesh (ascii PLY with x, y and z in front) is written as a binary PLY with a colour, a normal, a UV, a
label and a quality for each vertex and a patch number for each face, and sampled in turns: with the attribute
`normal` alone, with one colour more, and with everything. Prints the medians of the CPU times of the whole
process, output written to npz, and their ratios.
"""
import argparse
import gzip
import pathlib
import statistics
import struct
import tempfile

from measure import Command, run_once

PROPERTIES = ['float x', 'float y', 'float z', 'uchar red', 'uchar green', 'uchar blue',
              'float nx', 'float ny', 'float nz', 'float s', 'float t', 'int label', 'float quality']
LISTS = {'normal': 'normal', 'color': 'normal,color', 'all': 'normal,color,vertex_normal,uv,label,quality,patch'}


def read(path):
    """The vertices and the triangles of an ascii PLY."""
    opened = gzip.open(path, 'rt') if path.suffix == '.gz' else open(path)
    with opened as lines:
        counts = {}
        for line in lines:
            words = line.split()
            if words[0] == 'element':
                counts[words[1]] = int(words[2])
            if words[0] == 'end_header':
                break
        vertices = [tuple(map(float, next(lines).split()[:3])) for _ in range(counts['vertex'])]
        faces = [tuple(map(int, next(lines).split()[1:4])) for _ in range(counts['face'])]
    return vertices, faces


def write(path, vertices, faces):
    head = ['ply', 'format binary_little_endian 1.0', f'element vertex {len(vertices)}']
    head += [f'property {p}' for p in PROPERTIES]
    head += [f'element face {len(faces)}', 'property list uchar int vertex_indices', 'property int patch', 'end_header\n']
    row, face = struct.Struct('<3f3B3f2fif'), struct.Struct('<B3ii')
    with open(path, 'wb') as out:
        out.write('\n'.join(head).encode())
        for i, (x, y, z) in enumerate(vertices):
            out.write(row.pack(x, y, z, i & 255, i >> 8 & 255, 7, 0, 0, 1, x, y, i % 1000, x + y))
        for i, corners in enumerate(faces):
            out.write(face.pack(3, *corners, i // 100))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('strata', type=pathlib.Path)
    parser.add_argument('mesh', type=pathlib.Path, nargs='+')
    parser.add_argument('--runs', type=int, default=9)
    parser.add_argument('--resolution', type=int, default=128)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        for mesh in args.mesh:
            vertices, faces = read(mesh)
            write(folder / 'in.ply', vertices, faces)
            costs = {key: [] for key in LISTS}
            for _ in range(args.runs):
                for key, attributes in LISTS.items():
                    argv = [args.strata.resolve(), 'sample', folder / 'in.ply', '-o', folder / 'out.npz', '--quiet',
                            '--resolution', args.resolution, '--attributes', attributes]
                    costs[key].append(run_once(Command(argv), folder).cpu)
            median = {key: statistics.median(values) for key, values in costs.items()}
            print(f'{mesh.name}, {len(faces)} triangles: ' +
                  ', '.join(f'{key} {median[key]:.3f} s ({median[key] / median["normal"]:.2f})' for key in LISTS))


if __name__ == '__main__':
    main()
