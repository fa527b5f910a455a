#!/usr/bin/env python3
"""What carrying attributes costs: CPU time with them over that of positions and normals alone.

    attributes.py STRATA MESH.ply[.gz]... [--runs N] [--resolution N] [--image PIXELS]

Each mesh (ascii PLY with x, y and z in front) is written as a binary PLY with a colour, a normal, a UV, a
label and a quality for each vertex and a patch number for each face, and sampled in turns: with the attribute
`normal` alone, with one colour more, and with everything. Prints the medians of the CPU times of the whole
process, output written to npz, and their ratios. Then the same mesh as a GLB with texture coordinates and a PNG of PIXELS by
PIXELS (default 1024): with `normal` alone, and with the texture looked up.
"""
import argparse
import gzip
import json
import pathlib
import random
import statistics
import struct
import tempfile
import zlib

from measure import Command, run_once

PROPERTIES = ['float x', 'float y', 'float z', 'uchar red', 'uchar green', 'uchar blue',
              'float nx', 'float ny', 'float nz', 'float s', 'float t', 'int label', 'float quality']
TEXTURED = {'normal': 'normal', 'texture': 'normal,texture'}
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


def png(size):
    """Smooth colours with a little noise, so that they pack about as well as a photograph."""
    noise = random.Random(1).randbytes(3 * size)
    rows = bytearray()
    for y in range(size):
        shift = y * 7919 % (3 * size)
        row = noise[shift:] + noise[:shift]
        rows += b'\0' + bytes((x * 255 // (3 * size) // 2 + y * 64 // size + (row[x] & 7)) & 255 for x in range(3 * size))
    chunk = lambda kind, data: struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))
    head = struct.pack('>IIBBBBB', size, size, 8, 2, 0, 0, 0)
    return b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', head) + chunk(b'IDAT', zlib.compress(bytes(rows), 6)) + chunk(b'IEND', b'')


def write_glb(path, vertices, faces, size):
    parts = [struct.pack(f'<{3 * len(vertices)}f', *(c for v in vertices for c in v)),
             struct.pack(f'<{2 * len(vertices)}f', *(c for v in vertices for c in (7 * v[0], 7 * v[1]))),
             struct.pack(f'<{3 * len(faces)}I', *(c for f in faces for c in f)), png(size)]
    binary, views = b'', []
    for part in parts:
        views.append({'buffer': 0, 'byteOffset': len(binary), 'byteLength': len(part)})
        binary += part + bytes(-len(part) % 4)
    bounds = {'min': [min(v[a] for v in vertices) for a in range(3)], 'max': [max(v[a] for v in vertices) for a in range(3)]}
    document = {
        'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0]}], 'nodes': [{'mesh': 0}],
        'meshes': [{'primitives': [{'attributes': {'POSITION': 0, 'TEXCOORD_0': 1}, 'indices': 2, 'material': 0}]}],
        'materials': [{'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}}],
        'textures': [{'source': 0}], 'images': [{'bufferView': 3, 'mimeType': 'image/png'}],
        'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': len(vertices), 'type': 'VEC3', **bounds},
                      {'bufferView': 1, 'componentType': 5126, 'count': len(vertices), 'type': 'VEC2'},
                      {'bufferView': 2, 'componentType': 5125, 'count': 3 * len(faces), 'type': 'SCALAR'}],
        'bufferViews': views, 'buffers': [{'byteLength': len(binary)}]}
    text = json.dumps(document).encode()
    text += b' ' * (-len(text) % 4)
    path.write_bytes(struct.pack('<4sIII4s', b'glTF', 2, 28 + len(text) + len(binary), len(text), b'JSON') + text +
                     struct.pack('<I4s', len(binary), b'BIN\0') + binary)


def measure(args, folder, mesh, lists):
    """Medians of the CPU time for each list of attributes, in turns."""
    costs = {key: [] for key in lists}
    for _ in range(args.runs):
        for key, attributes in lists.items():
            argv = [args.strata.resolve(), 'sample', folder / mesh, '-o', folder / 'out.npz', '--quiet',
                    '--resolution', args.resolution, '--attributes', attributes]
            costs[key].append(run_once(Command(argv), folder).cpu)
    median = {key: statistics.median(values) for key, values in costs.items()}
    return ', '.join(f'{key} {median[key]:.3f} s ({median[key] / median["normal"]:.2f})' for key in lists)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('strata', type=pathlib.Path)
    parser.add_argument('mesh', type=pathlib.Path, nargs='+')
    parser.add_argument('--runs', type=int, default=9)
    parser.add_argument('--resolution', type=int, default=128)
    parser.add_argument('--image', type=int, default=1024)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        for mesh in args.mesh:
            vertices, faces = read(mesh)
            write(folder / 'in.ply', vertices, faces)
            print(f'{mesh.name}, {len(faces)} triangles: ' + measure(args, folder, 'in.ply', LISTS))
            write_glb(folder / 'in.glb', vertices, faces, args.image)
            print(f'{mesh.name} as a GLB with a PNG of {args.image} x {args.image}: ' +
                  measure(args, folder, 'in.glb', TEXTURED))


if __name__ == '__main__':
    main()
