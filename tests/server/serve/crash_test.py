#!/usr/bin/env python3
"""kill -9 under load: what was answered is kept, nothing is half, nothing is left lying about."""
import hashlib
import http.client
import json
import os
import pathlib
import random
import signal
import sqlite3
import threading
import time
import unittest

import harness
from harness import CUBE, Server, sample_by_command, spot

KILLS = 20
LOAD_SECONDS = 0.4  # A kill comes at a random moment of the first so many under load.
JOBS = 4  # At most so many new ones between two kills.


def mesh(number):
    """A cube of its own, long enough that a kill may cut its upload."""
    return CUBE + b'# %08d\n' % number * 20_000


class Load:
    """Clients that ask without pause until the service dies. What was answered is remembered; of a
    request that was not, either outcome is right."""

    def __init__(self, port, draw, known):
        self.port, self.known = port, known
        self.answered = threading.Event()
        self.refused = []  # Answers that no client should have got.
        self.threads = [threading.Thread(target=self._ask, args=(act, draw.randrange(1 << 32)))
                        for act in (self._jobs, self._models, self._uploads, self._samples)]

    def run_until(self, kill):
        for thread in self.threads:
            thread.start()
        kill(self.answered)
        for thread in self.threads:
            thread.join(harness.PATIENCE)
            assert not thread.is_alive(), 'a client still waits for a service that is dead'

    def _ask(self, act, seed):
        connection = http.client.HTTPConnection('127.0.0.1', self.port, timeout=harness.PATIENCE)

        def ask(method, path, body=None, **headers):
            connection.request(method, path, body,
                               {name.replace('_', '-'): text for name, text in headers.items()})
            answer = connection.getresponse()
            content = answer.read()
            # A header that was cut off by the kill is a whole one to this library.
            if answer.status != 204 and answer.getheader('Content-Length') is None:
                raise http.client.IncompleteRead(content)
            self.answered.set()
            if answer.status >= 300:
                self.refused.append((method, path, answer.status, content[:300]))
            return answer, content

        try:
            act(ask, random.Random(seed))
        except (OSError, http.client.HTTPException):
            pass  # Killed.
        finally:
            connection.close()

    def _jobs(self, ask, draw):
        for _ in range(JOBS):
            options = {'resolution': draw.randrange(40, 250), 'format': 'ply'}
            _, made = ask('POST', '/v1/jobs', json.dumps({'model': 'spot.obj', 'options': options}),
                          Content_Type='application/json')
            self.known.jobs[json.loads(made)['id']] = options['resolution']

    def _models(self, ask, draw):
        while True:
            name, body = f'model-{draw.randrange(3)}', mesh(draw.randrange(10**8))
            self.known.models.setdefault(name, {None}).add(body)
            ask('PUT', f'/v1/models/{name}', body)
            self.known.models[name] = {body}

    def _uploads(self, ask, draw):
        while True:
            body = mesh(draw.randrange(10**8))
            answer, _ = ask('POST', '/v1/uploads', Tus_Resumable='1.0.0',
                            Upload_Length=str(len(body)), Upload_Metadata='name dHVz')
            where, offset = answer.getheader('Location'), 0
            for end in (len(body) // 3, draw.choice((len(body) // 2, len(body)))):
                self.known.uploads[where] = (body, offset)
                if end == len(body):
                    self.known.models.setdefault('tus', {None}).add(body)
                ask('PATCH', where, body[offset:end], Tus_Resumable='1.0.0',
                    Upload_Offset=str(offset), Content_Type='application/offset+octet-stream')
                offset = end
            if offset == len(body):
                self.known.uploads.pop(where)
                self.known.models['tus'] = {body}
            else:
                self.known.uploads[where] = (body, offset)

    @staticmethod
    def _samples(ask, draw):
        while True:
            ask('POST', f'/v1/samples?resolution={draw.randrange(50, 300)}&format=xyz', CUBE)


class Known:
    """What clients were told."""

    def __init__(self):
        self.jobs = {}  # Id → resolution.
        self.models = {}  # Name → the bodies that it may have; None among them: it may not exist.
        self.uploads = {}  # Where → (body, the offset that was answered last).


class Disk:
    """The service's folders, compared with its database."""

    def __init__(self, folder):
        self.data, self.scratch = folder / 'data', folder / 'scratch'
        self.temporary = folder / 'tmp'  # TMPDIR.
        self.scratch.mkdir()
        self.temporary.mkdir()
        self.whole = set()  # Blobs that were read and have the hash they are named by.

    def query(self, text):
        database = sqlite3.connect(f'file:{self.data}/strata.db?mode=ro', uri=True, timeout=60)
        try:
            return {row[0] for row in database.execute(text)}
        finally:
            database.close()

    def blobs(self):
        return {path.parent.name + path.name: path for path in (self.data / 'blobs').glob('*/*')}

    def strangers(self):
        """Files that nothing refers to, and references to files that are not there."""
        used = self.query('SELECT blob FROM models UNION SELECT blob FROM results UNION '
                          'SELECT result_blob FROM jobs WHERE result_blob IS NOT NULL UNION '
                          'SELECT model_blob FROM jobs WHERE model_blob IS NOT NULL')
        found = {f'blobs: {name}' for name in used ^ set(self.blobs())}
        found |= {f'table blobs: {name}' for name in used ^ self.query('SELECT hash FROM blobs')}
        open_uploads = self.query("SELECT id FROM uploads WHERE ifnull(hash, '') = ''")
        uploads = set(os.listdir(self.data / 'uploads'))
        found |= {f'uploads: {name}' for name in open_uploads ^ uploads}
        for folder in (self.data / 'incoming', self.data / 'checkpoints', self.scratch,
                       self.temporary):
            found |= {f'{folder.name}: {name}' for name in os.listdir(folder)}
        allowed = {'lock', 'strata.db', 'strata.db-wal', 'strata.db-shm', 'blobs', 'incoming',
                   'uploads', 'checkpoints', 'batches'}
        return found | {f'data: {name}' for name in set(os.listdir(self.data)) - allowed}

    def halves(self):
        """Blobs whose content is not what their name says."""
        broken = []
        for name, path in self.blobs().items():
            if name not in self.whole:
                if hashlib.sha256(path.read_bytes()).hexdigest() != name:
                    broken.append(name)
                self.whole.add(name)
        return broken


class Crash(unittest.TestCase):

    def setUp(self):
        self.at = harness.folder_with_models(self)
        self.disk, self.known = Disk(self.at), Known()

    def serve(self):
        server = Server('--data', str(self.disk.data), '--models', str(self.at / 'models'),
                        '--scratch', str(self.disk.scratch), '--log-level', 'info',
                        environment={'TMPDIR': str(self.disk.temporary)})
        self.addCleanup(server.stop)
        return server

    def kill(self, server, after):
        """At that moment, in seconds from the first answer."""
        def kill(answered):
            self.assertTrue(answered.wait(harness.PATIENCE), 'a first answer')
            threading.Event().wait(after)  # The random moment itself; nothing is expected by then.
            server.process.kill()
        return kill

    def assertKept(self, server):
        """All that was answered, all of it whole, and nothing else on disk once no job runs."""
        running = '/v1/jobs?state=queued&state=running'
        harness.wait_until(lambda: not server.curl(running).json().get('jobs'), 'the jobs to end')
        try:
            harness.wait_until(lambda: not self.disk.strangers(), 'files that nothing refers to')
        except AssertionError:
            self.assertEqual(self.disk.strangers(), set())
        self.assertEqual(self.disk.halves(), [])
        done = self.disk.query('SELECT id FROM jobs WHERE result_blob IS NOT NULL')
        self.assertEqual(set(self.known.jobs) - done, set(), 'jobs lost, or without their results')
        for name, bodies in self.known.models.items():
            answer = server.curl(f'/v1/models/{name}?content')
            self.assertIn(answer.status, (200, 404), name)
            found = answer.body if answer.status == 200 else None
            self.assertTrue(found in bodies, (name, answer.status, len(bodies)))
            self.known.models[name] = {found}
        self.assertUploadsGoOn(server)

    def assertUploadsGoOn(self, server):
        """From no byte before the one that was answered; one of them to its end."""
        for where, (body, offset) in list(self.known.uploads.items()):
            told = server.curl(where, '-I', '-H', 'Tus-Resumable: 1.0.0')
            self.assertEqual(told.status, 200, where)
            self.assertGreaterEqual(int(told.headers['upload-offset']), offset)
            self.assertLessEqual(int(told.headers['upload-offset']), len(body))
            ended = server.curl(where, '-X', 'DELETE', '-H', 'Tus-Resumable: 1.0.0')
            self.assertIn(ended.status, (204, 404, 410, 409), ended.body)
        self.known.uploads.clear()

    def test_killed_under_load_it_loses_nothing_and_leaves_nothing(self):
        seed = int(os.environ.get('STRATA_SEED') or random.randrange(1 << 32))
        print('seed', seed)
        draw, start = random.Random(seed), time.monotonic()
        server, left, cut = self.serve(), 0, 0
        for number in range(KILLS):
            after = draw.uniform(0, LOAD_SECONDS)
            print(f'kill {number}: {after:.3f} s under load', flush=True)
            load = Load(server.http_port, draw, self.known)
            load.run_until(self.kill(server, after))
            self.assertEqual(load.refused, [])
            server.stop()
            left += bool(self.disk.strangers())
            cut += bool(self.disk.query('SELECT id FROM jobs WHERE finished IS NULL'))
            server = self.serve()
            self.assertKept(server)
        for name, resolution in self.known.jobs.items():
            result = server.curl(f'/v1/jobs/{name}/result').body
            expected = sample_by_command(spot(), 'ply', '--resolution', str(resolution))
            self.assertTrue(result == expected, (name, resolution))
        self.assertEqual(server.stop(), 0)
        self.assertGreater(left, 0, 'no kill left a file to clean up: the load is too small')
        self.assertGreater(cut, 0, 'no kill cut a job off: the load is too small')
        print(f'{KILLS} kills, {left} of them left files, {cut} cut jobs off; {len(self.known.jobs)} jobs, {len(self.disk.whole)} files, '
              f'{time.monotonic() - start:.0f} s')


if __name__ == '__main__':
    harness.main()
