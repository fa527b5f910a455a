#!/usr/bin/env python3
"""Stored jobs beyond their memory, whose service is killed: the next attempt goes on."""
import array
import json
import math
import os
import pathlib
import shutil
import sqlite3
import tempfile
import unittest

import harness
from harness import Server, sample_by_command

SIDE = 500  # Squares along a side of the sheet.
OPTIONS = {'resolution': 1000, 'format': 'ply', 'min_distance': 0.5}


def sheet():
    """Half a million triangles, as binary PLY: too many cells at OPTIONS for 64 MiB."""
    corners, faces = array.array('f'), bytearray()
    for y in range(SIDE + 1):
        for x in range(SIDE + 1):
            corners.extend((x, y, 40 * math.sin(x / 37) * math.cos(y / 23)))
    for y in range(SIDE):
        for x in range(SIDE):
            a = y * (SIDE + 1) + x
            for b, c in ((a + 1, a + SIDE + 2), (a + SIDE + 2, a + SIDE + 1)):
                faces += b'\x03' + array.array('i', (a, b, c)).tobytes()
    header = (f'ply\nformat binary_little_endian 1.0\nelement vertex {(SIDE + 1) ** 2}\n'
              'property float x\nproperty float y\nproperty float z\n'
              f'element face {2 * SIDE ** 2}\nproperty list uchar int vertex_indices\nend_header\n')
    return header.encode() + corners.tobytes() + bytes(faces)


class Resume(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.at = pathlib.Path(cls.folder.name)
        (cls.at / 'models').mkdir()
        (cls.at / 'models' / 'sheet.ply').write_bytes(sheet())
        cls.expected = sample_by_command(cls.at / 'models' / 'sheet.ply', 'ply',
                                         '--resolution', '1000')

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.data = pathlib.Path(folder.name) / 'data'

    def serve(self):
        server = Server('--data', str(self.data), '--models', str(self.at / 'models'),
                        '--job-memory', '64M', '--job-threads', '1')
        self.addCleanup(server.stop)
        return server

    def checkpoints(self):
        return list((self.data / 'checkpoints').glob('*/checkpoint'))

    def start_job(self, server):
        """The address of a job that has a checkpoint and runs on."""
        made = server.curl('/v1/jobs', '-H', 'Content-Type: application/json', body=json.dumps(
            {'model': 'sheet.ply', 'options': OPTIONS}).encode()).json()
        harness.wait_until(self.checkpoints, 'a checkpoint')
        return f'/v1/jobs/{made["id"]}'

    def killed_job(self):
        """The address of a job whose service was killed in its middle."""
        for _ in range(9):
            server = self.serve()
            where = self.start_job(server)
            children = server.children()
            server.process.kill()
            server.process.wait()
            harness.wait_until(lambda: not any(map(harness.is_alive, children)), 'its job to end')
            if self.unfinished():
                self.assertTrue(self.checkpoints(), 'what was killed leaves its checkpoint')
                return where
            shutil.rmtree(self.data)  # It was done before it could be killed.
        self.fail('each job was done before it could be killed')

    def unfinished(self):
        database = sqlite3.connect(f'file:{self.data}/strata.db?mode=ro', uri=True)
        try:
            return database.execute('SELECT 1 FROM jobs WHERE finished IS NULL').fetchall()
        finally:
            database.close()

    def finished(self, server, where):
        """The job's summary; its result has the command's bytes, and nothing is left of it."""
        done = server.curl(where + '?wait=60').json()
        self.assertEqual((done['state'], done['attempts']), ('succeeded', 2), done)
        self.assertTrue(server.curl(where + '/result').body == self.expected)
        harness.wait_until(lambda: not os.listdir(self.data / 'checkpoints'), 'nothing to be left')
        return json.loads(done['summary']['json'])

    def test_the_second_attempt_goes_on_from_the_checkpoint(self):
        where = self.killed_job()
        summary = self.finished(self.serve(), where)
        self.assertGreater(summary['resumed_at_triangle'], 0)
        self.assertLessEqual(summary['resumed_at_triangle'], 2 * SIDE ** 2)

    def test_a_damaged_checkpoint_makes_the_job_start_anew(self):
        where = self.killed_job()
        checkpoint, = self.checkpoints()
        os.truncate(checkpoint, checkpoint.stat().st_size // 2)
        self.assertEqual(self.finished(self.serve(), where)['resumed_at_triangle'], 0)

    def test_damaged_runs_make_the_job_start_anew(self):
        where = self.killed_job()
        checkpoint, = self.checkpoints()
        runs = checkpoint.with_name('runs')
        with open(runs, 'r+b') as file:
            file.write(b'\xff' * runs.stat().st_size)
        self.assertEqual(self.finished(self.serve(), where)['resumed_at_triangle'], 0)

    def test_a_cancelled_job_leaves_nothing(self):
        server = self.serve()
        where = self.start_job(server)
        server.curl(where, '-X', 'DELETE')
        done = server.curl(where + '?wait=60').json()
        if done['state'] == 'cancelled':  # Else it was quicker.
            self.assertNotIn('summary', done)
        harness.wait_until(lambda: not os.listdir(self.data / 'checkpoints'), 'nothing to be left')

    def test_what_no_job_wants_is_removed_at_the_start(self):
        self.killed_job()
        for checkpoint in self.checkpoints():
            checkpoint.parent.rename(checkpoint.parent.with_name('strata-job-' + '0' * 32))
        server = self.serve()
        harness.wait_until(
            lambda: 'strata-job-' + '0' * 32 not in os.listdir(self.data / 'checkpoints'),
            'a stranger to be removed')
        running = '/v1/jobs?state=queued&state=running'
        harness.wait_until(lambda: not server.curl(running).json().get('jobs'), 'the job to end')


if __name__ == '__main__':
    harness.main()
