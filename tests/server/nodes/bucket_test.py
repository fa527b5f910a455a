#!/usr/bin/env python3
"""A store whose content lies in a bucket: several processes on PostgreSQL without a shared folder, and
one on SQLite; killed, paused, without their bucket."""
import contextlib
import hashlib
import json
import os
import pathlib
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / 'serve'), str(HERE.parent / 's3')]
import harness  # noqa: E402
import nodes_test  # noqa: E402
import resume_test  # noqa: E402
import store as s3  # noqa: E402
from harness import CUBE, Server, sample_by_command, spot, wait_until  # noqa: E402

MIB = 1 << 20
PREFIX = 'strata/'


def mesh_of(size, seed=0):
    """A cube with a comment of random letters: one name, another content for each seed."""
    draw = random.Random(seed)
    line = ''.join(draw.choice('abcdefghij') for _ in range(99))
    return CUBE + b''.join(b'# %08d %s\n' % (i, line.encode()) for i in range(size // 110))


# What the tests' own store answers alone: nothing that another one behind it could add to.
of_our_store = unittest.skipIf('S3RVER' in os.environ, 'the answers are made up')


class BucketCase(nodes_test.NodesCase):
    def setUp(self):
        super().setUp()
        self.store = s3.Store()
        if 'S3RVER' in os.environ:
            from s3rver_test import S3rver
            self.s3rver = S3rver()
            self.addCleanup(self.s3rver.close)
            self.store.backend = s3.PassOn(self.s3rver.port)
            self.store.keys = {'S3RVER': 'S3RVER'}
        self.addCleanup(self.store.close)
        self.blocks = []
        self.addCleanup(lambda: [block.go.set() for block in self.blocks])
        self.number = 0

    def blocked(self, takes, **rest):
        self.blocks.append(s3.Blocked(self.store, takes, **rest))
        return self.blocks[-1]

    def environment(self, **more):
        keys = {'AWS_ACCESS_KEY_ID': 'S3RVER', 'AWS_SECRET_ACCESS_KEY': 'S3RVER'}
        return self.store.environment(**(keys if 'S3RVER' in os.environ else {}), **more)

    def bucket_options(self):
        self.number += 1
        return ('--blobs', f's3://bucket/{PREFIX[:-1]}', '--data', f'{self.data}-{self.number}',
                '--scratch', self.folder.name)

    def options(self, url=None):
        own = self.bucket_options()
        return ('--database', nodes_test.POSTGRES.url(self.database), *own, '--lease',
                str(self.lease), '--job-threads', '1', '--jobs', '1')

    def serve(self, *more, **rest):
        return super().serve(*more, environment=self.environment(), **rest)

    def worker(self, *more, **rest):
        options = [*self.options(), *nodes_test.attempts_of(more), *more]
        del options[options.index('--scratch'):options.index('--scratch') + 2]
        self.nodes.append(nodes_test.Worker(*options, environment=self.environment(), **rest))
        return self.nodes[-1]

    def objects(self):
        """Names below the prefix."""
        if 'S3RVER' in os.environ:
            root = pathlib.Path(self.s3rver.folder.name) / 'bucket' / PREFIX
            return {name.removesuffix('._S3rver_object') for name in nodes_test.files_below(root)
                    if name.endswith('._S3rver_object')}
        with self.store.backend.lock:
            return {key.removeprefix(PREFIX) for _, key in self.store.backend.objects}

    def named(self):
        """What the objects should be: those that rows name, and the mark."""
        return {'store-id'} | {f'blobs/{hash[:2]}/{hash[2:]}.{file}' for hash, file in
                               self.sql('SELECT hash, file FROM strata.blobs')} | {
            name for name, in self.sql('SELECT name FROM strata.upload_pieces')}

    def await_no_leftovers(self):
        def same():
            unfinished = getattr(self.store.backend, 'uploads', {})
            return self.objects() == self.named() and not unfinished
        try:
            wait_until(same, 'the bucket to hold what rows name alone')
        except AssertionError as error:
            raise AssertionError(f'{error}: left {self.objects() - self.named()}, missing '
                                 f'{self.named() - self.objects()}') from None

    def put(self, server, name, mesh):
        answer = server.curl(f'/v1/models/{name}', '-X', 'PUT', body=mesh)
        self.assertIn(answer.status, (200, 201), answer.body)
        return answer

    def put_by_another_node(self, **models):
        """Puts spot.obj and `models` (NAME=mesh for NAME.obj), of which nodes started later have no copy."""
        node = self.serve()
        for name, mesh in {'spot': spot().read_bytes(), **models}.items():
            self.put(node, f'{name}.obj', mesh)
        self.assertEqual(node.stop(), 0)

    def create_upload(self, server, mesh, name='bWVzaC5vYmo='):  # mesh.obj
        made = server.curl('/v1/uploads', '-X', 'POST', '-H', 'Tus-Resumable: 1.0.0', '-H',
                           f'Upload-Length: {len(mesh)}', '-H', f'Upload-Metadata: name {name}')
        self.assertEqual(made.status, 201, made.body)
        return made.headers['location']

    def patch(self, server, where, offset, body, *more):
        return server.curl(where, '-X', 'PATCH', '-H', 'Tus-Resumable: 1.0.0', '-H',
                           'Content-Type: application/offset+octet-stream', '-H',
                           f'Upload-Offset: {offset}', *more, body=body)

    def offset(self, server, where):
        answer = server.curl(where, '-I', '-H', 'Tus-Resumable: 1.0.0')
        self.assertEqual(answer.status, 200)
        return int(answer.headers['upload-offset'])


class SharedTest(BucketCase):
    def test_a_model_of_one_node_is_sampled_at_another_and_its_result_read_at_a_third(self):
        first, second, third = (self.serve() for _ in range(3))
        self.put(first, 'spot.obj', spot().read_bytes())
        wanted = sample_by_command(spot(), 'xyz', '--resolution', '50')
        query = '/v1/samples?model=spot.obj&resolution=50&format=xyz'
        self.assertEqual(second.curl(query).body, wanted)
        answer = third.curl(query)
        self.assertEqual(answer.body, wanted)
        self.assertEqual(answer.headers['etag'], f'"{hashlib.sha256(wanted).hexdigest()}"')
        fetched = self.store.count('GET', hashlib.sha256(spot().read_bytes()).hexdigest()[2:])
        self.assertEqual(fetched, 1, 'the model is fetched once, by the one that samples')
        part = third.curl(query, '-H', 'Range: bytes=1000-1999')
        self.assertEqual((part.status, part.body), (206, wanted[1000:2000]))
        self.assertEqual(part.headers['content-range'], f'bytes 1000-1999/{len(wanted)}')
        self.assertEqual(part.headers['etag'], answer.headers['etag'])
        same = third.curl(query, '-H', f'If-None-Match: {answer.headers["etag"]}')
        self.assertEqual(same.status, 304)
        id = self.post(first, 60)
        self.assertEqual(self.ended(second, id)['state'], 'succeeded')
        self.assertCommandsBytes(third, id, 60)
        model = third.curl('/v1/models/spot.obj?content')
        self.assertEqual(model.body, spot().read_bytes())
        self.assertEqual(second.curl('/v1/models/spot.obj', '-X', 'DELETE').status, 204)
        self.await_no_leftovers()

    def test_an_upload_goes_on_at_any_node_from_what_a_killed_one_had(self):
        first, second, third = (self.serve() for _ in range(3))
        mesh = mesh_of(100_000)
        where = self.create_upload(first, mesh)
        self.assertEqual(self.patch(first, where, 0, mesh[:20_000]).status, 204)
        self.assertEqual(self.patch(second, where, 10_000, mesh[10_000:]).status, 409)
        self.assertEqual(self.patch(second, where, 20_000, mesh[20_000:50_000]).status, 204)
        self.assertEqual(self.patch(first, where, 50_000, mesh[50_000:60_000]).status, 204)
        first.process.kill()
        self.assertEqual(self.offset(third, where), 60_000)
        done = wait_until(lambda: (answer := self.patch(third, where, 60_000, mesh[60_000:])).status
                          != 409 and answer, 'the third node to go on')
        self.assertEqual(done.status, 204, done.body)
        for node in (second, third):
            model = node.curl('/v1/models/mesh.obj?content')
            self.assertEqual(model.body, mesh)
        # And one that is given up.
        where = self.create_upload(second, mesh)
        self.assertEqual(self.patch(second, where, 0, mesh[:20_000]).status, 204)
        ended = third.curl(where, '-X', 'DELETE', '-H', 'Tus-Resumable: 1.0.0')
        self.assertEqual(ended.status, 204)
        self.await_no_leftovers()

    def test_a_node_that_is_killed_while_it_puts_a_model_leaves_nothing(self):
        first, second = self.serve(), self.serve()
        block = self.blocked(lambda r: 'partNumber=2' in r.target)
        mesh = mesh_of(20 * MIB)
        client = threading.Thread(target=lambda: subprocess.run(
            ['curl', '-s', '-X', 'PUT', '--data-binary', '@-', '--max-time', '60',
             f'http://127.0.0.1:{first.http_port}/v1/models/mesh.obj'], input=mesh))
        client.start()
        block.wait()
        first.process.kill()
        client.join()
        block.go.set()
        self.assertEqual(second.curl('/v1/models/mesh.obj').status, 404)
        self.await_no_leftovers()
        self.put(second, 'mesh.obj', mesh)
        self.assertEqual(second.curl('/v1/models/mesh.obj').json()['sha256'],
                         hashlib.sha256(mesh).hexdigest())

    def end_while_it_commits(self, number):
        """A worker that gets this signal while it puts a result; the job's end is checked."""
        server = self.serve()
        self.put(server, 'spot.obj', spot().read_bytes())
        server.process.send_signal(signal.SIGSTOP)
        worker = self.worker()
        server.process.send_signal(signal.SIGCONT)
        block = None
        for seed in range(50):
            # What a killed one had sent has come before anybody looks for leftovers.
            block = self.blocked(lambda r: r.method == 'PUT', before=number != signal.SIGKILL)
            id = self.post(server, 80, seed=seed)
            block.wait()
            if str(self.running_at(id)).endswith(f':{worker.process.pid}'):
                break
            block.go.set()
            self.ended(server, id)
        else:
            self.fail('the worker never got a job')
        worker.process.send_signal(number)
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'succeeded', job)
        self.assertEqual([entry['why'] for entry in job['history']][-1], 'succeeded')
        self.assertGreater(len(job['history']), 1)
        self.assertCommandsBytes(server, id, 80, seed)
        before = self.sql(f"SELECT sequence, result_blob FROM strata.jobs WHERE id = '{id}'")
        block.go.set()
        assert block.done.wait(60), 'what it puts never came about'
        return worker, id, before

    def test_a_node_that_is_killed_while_it_puts_a_result_loses_no_job(self):
        worker, _, _ = self.end_while_it_commits(signal.SIGKILL)
        worker.process.wait()
        self.await_no_leftovers()

    def test_a_paused_node_that_wakes_after_its_lease_commits_nothing(self):
        worker, id, before = self.end_while_it_commits(signal.SIGSTOP)
        worker.process.send_signal(signal.SIGCONT)
        wait_until(lambda: worker.events('lease_lost') or worker.events('job_not_ended'),
                   'the sleeper to notice')
        self.assertEqual(self.sql(f"SELECT sequence, result_blob FROM strata.jobs WHERE id = '{id}'"),
                         before)
        self.assertEqual(worker.stop(), 0)
        self.await_no_leftovers()

    def test_while_the_bucket_is_away_requests_are_told_so_and_no_job_is_lost(self):
        server, other = self.serve(), self.serve()
        self.put(server, 'spot.obj', spot().read_bytes())
        ids = {}

        def post():
            seed = len(ids)
            ids[self.post(server, 300, seed=seed)] = seed
        for _ in range(4):
            post()
        self.await_a_running_job(post)
        self.store.fail(lambda r: True, s3.slow_down(), times=1 << 30)
        for node in (server, other):
            wait_until(lambda: node.curl('/readyz').status == 503, 'the node not to be ready')
            self.assertEqual(node.curl('/livez').status, 200)
        refused = server.curl('/v1/models/other.obj', '-X', 'PUT', body=CUBE)
        self.assertEqual(refused.status, 503, refused.body)
        self.assertIn('retry-after', refused.headers)
        self.assertIn('the bucket is away', refused.json()['detail'])
        later = self.post(server, 20)  # The queue is in the database.
        self.store.forget()
        for node in (server, other):
            wait_until(lambda: node.curl('/readyz').status == 200, 'the node to be ready')
        for id, seed in ids.items():
            self.assertEqual(self.ended(server, id)['state'], 'succeeded')
            self.assertCommandsBytes(other, id, 300, seed)
        self.assertEqual(self.ended(server, later)['state'], 'succeeded')
        self.assertEqual(self.put(server, 'other.obj', CUBE).status, 201)
        self.await_no_leftovers()

    @of_our_store
    def test_a_model_that_the_bucket_refuses_alone_fails_its_jobs_after_as_many_tries_as_allowed(self):
        self.put_by_another_node(cube=CUBE)
        server = self.serve('--max-attempts', '2')
        hash = hashlib.sha256(spot().read_bytes()).hexdigest()[2:]

        def damaged(handler, request):
            answer = handler.server.store.answer(request)
            answer.body = answer.body[:-1] + b'?'
            return answer
        for act, reason in (
                (lambda *_: s3.refusal(403, 'AccessDenied'), '403 AccessDenied'),
                (lambda *_: s3.refusal(403, 'InvalidObjectState'), '403 InvalidObjectState'),
                (lambda *_: s3.refusal(404, 'NoSuchKey'), 'no such object'),
                (lambda *_: s3.refusal(500, 'InternalError'), '500 InternalError'),
                (s3.cut_after(0), 'after 0 bytes'),  # A disk that cannot read it.
                (damaged, 'the MD5')):
            with self.subTest(reason):
                self.store.fail(lambda r: hash in r.target and r.method == 'GET', act, times=1 << 30)
                job = self.ended(server, self.post(server, 20))
                self.assertEqual(job['state'], 'failed', job)
                self.assertEqual(job['error']['type'], '/problems/storage')
                self.assertIn(reason, job['error']['detail'])
                self.assertIn('begun 2 times', job['error']['detail'])
                self.assertEqual(len(job['history']), 2, job['history'])
                for entry in job['history']:
                    self.assertTrue(entry['why'].startswith('failed: '), entry)
                    self.assertIn(reason, entry['why'])
                other = self.ended(server, self.post(server, 20, model='cube.obj'))
                self.assertEqual(other['state'], 'succeeded', other)
                self.assertEqual(server.curl('/readyz').status, 200)
                self.store.forget()
        self.assertEqual(server.events('bucket_away'), [])
        id = self.post(server, 20)
        self.assertEqual(self.ended(server, id)['state'], 'succeeded')
        self.assertCommandsBytes(server, id, 20)

    def test_a_model_whose_object_is_refused_is_put_anew_with_the_next_upload(self):
        self.put_by_another_node()
        hash = hashlib.sha256(spot().read_bytes()).hexdigest()[2:]
        old = next(name for name in self.objects() if hash in name)
        server = self.serve()
        self.store.fail(lambda r: old in r.target, lambda *_: s3.refusal(403, 'AccessDenied'),
                        times=1 << 30)
        self.put(server, 'spot.obj', spot().read_bytes())
        id = self.post(server, 20)
        self.assertEqual(self.ended(server, id)['state'], 'succeeded')
        self.store.forget()

    @of_our_store
    def test_a_bucket_that_refuses_everything_is_away_and_costs_no_job_a_try(self):
        self.put_by_another_node()
        server = self.serve('--max-attempts', '1')
        self.store.fail(lambda r: True, lambda *_: s3.refusal(403, 'AccessDenied'), times=1 << 30)
        id = self.post(server, 20)
        refused = wait_until(lambda: (answer := server.curl('/readyz')).status == 503 and answer,
                             'the node not to be ready')
        self.assertIn('the bucket is away', refused.json()['detail'])
        self.store.forget()
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'succeeded', job)
        self.assertCommandsBytes(server, id, 20)

    @of_our_store
    def test_a_bucket_whose_content_is_refused_and_not_its_heads_is_away_and_begins_no_job_again_and_again(self):
        self.put_by_another_node()
        server = self.serve('--max-attempts', '1')
        # As an archive's storage class, or a key that is disabled.
        self.store.fail(lambda r: r.method == 'GET', lambda *_: s3.refusal(403, 'InvalidObjectState'),
                        times=1 << 30)
        id = self.post(server, 20)
        hash = hashlib.sha256(spot().read_bytes()).hexdigest()[2:]
        wait_until(lambda: self.store.count('GET', 'store-id') >= 5, 'the bucket to be asked for again')
        self.assertLessEqual(self.store.count('GET', hash), 1)
        self.assertEqual(server.curl('/readyz').status, 503)
        self.store.forget()
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'succeeded', job)

    @of_our_store
    def test_a_bucket_that_is_not_there_any_more_is_away_and_no_damage(self):
        self.put_by_another_node()
        server = self.serve()
        self.store.fail(lambda r: True, lambda *_: s3.refusal(404, 'NoSuchBucket'), times=1 << 30)
        answer = server.curl('/v1/models/spot.obj?content')
        self.assertEqual(answer.status, 503, answer.body)
        self.assertIn('the bucket is away', answer.json()['detail'])

    def test_what_a_failed_append_left_is_no_part_of_the_model(self):
        server = self.serve()
        mesh = mesh_of(30_000)
        made = server.curl('/v1/uploads', '-X', 'POST', '-H', 'Tus-Resumable: 1.0.0', '-H',
                           'Upload-Defer-Length: 1', '-H', 'Upload-Metadata: name bWVzaC5vYmo=')
        where = made.headers['location']
        self.assertEqual(self.patch(server, where, 0, mesh[:20_000]).status, 204)
        self.store.fail(lambda r: True, s3.slow_down(), times=1 << 30)
        self.assertEqual(self.patch(server, where, 20_000, mesh[20_000:]).status, 503)
        self.store.forget()
        wait_until(lambda: server.curl('/readyz').status == 200, 'the node to be ready')
        self.assertEqual(self.offset(server, where), 20_000)
        done = self.patch(server, where, 20_000, b'', '-H', 'Upload-Length: 20000')
        self.assertIn(done.status, (204, 409), done.body)  # 409: whole already.
        hash = hashlib.sha256(mesh[:20_000]).hexdigest()
        self.assertEqual(server.curl('/v1/models/mesh.obj').json()['sha256'], hash)
        for copy in pathlib.Path(self.folder.name).glob(f'*/cache/{hash}'):
            self.assertEqual(copy.stat().st_size, 20_000)
        self.await_no_leftovers()

    def test_who_lost_an_upload_does_not_delete_its_pieces(self):
        server = self.serve()
        mesh = mesh_of(30_000)
        where = self.create_upload(server, mesh)
        self.assertEqual(self.patch(server, where, 0, mesh[:20_000]).status, 204)
        upload = where.rsplit('/', 1)[1]
        with nodes_test.HeldBack(self.database) as held:
            answers = []
            client = threading.Thread(target=lambda: answers.append(
                server.curl(where, '-X', 'DELETE', '-H', 'Tus-Resumable: 1.0.0')))
            client.start()
            wait_until(lambda: self.sql("SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"
                                        f" AND EXISTS (SELECT 1 FROM strata.uploads WHERE id = '{upload}'"
                                        " AND holder <> '')"), 'it to be about to delete')
            # As if its lease had run out, and another had taken over.
            self.sql(f"UPDATE strata.uploads SET holder = 'another' WHERE id = '{upload}'")
            held.let_go()
            client.join()
        self.assertEqual(answers[0].status, 409, answers[0].body)
        self.assertEqual(self.sql('SELECT "offset", size FROM strata.upload_pieces'), [['0', '20000']])
        self.assertEqual(self.patch(server, where, 20_000, mesh[20_000:]).status, 204)
        self.assertEqual(server.curl('/v1/models/mesh.obj?content').body, mesh)

    def test_no_secret_is_told_or_handed_on(self):
        server = self.serve()
        self.put(server, 'spot.obj', spot().read_bytes())
        id = self.post(server, 1500)
        # Until a child is a program of its own it shows its parent's environment.
        parent = harness.arguments(server.process.pid)
        child = wait_until(lambda: [each for each in server.children()
                                    if harness.arguments(each) not in (b'', parent)],
                           'the child that samples')[0]
        secret = self.environment()['AWS_SECRET_ACCESS_KEY']
        inherited = pathlib.Path(f'/proc/{child}/environ').read_bytes()
        if len(secret) > 6:
            self.assertNotIn(secret.encode(), inherited)
            self.assertNotIn(secret, json.dumps(server.log))
        self.assertNotIn(b'AWS_SECRET_ACCESS_KEY', inherited)
        server.curl(f'/v1/jobs/{id}', '-X', 'DELETE')


class RefusalsTest(BucketCase):
    def refused(self, status, *options):
        done = subprocess.run([harness.strata(), 'serve', '--http', '127.0.0.1:0', '--grpc', 'off',
                               '--scratch', self.folder.name, *options], capture_output=True,
                              text=True, cwd=self.folder.name, timeout=60,
                              env={**os.environ, **self.environment()})
        self.assertEqual(done.returncode, status, done.stderr)
        return done.stderr

    def test_one_prefix_is_one_stores_and_a_store_keeps_to_its_place(self):
        self.serve().stop()
        mine, own = self.data.parent / 'mine', ('--blobs', 's3://bucket/own')
        self.assertIn('belongs to another store',
                      self.refused(9, '--data', str(mine), *self.bucket_options()[:2]))
        database = ('--database', nodes_test.POSTGRES.url(self.database))
        self.assertIn('name it with --blobs', self.refused(9, *database, '--data', str(mine) + '2'))
        self.assertIn('belongs to another store',
                      self.refused(9, *database, '--data', str(mine) + '3', *own))
        single = Server('--data', str(mine) + '4')
        self.nodes.append(single)
        self.put(single, 'cube.obj', CUBE)
        single.stop()
        self.assertIn('lies in its data folder',
                      self.refused(9, '--data', str(mine) + '4', *own))
        self.assertIn('expected a folder of this process',
                      self.refused(9, *database, '--data', str(mine) + '4',
                                   *self.bucket_options()[:2]))

    def test_of_two_stores_that_claim_a_prefix_at_once_one_alone_gets_it(self):
        for understood in (True, False):  # The condition: a store that ignores it is as s3rver.
            with self.subTest(understood=understood):
                self.store.backend.conditional = understood
                where = ('--blobs', f's3://bucket/race{understood:d}')
                mark = f'race{understood:d}/store-id'
                blocks = [self.blocked(lambda r: r.method == 'PUT' and mark in r.target) for _ in 'ab']
                claims = [subprocess.Popen(
                    [harness.strata(), 'serve', '--http', '127.0.0.1:0', '--grpc', 'off', '--scratch',
                     self.folder.name, '--data', f'{self.data}-{understood:d}{name}', *where],
                    stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                    cwd=self.folder.name, env={**os.environ, **self.environment()}) for name in 'ab']
                self.addCleanup(lambda claims=claims: [(each.kill(), each.communicate())
                                                       for each in claims])
                for block in blocks:  # Both have seen that nobody has it.
                    block.wait()
                blocks[0].go.set()
                assert blocks[0].done.wait(60)
                read = wait_until(lambda: self.store.count('GET', mark), 'the first to look again')
                self.assertGreater(read, 0)
                blocks[1].go.set()
                assert blocks[1].done.wait(60)
                if not understood:  # Both begin: what docs/operations.md warns of.
                    self.assertEqual(self.store.count('PUT', mark), 2)
                    continue
                lost = wait_until(lambda: [each for each in claims if each.poll() is not None],
                                  'one of them to be refused')
                self.assertEqual(len(lost), 1)
                self.assertEqual(lost[0].returncode, 9)
                self.assertIn('belongs to another store', lost[0].stderr.read())

    def test_a_bucket_that_is_not_there_is_told_at_the_start(self):
        self.store.keys.clear()
        self.assertIn('the bucket is away', self.refused(8, *self.bucket_options()[:4]))


class SingleTest(BucketCase):
    """SQLite in the data folder, content in the bucket."""

    def single(self, *more):
        self.nodes.append(Server('--blobs', 's3://bucket/strata', '--data', str(self.data), '--jobs', '1',
                                 *more, environment=self.environment()))
        return self.nodes[-1]

    def rows(self):
        import sqlite3
        with sqlite3.connect(f'file:{self.data}/strata.db?mode=ro', uri=True) as database:
            return {f'blobs/{hash[:2]}/{hash[2:]}.{file}' for hash, file in
                    database.execute('SELECT hash, file FROM blobs')} | {'store-id'}

    def test_a_killed_service_goes_on_with_what_it_had(self):
        server = self.single()
        self.put(server, 'spot.obj', spot().read_bytes())
        mesh = mesh_of(100_000)
        where = self.create_upload(server, mesh)
        self.assertEqual(self.patch(server, where, 0, mesh[:20_000]).status, 204)
        id = self.post(server, 60)
        self.ended(server, id)
        block = self.blocked(lambda r: r.method == 'PUT', before=False)
        client = threading.Thread(target=lambda: subprocess.run(
            ['curl', '-s', '-X', 'PUT', '--data-binary', '@-', '--max-time', '60',
             f'http://127.0.0.1:{server.http_port}/v1/models/lost.obj'], input=CUBE))
        client.start()
        block.wait()  # The object is there, its row is not.
        server.process.kill()
        client.join()
        block.go.set()
        self.assertEqual(len(self.objects() - self.rows()), 1)
        server = self.single()
        self.assertEqual(self.objects(), self.rows())
        self.assertEqual(server.curl('/v1/models/lost.obj').status, 404)
        self.assertCommandsBytes(server, id, 60)
        self.assertEqual(self.offset(server, where), 20_000)
        self.assertEqual(self.patch(server, where, 20_000, mesh[20_000:]).status, 204)
        self.assertEqual(server.curl('/v1/models/mesh.obj?content').body, mesh)
        self.assertEqual(server.curl('/v1/models/mesh.obj', '-X', 'DELETE').status, 204)
        wait_until(lambda: self.objects() == self.rows(), 'the deleted model to be deleted')

    def test_a_bucket_that_is_silent_is_told_within_seconds_and_holds_up_no_health_probe(self):
        server = self.single('--blob-cache', '150K')
        self.put(server, 'cube.obj', CUBE)
        silent = threading.Event()
        self.addCleanup(silent.set)

        def wait(handler, request):
            silent.wait(120)
            return handler.server.store.answer(request)
        self.store.fail(lambda r: True, wait, times=1 << 30)
        wait_until(lambda: server.curl('/readyz', '--max-time', '30').status == 503,
                   'the node not to be ready')
        self.assertEqual(server.curl('/livez', '--max-time', '30').status, 200)
        refused = server.curl('/v1/models/other.obj', '-X', 'PUT', body=b'# other\n' + CUBE)
        self.assertEqual(refused.status, 503, refused.body)
        self.store.forget()
        silent.set()
        wait_until(lambda: server.curl('/readyz').status == 200, 'the node to be ready')

    def test_a_result_that_the_bucket_is_slow_to_tell_of_holds_up_no_other(self):
        server = self.single()
        self.put(server, 'cube.obj', CUBE)
        query = '/v1/samples?model=cube.obj&format=xyz&resolution='
        wanted = server.curl(query + '8').body
        self.assertEqual(server.stop(), 0)
        for copy in (self.data / 'cache').iterdir():
            copy.unlink()
        server = self.single()
        hash = hashlib.sha256(wanted).hexdigest()
        block = self.blocked(lambda r: r.method == 'HEAD' and hash[2:] in r.target)
        answers = []
        client = threading.Thread(target=lambda: answers.append(server.curl(query + '8')))
        client.start()
        block.wait()
        other = server.curl(query + '9', '--max-time', '60')
        self.assertEqual(other.status, 200, other.body)
        block.go.set()
        client.join()
        self.assertEqual(answers[0].body, wanted)

    @of_our_store
    def test_a_checkpoint_outlives_a_bucket_that_is_away(self):
        options, sheet = ('--job-memory', '64M', '--job-threads', '1'), resume_test.sheet()

        def checkpoints():
            return list((self.data / 'checkpoints').glob('*/checkpoint'))
        for seed in range(9):
            server = self.single(*options)
            if seed == 0:
                self.put(server, 'sheet.ply', sheet)
            id = self.post(server, 1000, model='sheet.ply', seed=seed)
            wait_until(lambda: checkpoints() or self.job(server, id)['state'] == 'succeeded',
                       'a checkpoint')
            children = server.children()
            server.process.kill()
            server.process.wait()
            wait_until(lambda: not any(map(harness.is_alive, children)), 'its job to end')
            with contextlib.closing(sqlite3.connect(self.data / 'strata.db')) as database:
                if database.execute('SELECT 1 FROM jobs WHERE finished IS NULL').fetchall():
                    break
        else:
            self.fail('each job was done before it could be killed')
        for copy in (self.data / 'cache').iterdir():
            copy.unlink()
        hash = hashlib.sha256(sheet).hexdigest()[2:]
        self.store.fail(lambda r: r.method == 'GET' and hash in r.target, s3.hang_up, times=1 << 30)
        server = self.single(*options)
        wait_until(lambda: 'released by its process' in
                   [entry.get('why') for entry in self.job(server, id)['history']], 'the job to be given back')
        self.assertTrue(checkpoints())
        self.store.forget()
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'succeeded', job)
        self.assertGreater(json.loads(job['summary']['json'])['resumed_at_triangle'], 0)

    @of_our_store
    def test_a_disk_that_is_full_while_a_model_is_fetched_is_told_as_that(self):
        server = self.single()
        self.put(server, 'large.obj', mesh_of(3 * MIB))
        self.put(server, 'cube.obj', CUBE)
        self.assertEqual(server.stop(), 0)
        for copy in (self.data / 'cache').iterdir():
            copy.unlink()
        server = self.single()
        # No file may become larger: a disk that is full for the model alone.
        subprocess.run(['prlimit', '--fsize=2000000:', '--pid', str(server.process.pid)], check=True)
        job = self.ended(server, self.post(server, 20, model='large.obj'))
        self.assertEqual(job['state'], 'failed', job)
        self.assertEqual(len(job['history']), 1, job['history'])
        self.assertEqual(job['error']['type'], '/problems/storage')
        self.assertIn('cannot write what is fetched at byte', job['error']['detail'])
        answer = server.curl('/v1/samples?model=large.obj&resolution=20&format=xyz')
        self.assertEqual(answer.status, 507, answer.body)
        self.assertEqual(answer.json()['type'], '/problems/storage')
        self.assertNotIn('the bucket is away', answer.json()['detail'])
        self.assertEqual(server.curl('/readyz').status, 200)
        other = server.curl('/v1/samples?model=cube.obj&resolution=20&format=xyz')
        self.assertEqual(other.status, 200, other.body)
        subprocess.run(['prlimit', '--fsize=unlimited:', '--pid', str(server.process.pid)], check=True)
        job = self.ended(server, self.post(server, 20, model='large.obj'))
        self.assertEqual(job['state'], 'succeeded', job)

    @of_our_store
    def test_an_object_that_may_not_be_deleted_holds_up_nothing(self):
        server = self.single()
        for name in ('kept.obj', 'gone.obj'):
            self.put(server, name, mesh_of(1000, name))
        kept = hashlib.sha256(mesh_of(1000, 'kept.obj')).hexdigest()[2:]
        self.store.fail(lambda r: r.method == 'DELETE' and kept in r.target,
                        lambda *_: s3.refusal(403, 'AccessDenied'), times=1 << 30)
        for name in ('kept.obj', 'gone.obj'):
            self.assertEqual(server.curl(f'/v1/models/{name}', '-X', 'DELETE').status, 204)
        wait_until(lambda: len(self.objects() - self.rows()) == 1, 'the other one to be deleted')
        wait_until(lambda: server.events('bucket_refuses'), 'the log to say so')
        self.assertEqual(server.events('bucket_away'), [])
        self.assertEqual(server.curl('/readyz').status, 200)
        self.store.forget()
        wait_until(lambda: self.objects() == self.rows(), 'what no row names to be deleted')

    def test_an_object_that_could_not_be_deleted_at_once_is_deleted_later(self):
        server = self.single()
        # It is put, and the answer is lost; then nothing is answered for a while.
        def put_and_lose(handler, request):
            handler.server.store.answer(request)
            self.store.fail(lambda r: True, s3.slow_down(), times=1 << 30)
            return s3.refusal(403, 'AccessDenied')
        self.store.fail(lambda r: r.method == 'PUT', put_and_lose)
        answer = server.curl('/v1/models/cube.obj', '-X', 'PUT', body=CUBE)
        self.assertEqual(answer.status, 503, answer.body)
        self.assertEqual(len(self.objects() - self.rows()), 1)
        self.store.forget()
        wait_until(lambda: self.objects() == self.rows(), 'what no row names to be deleted')
        self.put(server, 'cube.obj', CUBE)
        self.assertEqual(self.objects(), self.rows())

    def test_copies_stay_within_their_limit_and_wrong_ones_are_not_used(self):
        server = self.single('--blob-cache', '150K')
        meshes = {f'{i}.obj': mesh_of(60_000, i) for i in range(4)}
        for name, mesh in meshes.items():
            self.put(server, name, mesh)
        cache = self.data / 'cache'

        def names():
            return {path.name for path in cache.iterdir()}
        last = [hashlib.sha256(meshes[name]).hexdigest() for name in ('2.obj', '3.obj')]
        self.assertEqual(names(), set(last), 'the two that were used last')
        query = '/v1/samples?model={}&resolution=8&format=xyz'
        fetched = self.store.count('GET')
        body = server.curl(query.format('0.obj')).body
        self.assertEqual(body, server.curl(query.format('0.obj')).body)
        self.assertEqual(self.store.count('GET') - fetched, 1)
        self.assertLessEqual(sum(path.stat().st_size for path in cache.iterdir()), 150 << 10)
        server.process.kill()
        server.process.wait()
        # What lies there was damaged meanwhile: it is fetched again.
        hash = hashlib.sha256(meshes['0.obj']).hexdigest()
        damaged = bytearray((cache / hash).read_bytes())
        damaged[5] ^= 1
        (cache / hash).write_bytes(damaged)
        server = self.single('--blob-cache', '150K')
        answer = server.curl(query.format('0.obj') + '&seed=1')
        self.assertEqual(answer.status, 200, answer.body)
        self.assertEqual((cache / hash).read_bytes(), meshes['0.obj'])
        answer = server.curl('/v1/models/large.obj', '-X', 'PUT', body=mesh_of(400_000))
        self.assertEqual(answer.status, 413, answer.body)
        self.assertIn('--blob-cache', answer.json()['detail'])

    def test_a_result_that_is_damaged_in_the_bucket_does_not_leave_whole(self):
        if 'S3RVER' in os.environ:
            self.skipTest('objects are changed in memory')
        server = self.single('--blob-cache', '400K')
        self.put(server, 'spot.obj', spot().read_bytes())
        self.put(server, 'other.obj', mesh_of(200_000))
        hash = hashlib.sha256(spot().read_bytes()).hexdigest()
        with self.store.backend.lock:
            key = next(key for key in self.store.backend.objects if hash[2:] in key[1])
            body, etag = self.store.backend.objects[key]
            self.store.backend.objects[key] = body[:-1] + b'?', etag
        done = subprocess.run(['curl', '-s', '-o', '/dev/null', '--max-time', '60',
                               f'http://127.0.0.1:{server.http_port}/v1/models/spot.obj?content'])
        self.assertEqual(done.returncode, 18, 'curl: the transfer ended early')


if __name__ == '__main__':
    nodes_test.main()
