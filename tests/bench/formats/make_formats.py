#!/usr/bin/env python3
"""Writes one mesh in every format that Strata reads: make_formats.py FOLDER TRIANGLES.

A square grid with bumps, positions in single precision; every format holds the same numbers but drc, which
Debian's draco_encoder makes of the OBJ with 16 bits a coordinate (left out where that is absent). No
attributes: what is measured is the surface.
"""
import gzip
import json
import pathlib
import shutil
import subprocess
import sys
import zipfile

import numpy as np

FACE = np.dtype([('n', 'u1'), ('v', '<i4', 3)])
FACET = np.dtype([('normal', '<f4', 3), ('corner', '<f4', (3, 3)), ('attribute', '<u2')])
CORE = 'http://schemas.microsoft.com/3dmanufacturing/core/2015/02'
MODEL = 'http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel'
RELATIONS = 'http://schemas.openxmlformats.org/package/2006/relationships'
TYPES = 'http://schemas.openxmlformats.org/package/2006/content-types'


def grid(triangles):
    side = max(1, round((triangles / 2) ** 0.5))
    x, y = np.meshgrid(np.arange(side + 1), np.arange(side + 1))
    z = 3 * np.sin(x * 0.11) * np.cos(y * 0.07)
    vertices = np.stack([x * 0.1, y * 0.1, z], axis=-1).reshape(-1, 3).astype('<f4')
    a = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    b, c, d = a + 1, a + side + 2, a + side + 1
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=1).reshape(-1, 3)
    return vertices, faces.astype('<i4')


def rows(template, values):
    return (template * len(values) % tuple(values.ravel().tolist())).encode()


def text_rows(out, template, values):
    for first in range(0, len(values), 50000):
        out.write(rows(template, values[first:first + 50000]))


def ply(out, vertices, faces, encoding):
    out.write(f'ply\nformat {encoding} 1.0\nelement vertex {len(vertices)}\nproperty float x\n'
              f'property float y\nproperty float z\nelement face {len(faces)}\n'
              'property list uchar int vertex_indices\nend_header\n'.encode())
    if encoding == 'ascii':
        text_rows(out, '%.9g %.9g %.9g\n', vertices)
        text_rows(out, '3 %d %d %d\n', faces)
        return
    table = np.empty(len(faces), FACE)
    table['n'], table['v'] = 3, faces
    out.write(vertices.tobytes() + table.tobytes())


def obj(out, vertices, faces):
    text_rows(out, 'v %.9g %.9g %.9g\n', vertices)
    text_rows(out, 'f %d %d %d\n', faces + 1)


def off(out, vertices, faces):
    out.write(f'OFF\n{len(vertices)} {len(faces)} 0\n'.encode())
    text_rows(out, '%.9g %.9g %.9g\n', vertices)
    text_rows(out, '3 %d %d %d\n', faces)


def stl(out, vertices, faces):
    facets = np.zeros(len(faces), FACET)
    facets['corner'] = vertices[faces]
    out.write(b'binary'.ljust(80) + np.uint32(len(faces)).tobytes() + facets.tobytes())


def stl_ascii(out, vertices, faces):
    out.write(b'solid grid\n')
    text_rows(out, 'facet normal 0 0 0\n outer loop\n' + '  vertex %.9g %.9g %.9g\n' * 3 + ' endloop\nendfacet\n',
              vertices[faces].reshape(-1, 9))
    out.write(b'endsolid grid\n')


def gltf_json(vertices, faces, uri):
    buffer = {'byteLength': vertices.nbytes + faces.nbytes, **({'uri': uri} if uri else {})}
    low, high = vertices.min(0).astype(float).tolist(), vertices.max(0).astype(float).tolist()
    return json.dumps({
        'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0]}], 'nodes': [{'mesh': 0}],
        'meshes': [{'primitives': [{'attributes': {'POSITION': 0}, 'indices': 1}]}], 'buffers': [buffer],
        'bufferViews': [{'buffer': 0, 'byteLength': vertices.nbytes},
                        {'buffer': 0, 'byteOffset': vertices.nbytes, 'byteLength': faces.nbytes}],
        'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': len(vertices), 'type': 'VEC3',
                       'min': low, 'max': high},
                      {'bufferView': 1, 'componentType': 5125, 'count': faces.size, 'type': 'SCALAR'}]}).encode()


def glb(out, vertices, faces):
    text = gltf_json(vertices, faces, None)
    text += b' ' * (-len(text) % 4)
    data = vertices.tobytes() + faces.tobytes()
    out.write(b'glTF' + np.array([2, 28 + len(text) + len(data), len(text)], '<u4').tobytes() + b'JSON' + text +
              np.uint32(len(data)).tobytes() + b'BIN\0' + data)


def three_mf(path, vertices, faces):
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED, compresslevel=6) as package:
        package.writestr('[Content_Types].xml', f'<Types xmlns="{TYPES}"/>')
        package.writestr('_rels/.rels', f'<Relationships xmlns="{RELATIONS}"><Relationship Id="r" '
                         f'Target="/3D/3dmodel.model" Type="{MODEL}"/></Relationships>')
        with package.open('3D/3dmodel.model', 'w') as out:
            out.write(f'<model xmlns="{CORE}"><resources><object id="1"><mesh><vertices>\n'.encode())
            text_rows(out, '<vertex x="%.9g" y="%.9g" z="%.9g"/>\n', vertices)
            out.write(b'</vertices><triangles>\n')
            text_rows(out, '<triangle v1="%d" v2="%d" v3="%d"/>\n', faces)
            out.write(b'</triangles></mesh></object></resources><build><item objectid="1"/></build></model>')


def directx(out, vertices, faces):
    out.write(f'xof 0303txt 0032\nMesh grid {{\n{len(vertices)};\n'.encode())
    text_rows(out, '%.9g;%.9g;%.9g;,\n', vertices[:-1])
    out.write(rows('%.9g;%.9g;%.9g;;\n', vertices[-1:]) + f'{len(faces)};\n'.encode())
    text_rows(out, '3;%d,%d,%d;,\n', faces[:-1])
    out.write(rows('3;%d,%d,%d;;\n', faces[-1:]) + b'}\n')


def main():
    folder, mesh = pathlib.Path(sys.argv[1]), grid(int(sys.argv[2]))
    writers = {'grid.ply': lambda out: ply(out, *mesh, 'binary_little_endian'),
               'ascii.ply': lambda out: ply(out, *mesh, 'ascii'),
               'grid.obj': lambda out: obj(out, *mesh), 'grid.off': lambda out: off(out, *mesh),
               'grid.stl': lambda out: stl(out, *mesh), 'ascii.stl': lambda out: stl_ascii(out, *mesh),
               'grid.glb': lambda out: glb(out, *mesh), 'grid.x': lambda out: directx(out, *mesh)}
    for name, write in writers.items():
        with open(folder / name, 'wb') as out:
            write(out)
    (folder / 'grid.gltf').write_bytes(gltf_json(*mesh, 'grid.bin'))
    (folder / 'grid.bin').write_bytes(mesh[0].tobytes() + mesh[1].tobytes())
    three_mf(folder / 'grid.3mf', *mesh)
    plain = (folder / 'grid.ply').read_bytes()
    (folder / 'grid.ply.gz').write_bytes(gzip.compress(plain, 6))
    with zipfile.ZipFile(folder / 'grid.zip', 'w', zipfile.ZIP_DEFLATED) as packed:
        packed.writestr('grid.ply', plain)
    if shutil.which('zstd'):
        subprocess.run(['zstd', '-q', '-k', folder / 'grid.ply'], check=True)
    if shutil.which('draco_encoder'):
        subprocess.run(['draco_encoder', '-i', folder / 'grid.obj', '-o', folder / 'grid.drc', '-qp', '16'],
                       check=True, stdout=subprocess.DEVNULL)


if __name__ == '__main__':
    main()
