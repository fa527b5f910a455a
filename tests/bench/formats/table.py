#!/usr/bin/env python3
"""What becomes of every file of a collection of meshes, held against Open3D and assimp.

    table.py STRATA DATA [--out TABLE.tsv] [--memory SIZE]

DATA holds the folders `formats` and `nasty`. Each file of them is read by `strata info` and sampled by
`strata sample --resolution 16`; whatever happens is a row: sampled, no surface, or refused, with the reason.
A file that has a surface is read by Open3D and assimp as well, where they are there (Debian: python3-open3d,
assimp-utils): area and bounds have to agree within 1e-5, or the file stands in EXPLAINED below. Open3D
leaves glTF's meshes in their own space; there the two have to agree once the file's nodes are gone. Ends with 1 if a
difference is not explained, or an explanation has no difference.
"""
import argparse
import collections
import json
import math
import pathlib
import select
import shutil
import struct
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
TOLERANCE = 1e-5
SECONDS = 60  # For one file of one reader.
OK = 0  # The status of a command that did what it was told.

DIAGONAL = 'polygons that are not flat, cut along other diagonals'
LAST = 'the last polygon is missing'
LINES = 'its STL writer makes facets of lines and points'
# peer: {end of the path: why the two differ}.
EXPLAINED = {
    'open3d': {'mpi.off': 'it stops at the first polygon that it cannot cut up', 'suzanne.ply': DIAGONAL},
    'assimp': {
        'cube_poly.off': LAST,
        'mpi.off': LAST,
        'suzanne.ply': DIAGONAL,
        'target.obj': DIAGONAL,
        'issue-330.obj': DIAGONAL,
        'testmixed.obj': LINES,
        'notenoughindices.obj': LINES,
        'IncorrectVertexArrays/Cube.gltf': LINES,
        'simple_skin.gltf': 'a mesh is not moved by its skin',
        'cube-vertex-w-component.obj': 'positions are divided by a fourth number',
    },
}


class Peer:
    """A library in a process of its own, started again when it has died or hung."""

    def __init__(self, name):
        self.name, self.process = name, None
        module = {'open3d': 'open3d', 'assimp': 'numpy'}[name]
        probe = subprocess.run([sys.executable, '-c', f'import numpy, {module}'], capture_output=True)
        self.present = probe.returncode == 0 and (name != 'assimp' or shutil.which('assimp') is not None)

    def read(self, path):
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, HERE / 'peer_reader.py', self.name], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            print(path, file=self.process.stdin, flush=True)
            ready, _, _ = select.select([self.process.stdout], [], [], SECONDS)
            line = self.process.stdout.readline() if ready else ''
        except BrokenPipeError:
            line = ''
        if line:
            return json.loads(line)
        self.process.kill()
        status = self.process.wait()
        self.process = None
        return {'error': f'died of the file, status {status}' if ready else 'hung'}

    def close(self):
        if self.process is not None:
            self.process.stdin.close()
            self.process.wait()


def run(argv):
    done = subprocess.run([str(word) for word in argv], capture_output=True, text=True, errors='replace',
                          timeout=600)
    words = done.stderr.strip().splitlines()
    return done.returncode, done.stdout, words[-1] if words else ''


def plain(reason, path):
    """Without the path, which stands in front of the row."""
    return reason.removeprefix('strata: ').removeprefix(str(path)).removeprefix(': ')


def ours(strata, path, memory, scratch):
    """A row of what the command makes of a file."""
    row = {'outcome': 'refused', 'triangles': '', 'skipped': '', 'area': '', 'samples': '', 'reason': ''}
    status, text, reason = run([strata, 'info', path, '--json'])
    if status != OK:
        return {**row, 'reason': plain(reason, path)}, None
    info = json.loads(text)
    row.update(triangles=info['triangles'], skipped=sum(info['skipped'].values()),
               area=format(info['area'], '.9g'))
    out, summary = scratch / 'out.npz', scratch / 'summary.json'
    status, _, reason = run([strata, 'sample', path, '--resolution', 16, '--attributes', 'all', '--memory', memory,
                             '-o', out, '--summary', summary])
    if status == OK:
        row.update(outcome='sampled', samples=json.loads(summary.read_text())['samples']['after_rejection'])
    else:
        row.update(reason=plain(reason, path))
        if info['area'] == 0:
            row.update(outcome='no surface')
    return row, info


def difference(info, peer):
    """How much two readings of a surface differ, relative to its size."""
    if peer['area'] == 0 or info['area'] == 0:
        return 0.0 if peer['area'] == info['area'] else math.inf
    low, high = info['bounds']['min'], info['bounds']['max']
    size = math.dist(low, high)
    return max(abs(info['area'] - peer['area']) / info['area'], math.dist(low, peer['min']) / size,
               math.dist(high, peer['max']) / size)


def without_nodes(path, folder):
    """A copy of a glTF file whose meshes nobody places; None for other files."""
    data = path.read_bytes()
    binary = data[:4] == b'glTF'
    if not binary and path.suffix != '.gltf':
        return None
    length = struct.unpack('<I', data[12:16])[0] if binary else len(data)
    root = json.loads(data[20:20 + length] if binary else data)
    for key in ('nodes', 'scenes', 'scene', 'skins', 'animations'):
        root.pop(key, None)
    for mesh in root['meshes']:
        mesh.pop('weights', None)
    text = json.dumps(root).encode()
    if not binary:
        # Beside what it names.
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(path.parent, folder)
    folder.mkdir(exist_ok=True)
    copy = folder / ('copy.glb' if binary else 'copy.gltf')
    text += b' ' * (-len(text) % 4)
    rest = data[20 + length:]
    head = b'glTF' + struct.pack('<III', 2, 20 + len(text) + len(rest), len(text)) + b'JSON'
    copy.write_bytes(head + text + rest if binary else text)
    return copy


class Comparison:
    """With one peer, over all files."""

    def __init__(self, peer, strata, scratch):
        self.peer, self.strata, self.scratch = peer, strata, scratch
        self.counts, self.unexplained = collections.Counter(), []
        self.unused = set(EXPLAINED[peer.name])

    def add(self, path, info):
        answer = self.peer.read(path)
        if 'error' in answer:
            self.counts['not read by it'] += 1
            return answer['error']
        if answer['triangles'] == 0:
            self.counts['not read by it'] += 1
            return 'reads no triangle'
        apart = difference(info, answer)
        if apart <= TOLERANCE:
            self.counts['agree'] += 1
            return 'agrees'
        if self.peer.name == 'open3d' and self.agrees_without_nodes(path, answer):
            self.counts['agree once nodes are left out'] += 1
            return 'agrees once nodes are left out'
        why = next((end for end in EXPLAINED[self.peer.name] if str(path).endswith(end)), None)
        found = f'{answer["triangles"]} triangles, area {answer["area"]:.9g}'
        if why is None:
            self.unexplained.append(f'{path}: {self.peer.name} has {found}, apart by {apart:.3g}')
            self.counts['differ without reason'] += 1
            return found
        self.unused.discard(why)
        self.counts['differ, explained'] += 1
        return f'{found}: {EXPLAINED[self.peer.name][why]}'

    def agrees_without_nodes(self, path, answer):
        copy = without_nodes(path, self.scratch / 'nodeless')
        if copy is None:
            return False
        status, text, _ = run([self.strata, 'info', copy, '--json'])
        return status == OK and difference(json.loads(text), answer) <= TOLERANCE


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('strata', type=pathlib.Path)
    parser.add_argument('data', type=pathlib.Path)
    parser.add_argument('--out', type=pathlib.Path)
    parser.add_argument('--memory', default='1G')
    arguments = parser.parse_args()
    peers = [peer for peer in map(Peer, EXPLAINED) if peer.present]
    columns = ['file', 'outcome', 'triangles', 'skipped', 'area', 'samples', 'reason']
    lines = ['\t'.join(columns + [peer.name for peer in peers])]
    outcomes, compared = collections.Counter(), 0
    files = sorted(p for folder in ('formats', 'nasty') for p in (arguments.data / folder).rglob('*')
                   if p.is_file())
    with tempfile.TemporaryDirectory() as name:
        scratch = pathlib.Path(name)
        comparisons = [Comparison(peer, arguments.strata, scratch) for peer in peers]
        for path in files:
            row, info = ours(arguments.strata, path, arguments.memory, scratch)
            outcomes[row['outcome']] += 1
            row['file'] = str(path.relative_to(arguments.data))
            surface = info is not None and info['area'] > 0
            compared += surface
            cells = [str(row[c]) for c in columns]
            lines.append('\t'.join(cells + [c.add(path, info) if surface else '' for c in comparisons]))
    if arguments.out:
        arguments.out.write_text('\n'.join(lines) + '\n')
    print(f'{len(files)} files:', ', '.join(f'{n} {what}' for what, n in outcomes.most_common()))
    failed = not files
    for name in EXPLAINED:
        if all(c.peer.name != name for c in comparisons):
            print(f'{name} is not there')
    for c in comparisons:
        c.peer.close()
        print(f'{c.peer.name}, of {compared} with a surface:', dict(c.counts))
        for line in c.unexplained:
            print('  unexplained:', line)
        for end in sorted(c.unused):
            print('  explained, but does not differ:', end)
        failed = failed or bool(c.unexplained) or bool(c.unused)
    sys.exit(1 if failed else 0)


if __name__ == '__main__':
    main()
