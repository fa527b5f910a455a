#!/usr/bin/env python3
"""A full disk: each request that needs space is told so, nothing half is left, and the same requests
succeed once there is space again."""
import base64
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import harness
from harness import CUBE, Server, ServerCase

KEPT_FREE = 64 << 20  # Of the disk of --data, by the service.
LARGE = CUBE + b'# a mesh file of 3 MiB\n' * 140_000
TUS = ('-H', 'Tus-Resumable: 1.0.0')


class FixedDisk:
    """A tmpfs of a fixed size. Only root may mount one."""

    def __init__(self, size):
        self.size = size
        self.folder = tempfile.TemporaryDirectory()
        self.path = pathlib.Path(self.folder.name)
        done = subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={size},nosuid,nodev', 'strata',
                               self.path], capture_output=True, text=True)
        self.failure = done.stderr.strip() if done.returncode else ''

    def fill(self, leave=0):
        """Until not a byte more fits, or `leave` bytes are free."""
        if leave:
            (self.path / 'ballast').write_bytes(bytes(self.size - self.used() - leave))
            return
        with open(self.path / 'ballast', 'ab', buffering=0) as ballast:
            for size in (1 << 20, 4096, 1):
                try:
                    while ballast.write(b'x' * size) == size:
                        pass
                except OSError:
                    pass

    def empty(self):
        (self.path / 'ballast').unlink()

    def used(self):
        status = os.statvfs(self.path)
        return (status.f_blocks - status.f_bfree) * status.f_frsize

    def close(self):
        if not self.failure:
            subprocess.run(['umount', '--lazy', self.path], check=True)
        self.folder.cleanup()


class DiskFull(unittest.TestCase):
    assertProblem = ServerCase.assertProblem

    def serve(self, *options):
        server = Server(*options, '--grpc', 'off')
        self.addCleanup(server.stop)
        return server

    size = 16 << 20

    def setUp(self):
        self.disk = FixedDisk(self.size)
        self.addCleanup(self.disk.close)

    def assertNoSpace(self, answer):
        """The write failed, or the space was looked at first."""
        problem = self.assertProblem(answer, 507, 'storage')
        self.assertRegex(problem['detail'], 'No space left on device|are kept free')

    def files(self, server):
        """What the data folder holds of models, results and uploads."""
        return sorted(str(path.relative_to(self.disk.path)) for path in self.disk.path.rglob('*')
                      if path.is_file() and path.name != 'ballast' and '.db' not in path.name and
                      'lock' not in path.name)


class Scratch(DiskFull):

    def await_space(self, empty):
        """A request's files go just after its answer."""
        harness.wait_until(lambda: self.disk.used() == empty, 'the space to be given back')

    def test_a_mesh_that_does_not_fit_is_refused_and_later_taken(self):
        server = self.serve('--scratch', str(self.disk.path))
        path = '/v1/samples?resolution=5&format=ply'
        empty = self.disk.used()
        expected = server.curl(path, body=LARGE)
        self.assertEqual(expected.status, 200)
        self.await_space(empty)
        self.disk.fill()
        self.assertNoSpace(server.curl(path, body=LARGE))
        self.disk.empty()
        self.await_space(empty)
        self.assertEqual(server.curl(path, body=LARGE).body, expected.body)

    def test_a_result_that_does_not_fit_is_refused_and_later_given(self):
        for isolate in ('on', 'off'):
            server = self.serve('--scratch', str(self.disk.path), '--isolate', isolate)
            path = '/v1/samples?resolution=300&format=xyz'  # More than the disk.
            empty = self.disk.used()
            self.assertNoSpace(server.curl(path, body=CUBE))
            self.await_space(empty)
            self.assertEqual(server.children(), [])
            small = server.curl('/v1/samples?resolution=50&format=xyz', body=CUBE)
            self.assertEqual(small.status, 200, small.body[:300])
            self.await_space(empty)


class Data(DiskFull):
    size = KEPT_FREE + (16 << 20)

    def setUp(self):
        super().setUp()
        self.server = self.serve('--data', str(self.disk.path))
        self.assertEqual(self.put('kept.obj', CUBE).status, 201)

    def put(self, name, body):
        return self.server.curl(f'/v1/models/{name}', '-X', 'PUT', body=body)

    def job(self, **options):
        return self.server.curl('/v1/jobs', '-H', 'Content-Type: application/json',
                                body=json.dumps({'model': 'kept.obj', 'options': options}).encode())

    def create(self, name, length):
        metadata = base64.b64encode(name.encode()).decode()
        return self.server.curl('/v1/uploads', '-X', 'POST', *TUS, '-H', f'Upload-Length: {length}',
                                '-H', f'Upload-Metadata: name {metadata}')

    def patch(self, where, offset, body):
        return self.server.curl(where, '-X', 'PATCH', *TUS, '-H', f'Upload-Offset: {offset}', '-H',
                                'Content-Type: application/offset+octet-stream', body=body)

    def test_a_model_that_does_not_fit_is_refused_and_later_stored(self):
        before = self.files(self.server)
        self.disk.fill()
        for _ in range(3):
            self.assertNoSpace(self.put('large.obj', LARGE))
        self.assertEqual(self.files(self.server), before, 'nothing half is left')
        self.assertProblem(self.server.curl('/v1/models/large.obj'), 404, 'not-found')
        self.assertEqual(self.server.curl('/v1/models/kept.obj?content').body, CUBE)
        self.disk.empty()
        self.assertEqual(self.put('large.obj', LARGE).status, 201)
        self.assertEqual(self.server.curl('/v1/models/large.obj?content').body, LARGE)

    def test_an_upload_goes_on_where_it_was(self):
        where = self.create('tus.obj', len(LARGE)).headers['location']
        half = 1 << 20
        self.assertEqual(self.patch(where, 0, LARGE[:half]).status, 204)
        self.disk.fill()
        self.assertNoSpace(self.patch(where, half, LARGE[half:]))
        offset = int(self.server.curl(where, '-I', *TUS).headers['upload-offset'])
        self.assertGreaterEqual(offset, half)
        self.disk.empty()
        self.assertEqual(self.patch(where, offset, LARGE[offset:]).status, 204)
        self.assertEqual(self.server.curl('/v1/models/tus.obj?content').body, LARGE)

    def test_jobs_and_uploads_that_cannot_be_written_down_are_refused_and_later_made(self):
        self.disk.fill()
        refused = []
        for seed in range(200):  # Until the database has used up what it had to spare.
            answers = [self.job(resolution=4, seed=str(seed)), self.create(f'u{seed}', 9)]
            refused += [answer for answer in answers if answer.status >= 400]
            if len(refused) > 4:
                break
        self.assertGreater(len(refused), 4)
        for answer in refused:
            self.assertProblem(answer, 507, 'storage')
        self.assertEqual(self.server.curl('/livez').status, 200)
        self.assertEqual(self.server.curl('/v1/jobs').status, 200, 'reading needs no space')
        self.disk.empty()
        made = self.job(resolution=4)
        self.assertEqual(made.status, 202, made.body)
        done = self.server.curl(made.headers['location'] + '?wait=60').json()
        self.assertEqual(done['state'], 'succeeded', done)
        self.assertEqual(self.create('later', 9).status, 201)

    def test_a_result_that_cannot_be_kept_fails_its_job_and_is_made_later(self):
        warm = self.job(resolution=3).headers['location']
        self.server.curl(warm + '?wait=60')
        before = self.files(self.server)
        self.disk.fill(leave=KEPT_FREE + (2 << 20))
        options = {'resolution': 250, 'format': 'xyz'}  # 370,000 lines: more than 2 MiB.
        made = self.job(**options)
        done = self.server.curl(made.headers['location'] + '?wait=60').json()
        self.assertEqual(done['state'], 'failed', done)
        self.assertIn(done['error']['type'], ('/problems/storage', '/problems/over-limit'))
        self.assertEqual(self.files(self.server), before, 'nothing half is left')
        direct = self.server.curl('/v1/samples?model=kept.obj&resolution=250&format=xyz')
        self.assertNoSpace(direct)
        small = self.job(resolution=40).headers['location']
        self.assertEqual(self.server.curl(small + '?wait=60').json()['state'], 'succeeded')


def load_tests(loader, tests, pattern):
    disk = FixedDisk(1 << 20)
    disk.close()
    if disk.failure:
        print(f'skipped: {disk.failure}')
        sys.exit(77)
    return tests


if __name__ == '__main__':
    harness.main()
