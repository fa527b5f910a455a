#!/usr/bin/env python3
"""A store that a program of version 1 of the schema left goes on under this one."""
import hashlib
import pathlib
import re
import shutil
import sqlite3
import subprocess
import tempfile
import time
import unittest

import harness
from harness import Server, sample_by_command, wait_until

CREATED = 1795814502337  # When that store was written: milliseconds since 1970.
# Every column of a time.
TIMES = {'models': ('created', 'modified'), 'uploads': ('created', 'expires'),
         'jobs': ('created', 'started', 'finished', 'lease_until'), 'results': ('created',)}
SUCCEEDED = ('954da514e3513fa5d41f630904669f34', 'c1b7c1576c183ce261259e467c9d5577')
RUNNING, QUEUED = '5a7eff2f1cfcc56b4a0e6c3ae13e7008', '993ea16f006888b5fb6c52ef70c7823e'
UPLOAD = '/v1/uploads/59a63ce49931dc03bcc23ee3af61aa49'


class VersionOne(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.data = pathlib.Path(folder.name) / 'data'
        self.source = pathlib.Path(harness.ARGUMENTS['source']) / 'tests/server/store/version_1'
        shutil.copytree(self.source, self.data)
        self.data.chmod(0o700)
        (self.data / 'store.sql').unlink()
        with sqlite3.connect(self.data / 'strata.db') as database:
            database.execute('PRAGMA journal_mode = WAL')  # As it was; a dump does not say.
            database.executescript((self.source / 'store.sql').read_text())
            shift = int(time.time() * 1000) - CREATED
            for table, columns in TIMES.items():
                database.execute(f'UPDATE {table} SET ' + ', '.join(f'{c} = {c} + {shift}' for c in columns))
        database.close()

    def version(self):
        database = sqlite3.connect(self.data / 'strata.db')
        try:
            return database.execute('PRAGMA user_version').fetchone()[0]
        finally:
            database.close()

    def test_is_migrated_with_all_it_held(self):
        self.assertEqual(self.version(), 1)
        server = Server('--data', str(self.data))
        try:
            stored = next((self.source / 'blobs/3e').iterdir()).read_bytes()
            digest = hashlib.sha256(stored).hexdigest()
            self.assertEqual(server.curl('/v1/models/cube.off').json()['sha256'], digest)
            for id in SUCCEEDED:
                job = server.curl(f'/v1/jobs/{id}').json()
                self.assertEqual(job['state'], 'succeeded')
                result = server.curl(f'/v1/jobs/{id}/result').body
                name = hashlib.sha256(result).hexdigest()
                self.assertEqual(result, (self.source / 'blobs' / name[:2] / name[2:]).read_bytes())
            for id, resolution, seed in ((RUNNING, 250, 0), (QUEUED, 8, 5)):
                wait_until(lambda: server.curl(f'/v1/jobs/{id}?wait=30').json()['state'] == 'succeeded',
                           f'the end of job {id}')
                with tempfile.TemporaryDirectory() as folder:
                    mesh = pathlib.Path(folder) / 'cube.off'
                    mesh.write_bytes(stored)
                    wanted = sample_by_command(mesh, 'xyz', '--resolution', str(resolution), '--seed', str(seed))
                self.assertEqual(server.curl(f'/v1/jobs/{id}/result').body, wanted)
            head = server.curl(UPLOAD, '-I', '-H', 'Tus-Resumable: 1.0.0')
            self.assertEqual((head.status, head.headers['upload-offset']), (200, '50'))
            done = server.curl(UPLOAD, '-X', 'PATCH', '-H', 'Tus-Resumable: 1.0.0', '-H', 'Upload-Offset: 50', '-H',
                               'Content-Type: application/offset+octet-stream', body=stored[50:])
            self.assertEqual(done.status, 204, done.body)
            self.assertEqual(server.curl('/v1/models/later.off').json()['sha256'], digest)
        finally:
            self.assertEqual(server.stop(), 0)
        schema = (pathlib.Path(harness.ARGUMENTS['source']) / 'server/store/schema.cc').read_text()
        newest = max(map(int, re.findall(r'kVersion(\d+) =', schema)))
        self.assertEqual(self.version(), newest)

    def test_of_a_later_version_is_refused_and_left_as_it_is(self):
        with sqlite3.connect(self.data / 'strata.db') as database:
            database.execute('PRAGMA user_version = 1000')
        database.close()
        before = (self.data / 'strata.db').read_bytes()
        done = subprocess.run([harness.strata(), 'serve', '--data', str(self.data), '--http', '127.0.0.1:0',
                               '--grpc', 'off'], capture_output=True, text=True, timeout=harness.PATIENCE)
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assertIn('version 1000 found, this program knows up to', done.stderr)
        self.assertEqual((self.data / 'strata.db').read_bytes(), before)


if __name__ == '__main__':
    harness.main()
