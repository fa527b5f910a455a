"""The client of buckets against s3rver, a store that nobody here wrote.

It does not check signatures: what goes to it passes through the test's own store, which does. Nor
does it list or abort uploads in parts.
"""
import os
import pathlib
import socket
import subprocess
import sys
import tempfile

import client_test
from batch_test import sphere
from client_test import ARGUMENTS, MIB, ClientTest, percent_encoded, wait_until
from store import PassOn, Store, cut_after, slow_down

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2] / 'support'))
from free_port import free_port  # noqa: E402


class S3rver:
    """The server on a free port, with one bucket, until it is closed."""

    def __init__(self):
        self.folder = tempfile.TemporaryDirectory()
        (pathlib.Path(self.folder.name) / 'bucket').mkdir()
        self.port = free_port()
        # Its tokens for the next page of a list are DES, which OpenSSL 3 has among its old ones.
        self.process = subprocess.Popen(
            ['node', '--openssl-legacy-provider', os.environ['S3RVER'], '-d', self.folder.name,
             '-a', '127.0.0.1', '-p', str(self.port), '--silent'], stdout=subprocess.DEVNULL)
        wait_until(self.listens, 's3rver')

    def listens(self):
        assert self.process.poll() is None, 's3rver ended'
        with socket.socket() as probe:
            return probe.connect_ex(('127.0.0.1', self.port)) == 0

    def close(self):
        self.process.kill()
        self.process.wait()
        self.folder.cleanup()


class S3rverTest(ClientTest):
    def setUp(self):
        super().setUp()
        self.server = S3rver()
        self.addCleanup(self.server.close)
        self.store.backend = PassOn(self.server.port)
        # The only key that s3rver knows; it checks no more than that it knows it.
        self.store.keys = {'S3RVER': 'S3RVER'}

    def environment(self, **more):
        return super().environment(**{'AWS_ACCESS_KEY_ID': 'S3RVER',
                                      'AWS_SECRET_ACCESS_KEY': 'S3RVER', **more})

    def test_objects_come_back_as_they_were_put(self):
        path = self.file(100_000)
        keys = ['plain.ply', 'a b.ply', 'a+b.ply', 'a%20b.ply', 'ünïcode/模型.ply', "it's", 'a&b=c']
        for key in keys:
            with self.subTest(key=key):
                url = f's3://bucket/{percent_encoded(key)}'
                self.tool('put%', url, path)
                self.tool('get%', url, self.folder / 'back')
                self.assertEqual((self.folder / 'back').read_bytes(), path.read_bytes())
                self.assertIn(' 100000 ', self.tool('head%', url))
        self.assertEqual(len(self.tool('list', 's3://bucket').splitlines()), len(keys))
        self.tool('delete%', f's3://bucket/{percent_encoded(keys[1])}')
        self.assertEqual(len(self.tool('list', 's3://bucket').splitlines()), len(keys) - 1)

    def test_it_does_not_mind_conditions_of_a_put(self):
        """Of which docs/adr/0026-blobs-in-a-bucket.md says what follows."""
        for text in ('first', 'second'):
            self.assertEqual(self.tool('new', 's3://bucket/key', text), 'put\n')
        self.assertEqual(self.fetch('key'), b'second')

    def test_lists_of_more_than_a_thousand_keys_are_whole(self):
        keys = [f'{i:05}' for i in range(1205)]
        folder = pathlib.Path(self.server.folder.name) / 'bucket' / 'many'
        folder.mkdir()
        for key in keys:
            (folder / f'{key}._S3rver_object').write_bytes(b'')
        listed = self.tool('list', 's3://bucket/many/').splitlines()
        self.assertEqual([line.split(' ')[0] for line in listed], [f'many/{key}' for key in keys])

    def test_a_large_file_goes_in_parts_past_throttling(self):
        path = self.file(20 * MIB)
        self.store.fail(lambda r: 'partNumber=2' in r.target, slow_down())
        self.tool('put', 's3://bucket/large', path)
        self.assertEqual(self.store.count('PUT', 'partNumber='), 4)
        self.store.fail(lambda r: r.method == 'GET', cut_after(MIB))
        self.tool('get', 's3://bucket/large', self.folder / 'back')
        self.assertEqual((self.folder / 'back').read_bytes(), path.read_bytes())

    def test_a_batch_from_and_into_it_gives_the_bytes_of_a_local_one(self):
        models = self.folder / 'models'
        for i, name in enumerate(['a/0.off', 'a/1 +.off', 'ünïcode/2.off', 'a/3.off']):
            (models / name).parent.mkdir(parents=True, exist_ok=True)
            (models / name).write_text(sphere(10, i))
            self.tool('put', f's3://bucket/models/{name}', models / name)
        for source, output in [(models, self.folder / 'out'),
                               ('s3://bucket/models', 's3://bucket/out')] * 2:
            done = subprocess.run(
                [ARGUMENTS['strata'], 'batch', source, '-o', output, '--resolution', '24'],
                capture_output=True, text=True, timeout=600, env=self.environment())
            self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(sum(r.method == 'GET' and '/models/' in r.target and 'off' in r.target
                             for r in self.store.requests), 4, 'the second run fetches nothing')
        outputs = list((self.folder / 'out').rglob('*.drc'))
        self.assertEqual(len(outputs), 4)
        for path in outputs:
            key = percent_encoded(f'out/{path.relative_to(self.folder / "out")}')
            self.tool('get%', f's3://bucket/{key}', self.folder / 'back')
            self.assertEqual((self.folder / 'back').read_bytes(), path.read_bytes())

    def test_a_bucket_that_is_not_there_is_reported(self):
        self.assertIn('NoSuchBucket', self.refused(3, 'list', 's3://nowhere'))


del ClientTest  # Its tests are those of client_test.py.

if __name__ == '__main__':
    client_test.main()
