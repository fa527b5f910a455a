"""`strata batch` as a user runs it, and what it leaves."""
import argparse
import hashlib
import json
import os
import pathlib
import select
import signal
import subprocess
import sys
import tempfile
import time
import unittest

OPTIONS = None  # Set by main().
PATIENCE = 300.0  # Seconds for what normally takes milliseconds; only a hang reaches it.
QUICK = ('--resolution', '12', '--pictures', '0')

CUBE = """OFF
8 6 0
0 0 0
1 0 0
1 1 0
0 1 0
0 0 1
1 0 1
1 1 1
0 1 1
4 0 3 2 1
4 4 5 6 7
4 0 1 5 4
4 1 2 6 5
4 2 3 7 6
4 3 0 4 7
"""


def cube(number):
    """A mesh of its own: the cube with one corner moved."""
    return CUBE.replace('0 0 0\n', f'-0.{number % 997:03d} 0 -0.{number // 997:03d}\n', 1)


def wait_until(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f'waited {PATIENCE} s for: {what}')
        select.select([], [], [], 0.002)
    return value


def sha256(path):
    """Of a file; of a folder of tiles, of what sha256sum prints for its files."""
    if path.is_dir():
        names = sorted(str(each.relative_to(path)) for each in path.rglob('*') if each.is_file())
        lines = ''.join(f'{sha256(path / name)}  {name}\n' for name in names)
        return hashlib.sha256(lines.encode()).hexdigest()
    return hashlib.sha256(path.read_bytes()).hexdigest()


def outputs(folder):
    """Path → bytes of all outputs in a folder; what else lies there is left out."""
    found = {}
    for path in folder.rglob('*'):
        name = str(path.relative_to(folder))
        state = name.startswith(('.strata/', 'manifest')) or name == 'report.html'
        if path.is_file() and not state:
            found[name] = path.read_bytes()
    return found


def manifest(folder, name='manifest.jsonl'):
    """Path → line; the last of each path."""
    lines = (folder / name).read_text().splitlines()
    return {line['path']: line for line in map(json.loads, lines)}


def unmeasured(lines):
    """A manifest without what may differ between runs that do the same."""
    return {path: {key: value for key, value in line.items() if key != 'measured'}
            for path, line in lines.items()}


def children(process):
    """The worker processes of a batch."""
    found = []
    for path in pathlib.Path(f'/proc/{process}/task').glob('*/children'):
        try:
            found += [int(each) for each in path.read_text().split()]
        except OSError:
            pass  # The thread has ended.
    return found


def is_alive(process):
    """Whether it runs; one that nobody has waited for yet does not."""
    try:
        state = pathlib.Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state not in 'ZX'


def resident_bytes(process):
    try:
        pages = pathlib.Path(f'/proc/{process}/statm').read_text().split()
        return int(pages[1]) * os.sysconf('SC_PAGE_SIZE')
    except (OSError, IndexError):
        return 0


def command(*arguments):
    return [OPTIONS.strata, *map(os.fsencode, arguments)]


class BatchTest(unittest.TestCase):
    """A test with folders `repo` and `out` of its own."""

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.path = pathlib.Path(self.folder.name)
        self.repo, self.out = self.path / 'repo', self.path / 'out'
        self.repo.mkdir()

    def put(self, path, text=CUBE):
        file = self.repo / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text if isinstance(text, bytes) else text.encode())

    def put_cubes(self, count):
        for i in range(count):
            self.put(f'{i % 7}/{i:05d}.off', cube(i))

    def make_mesh(self, path, triangles):
        file = self.repo / path
        file.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run([OPTIONS.make_mesh, 'sphere', '--triangles', str(triangles), '-o', file],
                       check=True, timeout=PATIENCE)

    def start(self, *arguments, out=None, **settings):
        """A batch that runs."""
        words = command('batch', self.repo, '-o', out or self.out, *arguments)
        return subprocess.Popen(words, stderr=subprocess.PIPE, text=True, errors='replace',
                                start_new_session=True, **settings)

    def batch(self, *arguments, status=0, out=None, **settings):
        """Runs to the end: what it printed."""
        running = self.start(*arguments, out=out, **settings)
        try:
            _, text = running.communicate(timeout=3 * PATIENCE)
        except subprocess.TimeoutExpired:
            running.kill()
            raise
        self.assertEqual(running.returncode, status, text)
        return text

    def report(self, *arguments):
        done = subprocess.run(command('report', *arguments), capture_output=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout.decode()

    def assert_nothing_half(self, folder=None):
        left = [str(path) for path in (folder or self.out).rglob('*')
                if '.strata-' in path.name]
        self.assertEqual(left, [], 'unfinished outputs are left')

    def assert_as_manifest_says(self, folder=None, lines=None):
        """Every output that is named is there with its hash, and no other is."""
        folder = folder or self.out
        lines = lines if lines is not None else manifest(folder)
        named = set()
        for line in lines.values():
            if line['status'] == 'sampled':
                path = folder / line['output']
                self.assertEqual(sha256(path), line['output_sha256'], line['path'])
                named |= {str(each.relative_to(folder)) for each in path.rglob('*')
                          if each.is_file()} if path.is_dir() else {line['output']}
        self.assertEqual(set(outputs(folder)), named)
        self.assert_nothing_half(folder)


def main():
    global OPTIONS
    parser = argparse.ArgumentParser()
    for name in ('strata', 'make-mesh', 'source'):
        parser.add_argument(f'--{name}', required=True)
    OPTIONS, rest = parser.parse_known_args()
    unittest.main(module='__main__', argv=[sys.argv[0], *rest])
