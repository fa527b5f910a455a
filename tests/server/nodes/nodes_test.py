#!/usr/bin/env python3
"""Several processes on one PostgreSQL: killed, paused, cut off; every job ends once, with the bytes of
the command."""
import hashlib
import json
import os
import pathlib
import random
import select
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / 'serve'))
import cluster  # noqa: E402
import harness  # noqa: E402
from harness import CUBE, Server, sample_by_command, spot, wait_until  # noqa: E402

LEASE = 2  # Seconds: the shortest there is.
POSTGRES = None


class Worker(harness.Logged):
    """`strata worker`, its log read as it comes."""

    def __init__(self, *options, environment=None):
        self.folder = tempfile.TemporaryDirectory()
        self.begin('worker', '--scratch', self.folder.name, *options, folder=self.folder.name,
                   environment=environment)
        wait_until(lambda: self.events('working') or self.process.poll() is not None,
                   'the worker to begin')
        assert self.process.poll() is None, f'the worker ended: {self.log}'

    def stop(self, number=signal.SIGTERM):
        status = self.end(number)
        self.folder.cleanup()
        return status


class HeldBack:
    """Keeps the lock of all writers, as one that was paused in the middle would."""

    def __init__(self, database, before=''):
        self.session = subprocess.Popen(
            ['psql', '-X', '-q', '-h', str(POSTGRES.folder), '-p', str(POSTGRES.port), '-U', 'strata',
             '-d', database], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True)
        self.session.stdin.write(f"{before} BEGIN; SELECT pg_advisory_xact_lock({0x5374},"
                                 " hashtext('strata')); SELECT 'held';\n")
        self.session.stdin.flush()
        while 'held' not in self.session.stdout.readline():
            pass

    def let_go(self):
        self.session.kill()
        self.session.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.let_go()
        self.session.stdout.close()
        self.session.stdin.close()


class Relay:
    """Connections to PostgreSQL, which the test may cut: those there are, and all that come."""

    def __init__(self, port):
        self.target, self.open, self.pairs = port, True, []
        self.lock = threading.Lock()  # No connection comes about while all are cut.
        self.listener = socket.create_server(('127.0.0.1', 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            with self.lock:
                if not self.open:
                    client.close()
                    continue
                server = socket.create_connection(('127.0.0.1', self.target))
                self.pairs.append((client, server))
            for one, other in ((client, server), (server, client)):
                threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    @staticmethod
    def _carry(one, other):
        try:
            while piece := one.recv(65536):
                other.sendall(piece)
        except OSError:
            pass
        for end in (one, other):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def cut(self):
        with self.lock:
            self.open = False
            for end in [end for pair in self.pairs for end in pair]:
                try:
                    end.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass

    def mend(self):
        self.open = True

    def stop(self):
        self.cut()
        self.listener.close()


def attempts_of(options):
    """How often a job may be begun, unless a test says: on a busy machine the lease of a process that
    lives may run out, too."""
    return () if '--max-attempts' in options else ('--max-attempts', '50')


def files_below(folder):
    """Their paths in it. Folders may go while they are looked through."""
    return {os.path.relpath(os.path.join(inner, name), folder)
            for inner, _, names in os.walk(folder) for name in names}


class NodesCase(unittest.TestCase):
    lease = LEASE  # Longer, where none is to run out.

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.data = pathlib.Path(self.folder.name) / 'data'
        self.database = f'test{random.randrange(1 << 60):x}'
        POSTGRES.sql(f'CREATE DATABASE {self.database}')
        self.nodes = []
        self.addCleanup(self.folder.cleanup)
        self.addCleanup(self.end)

    def end(self):
        for node in self.nodes:
            if node.process.poll() is None:
                node.process.send_signal(signal.SIGCONT)
            node.stop()

    def options(self, url=None):
        return ('--database', url or POSTGRES.url(self.database), '--data', str(self.data),
                '--models', str(spot().parent), '--lease', str(self.lease), '--job-threads', '1')

    def serve(self, *more, url=None, **rest):
        self.nodes.append(Server(*self.options(url), *attempts_of(more), *more, **rest))
        return self.nodes[-1]

    def worker(self, *more, url=None, **rest):
        self.nodes.append(Worker(*self.options(url), *attempts_of(more), *more, **rest))
        return self.nodes[-1]

    def sql(self, text):
        return POSTGRES.sql(text, self.database)

    def post(self, server, resolution, key=None, seed=0, model='spot.obj', **options):
        body = {'model': model, 'options': {'resolution': resolution, 'format': 'xyz', 'seed': seed,
                                            **options}}
        headers = ['-H', 'Content-Type: application/json']
        headers += ['-H', f'Idempotency-Key: {key}'] if key else []
        answer = server.curl('/v1/jobs', *headers, body=json.dumps(body).encode())
        self.assertEqual(answer.status, 202, answer.body)
        return answer.json()['id']

    def job(self, server, id, wait=0):
        return server.curl(f'/v1/jobs/{id}?wait={wait}').json()

    def ended(self, server, id):
        return wait_until(lambda: (job := self.job(server, id, 30))['state'] in
                          ('succeeded', 'failed', 'cancelled') and job, f'the end of job {id}')

    def running_at(self, id):
        rows = self.sql(f"SELECT owner FROM strata.jobs WHERE id = '{id}' AND state = 1")
        return rows[0][0] if rows else None

    def is_claimed_by(self, node, id):
        """Whether it was this node that was seen to run a job."""
        owner = wait_until(lambda: self.running_at(id) or
                           self.sql(f"SELECT 'x' FROM strata.jobs WHERE id='{id}' AND state > 1"),
                           'the job to be claimed')
        return str(owner).endswith(f':{node.process.pid}')

    def job_at(self, node, server, resolution):
        """(id, seed) of a job that was seen to run at this node."""
        for seed in range(50):
            id = self.post(server, resolution, seed=seed)
            if self.is_claimed_by(node, id):
                return id, seed
        self.fail('the node never got a job')

    def await_a_running_job(self, post):
        """`post` makes one more where all have ended before one was seen."""
        def one_runs():
            if not self.sql('SELECT 1 FROM strata.jobs WHERE state < 2'):
                post()
            return self.sql('SELECT 1 FROM strata.jobs WHERE state = 1')
        wait_until(one_runs, 'a job to run')

    def assertCommandsBytes(self, server, id, resolution, seed=0):
        wanted = sample_by_command(spot(), 'xyz', '--resolution', str(resolution), '--seed',
                                   str(seed))
        got = server.curl(f'/v1/jobs/{id}/result').body
        self.assertEqual(hashlib.sha256(got).hexdigest(), hashlib.sha256(wanted).hexdigest())


class SharedQueueTest(NodesCase):
    lease = 60

    def test_a_job_made_at_one_node_runs_at_another_and_is_watched_at_a_third(self):
        first, second = (self.serve('--jobs', '1') for _ in range(2))
        worker = self.worker('--jobs', '2', '--http', '127.0.0.1:0')
        ids = {seed: self.post(first, 60, seed=seed) for seed in range(6)}
        for seed, id in ids.items():
            events = second.curl(f'/v1/jobs/{id}/events').body.decode()
            self.assertIn('"state":"succeeded"', events.replace(' ', ''))
            self.assertEqual(self.ended(first, id)['state'], 'succeeded')
        self.assertCommandsBytes(second, ids[3], 60, 3)
        job = self.job(second, ids[0])
        self.assertEqual([entry['why'] for entry in job['history']], ['succeeded'])
        self.assertEqual(first.curl('/readyz').status, 200)
        port = int(worker.events('working')[0]['http'].rsplit(':', 1)[1])
        for path, status in (('/livez', 200), ('/readyz', 200), ('/metrics', 200), ('/v1/jobs', 404)):
            done = subprocess.run(['curl', '-s', '-o', '/dev/null', '-w', '%{http_code}',
                                   f'http://127.0.0.1:{port}{path}'], capture_output=True, text=True)
            self.assertEqual(done.stdout, str(status), path)

    def test_one_idempotency_key_is_one_job_over_all_nodes(self):
        nodes = [self.serve('--jobs', '1') for _ in range(2)]
        ids = []
        threads = [threading.Thread(target=lambda node=node: ids.append(self.post(node, 40, 'key')))
                   for node in nodes * 4]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(len(ids), 8)
        self.assertEqual(len(set(ids)), 1)

    def test_an_upload_begun_at_one_node_goes_on_at_another(self):
        first, second = (self.serve('--jobs', '1') for _ in range(2))
        mesh = CUBE + b'# comment\n' * 5000
        name = 'bWVzaC5vYmo='  # mesh.obj
        made = first.curl('/v1/uploads', '-X', 'POST', '-H', 'Tus-Resumable: 1.0.0', '-H',
                          f'Upload-Length: {len(mesh)}', '-H', f'Upload-Metadata: name {name}')
        self.assertEqual(made.status, 201, made.body)
        where = made.headers['location']

        def patch(node, offset, body):
            return node.curl(where, '-X', 'PATCH', '-H', 'Tus-Resumable: 1.0.0', '-H',
                             'Content-Type: application/offset+octet-stream', '-H',
                             f'Upload-Offset: {offset}', body=body).status
        self.assertEqual(patch(first, 0, mesh[:20000]), 204)
        self.assertEqual(patch(second, 10000, mesh[10000:]), 409, 'another offset')
        # A client that stalls at the first node: the second says 409 until that one let go.
        with first.connect() as stalled:
            stalled.sendall((f'PATCH {where} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\n'
                             'Content-Type: application/offset+octet-stream\r\nUpload-Offset: 20000'
                             f'\r\nContent-Length: {len(mesh) - 20000}\r\n\r\n').encode())
            wait_until(lambda: self.sql("SELECT 1 FROM strata.uploads WHERE holder <> ''"),
                       'the first node to hold the upload')
            self.assertEqual(patch(second, 20000, mesh[20000:]), 409)
        wait_until(lambda: not self.sql("SELECT 1 FROM strata.uploads WHERE holder <> ''"),
                   'the first node to let go')
        self.assertEqual(patch(second, 20000, mesh[20000:]), 204)
        for node in (first, second):
            model = node.curl('/v1/models/mesh.obj').json()
            self.assertEqual(model['sha256'], hashlib.sha256(mesh).hexdigest())

    def test_two_thousand_jobs_among_four_workers_are_each_committed_once(self):
        # The same result for all: it is the queue that is asked here.
        server = self.serve('--jobs', '1', '--stored-jobs', '10000')
        first = self.post(server, 20)
        self.ended(server, first)
        for _ in range(4):
            self.worker('--jobs', '1', '--isolate', 'off')
        began = time.monotonic()
        self.sql("""
            INSERT INTO strata.jobs (id, state, model, model_hash, options, result_key, client,
                                     request_hash, created)
            SELECT md5(i::text), 0, model, model_hash, options, result_key, '', request_hash, created
            FROM strata.jobs, generate_series(1, 2000) AS i""")
        wait_until(lambda: self.sql('SELECT count(*) FROM strata.jobs WHERE state < 2') == [['0']],
                   'all jobs to end')
        print(f'2,000 jobs among 5 processes: {time.monotonic() - began:.1f} s', file=sys.stderr)
        self.assertEqual(self.sql('SELECT state, count(*) FROM strata.jobs GROUP BY 1'),
                         [['2', '2001']])
        self.assertEqual(self.sql("SELECT count(*), count(DISTINCT job) FROM strata.attempts"
                                  " WHERE why = 'succeeded'"), [['2001', '2001']])
        self.assertEqual(self.sql('SELECT count(*) FROM strata.attempts'), [['2001']])
        self.assertGreaterEqual(
            int(self.sql('SELECT count(DISTINCT owner) FROM strata.attempts')[0][0]), 4)


class FaultsTest(NodesCase):
    def test_a_paused_worker_that_wakes_after_its_lease_commits_nothing(self):
        server = self.serve('--jobs', '1')
        server.process.send_signal(signal.SIGSTOP)
        sleeper = self.worker('--jobs', '1')
        server.process.send_signal(signal.SIGCONT)
        # One that the sleeper has: ask until it is the one to get a job, and is stopped before its end.
        for seed in range(50):
            id = self.post(server, 500, seed=seed)
            if not self.is_claimed_by(sleeper, id):
                continue
            sleeper.process.send_signal(signal.SIGSTOP)
            if self.sql(f"SELECT 1 FROM strata.jobs WHERE id = '{id}' AND state < 2"):
                break
            sleeper.process.send_signal(signal.SIGCONT)
        else:
            self.fail('the worker was never stopped with a job')
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'succeeded')
        whys = [entry['why'] for entry in job['history']]
        # On a busy machine another lease may run out, too.
        self.assertEqual((set(whys[:-1]), whys[-1]), ({'its lease ran out'}, 'succeeded'), whys)
        before = self.sql(f"SELECT sequence, result_blob FROM strata.jobs WHERE id = '{id}'")
        sleeper.process.send_signal(signal.SIGCONT)
        wait_until(lambda: sleeper.events('lease_lost') or sleeper.events('job_not_ended'),
                   'the sleeper to notice')
        self.assertEqual(self.sql(f"SELECT sequence, result_blob FROM strata.jobs WHERE id = '{id}'"),
                         before)
        self.assertCommandsBytes(server, id, 500, seed)
        again = self.post(server, 30, seed=1)
        self.assertEqual(self.ended(server, again)['state'], 'succeeded')

    def test_kill_9_at_random_moments_loses_no_job(self):
        seed = random.randrange(1 << 30)
        print(f'seed {seed}', file=sys.stderr)
        draw = random.Random(seed)
        server = self.serve('--jobs', '1')
        jobs = {}
        for number in range(30):
            jobs[self.post(server, 60 + number, seed=number)] = (60 + number, number)
        victims = [self.worker('--jobs', '2', '--max-attempts', '50') for _ in range(2)]
        other = self.serve('--jobs', '1', '--max-attempts', '50')
        for _ in range(8):
            select.select([], [], [], draw.uniform(0.05, 0.5))
            at = draw.randrange(3)
            if at == 2:
                other.process.kill()
                other.process.wait()
                other = self.serve('--jobs', '1', '--max-attempts', '50')
            else:
                victims[at].process.kill()
                victims[at].process.wait()
                victims[at] = self.worker('--jobs', '2', '--max-attempts', '50')
        for id, (resolution, number) in jobs.items():
            job = self.ended(server, id)
            self.assertEqual(job['state'], 'succeeded', job)
        for id in draw.sample(sorted(jobs), 4):
            self.assertCommandsBytes(server, id, *jobs[id])
        self.assertEqual(self.sql("SELECT job FROM strata.attempts WHERE why = 'succeeded'"
                                  ' GROUP BY job HAVING count(*) <> 1'), [])
        # Every row has its file, and of the dead nothing is left once their leases have run out.
        def rows():
            return {f'blobs/{hash[:2]}/{hash[2:]}.{file}'
                    for hash, file in self.sql('SELECT hash, file FROM strata.blobs')}

        def files():
            return {f'{inner}/{name}' for inner in ('blobs', 'incoming', 'uploads')
                    for name in files_below(self.data / inner)}
        wait_until(lambda: files() == rows(), 'only the files that rows name')

    def test_cut_off_from_the_database_a_worker_commits_nothing_and_comes_back(self):
        relay = Relay(POSTGRES.port)
        self.addCleanup(relay.stop)
        server = self.serve('--jobs', '1')
        password = self.data.parent / 'password'
        password.write_text(cluster.PASSWORD + '\n')
        worker = self.worker('--jobs', '1', '--database-password-file', str(password),
                             url=POSTGRES.tcp_url(self.database, relay.port))
        id, seed = self.job_at(worker, server, 400)
        relay.cut()
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'succeeded')
        self.assertCommandsBytes(server, id, 400, seed)
        relay.mend()
        before = len(self.sql('SELECT 1 FROM strata.processes'))
        wait_until(lambda: worker.events('database_back'), 'the worker to be back')
        self.assertGreaterEqual(before, 1)
        said = json.dumps(worker.log)
        self.assertNotIn(cluster.PASSWORD, said)
        self.assertNotIn(cluster.PASSWORD,
                         pathlib.Path(f'/proc/{worker.process.pid}/cmdline').read_text())

    def test_a_restart_of_postgresql_under_load_loses_nothing(self):
        server = self.serve('--jobs', '1')
        self.worker('--jobs', '1')
        jobs = {}

        def post():
            seed = len(jobs)
            jobs[self.post(server, 150, seed=seed)] = seed
        for mode in ('fast', 'immediate'):
            for _ in range(8):
                post()
            self.await_a_running_job(post)
            POSTGRES.stop_server(mode)
            try:
                answer = server.curl('/v1/jobs', '-H', 'Content-Type: application/json',
                                     body=b'{"model":"spot.obj","options":{"resolution":9}}')
                self.assertEqual(answer.status, 503, answer.body)
                self.assertIn('retry-after', answer.headers)
                self.assertEqual(server.curl('/readyz').status, 503)
                self.assertEqual(server.curl('/livez').status, 200)
            finally:
                POSTGRES.start()
            wait_until(lambda: server.curl('/readyz').status == 200, 'the service to be ready')
        for id, seed in jobs.items():
            self.assertEqual(self.ended(server, id)['state'], 'succeeded')
        self.assertCommandsBytes(server, next(iter(jobs)), 150, next(iter(jobs.values())))

    def test_backends_that_are_ended_again_and_again_lose_nothing(self):
        server = self.serve('--jobs', '1')
        for _ in range(2):
            self.worker('--jobs', '1', '--max-attempts', '50')
        jobs = {self.post(server, 100, seed=seed): seed for seed in range(24)}
        others = (f"FROM pg_stat_activity WHERE datname = '{self.database}' AND pid <> pg_backend_pid()")
        ended = set()
        for _ in range(20):
            # All have come back before they are ended again; one that was ended may be there for a while.
            wait_until(lambda: len({pid for pid, in self.sql(f'SELECT pid {others}')} - ended) >= 3,
                       'the processes to be back')
            ended |= {pid for pid, _ in self.sql(f'SELECT pid, pg_terminate_backend(pid) {others}')}
        self.assertGreaterEqual(len(ended), 60)
        for id in jobs:
            self.assertEqual(self.ended(server, id)['state'], 'succeeded')
        self.assertEqual(self.sql("SELECT job FROM strata.attempts WHERE why = 'succeeded'"
                                  ' GROUP BY job HAVING count(*) <> 1'), [])
        self.assertCommandsBytes(server, next(iter(jobs)), 100, 0)

    def test_a_database_that_takes_no_changes_is_away_and_its_connections_are_made_anew(self):
        server = self.serve('--jobs', '1')
        self.ended(server, self.post(server, 30))
        # As after a failover: connections lead to what is a copy now.
        POSTGRES.sql(f'ALTER DATABASE {self.database} SET default_transaction_read_only = on')
        POSTGRES.sql('SELECT pg_terminate_backend(pid) FROM pg_stat_activity'
                     f" WHERE datname = '{self.database}'")
        body = b'{"model":"spot.obj","options":{"resolution":31,"format":"xyz"}}'

        def create():
            return server.curl('/v1/jobs', '-H', 'Content-Type: application/json', body=body)
        refused = wait_until(lambda: (answer := create()).status != 202 and answer, 'a refusal')
        self.assertEqual(refused.status, 503, refused.body)
        self.assertIn('the database is away', refused.json()['detail'])
        self.assertIn('retry-after', refused.headers)
        # Connections that are there keep to the old setting.
        POSTGRES.sql(f'ALTER DATABASE {self.database} RESET default_transaction_read_only')
        taken = wait_until(lambda: (answer := create()).status == 202 and answer, 'a change to be taken')
        self.assertEqual(self.ended(server, taken.json()['id'])['state'], 'succeeded')

    def test_a_process_that_idles_in_a_transaction_holds_nobody_up(self):
        server = self.serve('--jobs', '1')
        self.ended(server, self.post(server, 30))
        with HeldBack(self.database, "SET idle_in_transaction_session_timeout = '8s';"):
            id = self.post(server, 31)  # Waits until the database has ended that session.
            self.assertEqual(self.ended(server, id)['state'], 'succeeded')

    def test_only_the_databases_clock_counts(self):
        clock = pathlib.Path(harness.strata()).parent.parent / 'tests/support/libskewed_clock.so'
        self.assertTrue(clock.exists(), clock)
        month = 30 * 86400
        self.lease = 8  # Long for a machine that is busy, and renewed every two seconds.
        server = self.serve('--jobs', '1')
        finished = self.post(server, 30)
        self.ended(server, finished)
        created = server.curl('/v1/uploads', '-X', 'POST', '-H', 'Tus-Resumable: 1.0.0', '-H', 'Upload-Length: 4',
                              '-H', 'Upload-Metadata: name bW9kZWwub2Zm')
        self.assertEqual(created.status, 201, created.body)
        upload = created.headers['location']
        workers = [self.worker('--jobs', '1', environment={
            'LD_PRELOAD': str(clock), 'STRATA_TEST_SKEW': str(skew)}) for skew in (month, -month)]
        jobs = [self.post(server, 40, seed=seed) for seed in range(12)]
        owns = ["SELECT lease_until FROM strata.processes WHERE name LIKE"
                f" '%:{worker.process.pid}'" for worker in workers]
        # With each renewal goes what time brings: what is old is removed, what was lost is queued again.
        for _ in range(3):
            former = [self.sql(own) for own in owns]
            self.assertEqual([len(each) for each in former], [1, 1])
            for own, first in zip(owns, former):
                wait_until(lambda: self.sql(own) not in ([], first), 'the lease to be renewed')
        for id in jobs:
            job = self.ended(server, id)
            self.assertEqual(job['state'], 'succeeded')
            self.assertEqual([entry['why'] for entry in job['history']], ['succeeded'], 'no lease ran out')
        self.assertEqual(self.job(server, finished)['state'], 'succeeded', 'what is new is not removed as old')
        path = upload[upload.index('/v1/'):]
        self.assertEqual(server.curl(path, '-I', '-H', 'Tus-Resumable: 1.0.0').status, 200)

    def test_a_job_that_kills_its_processes_has_failed_with_its_history(self):
        server = self.serve('--jobs', '1', '--max-attempts', '2')
        id = self.post(server, 40)
        self.ended(server, id)
        # As two processes that died would leave it.
        self.sql(f"UPDATE strata.jobs SET state = 1, attempts = 2, finished = NULL, result_blob = NULL,"
                 f" lease_until = 1, owner = 'gone:2' WHERE id = '{id}';"
                 f"UPDATE strata.attempts SET owner = 'gone:1', why = 'its lease ran out' WHERE attempt = 1;"
                 f"INSERT INTO strata.attempts SELECT job, 2, 'gone:2', started + 1, NULL, ''"
                 f" FROM strata.attempts WHERE attempt = 1")
        job = self.ended(server, id)
        self.assertEqual(job['state'], 'failed')
        self.assertIn('begun 2 times', job['error']['detail'])
        self.assertEqual([(entry['owner'], entry['why']) for entry in job['history']],
                         [('gone:1', 'its lease ran out'), ('gone:2', 'its lease ran out')])

    def test_sigterm_lets_a_worker_finish_or_give_back(self):
        server = self.serve('--jobs', '1', '--isolate', 'off')
        worker = self.worker('--jobs', '1', '--drain-timeout', '60')
        ids = [self.post(server, 150, seed=seed) for seed in range(100, 106)]
        ids.append(self.job_at(worker, server, 300)[0])
        self.assertEqual(worker.stop(), 0)
        hasty = self.worker('--jobs', '1', '--drain-timeout', '0')
        self.assertEqual(hasty.stop(), 0)
        for id in ids:
            self.assertEqual(self.ended(server, id)['state'], 'succeeded')
        wait_until(lambda: self.sql('SELECT count(*) FROM strata.processes') == [['1']],
                   'the server to be the only process')


class RefusalsTest(NodesCase):
    def run_serve(self, *options, environment=None):
        return subprocess.run([harness.strata(), 'serve', '--http', '127.0.0.1:0', '--grpc', 'off',
                               *options], capture_output=True, text=True, cwd=self.folder.name,
                              timeout=60, env={**os.environ, **(environment or {})})

    def test_an_older_binary_refuses_a_newer_store(self):
        self.serve('--jobs', '1').stop()
        self.sql('UPDATE strata.meta SET version = 1000')
        done = self.run_serve(*self.options())
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assertIn('version 1000 found', done.stderr)

    def test_a_folder_of_another_store_is_refused(self):
        self.serve('--jobs', '1').stop()
        done = self.run_serve('--data', str(self.data))
        self.assertEqual(done.returncode, 9, done.stderr)
        elsewhere = self.data.parent / 'elsewhere'
        done = self.run_serve('--data', str(elsewhere), '--database', POSTGRES.url(self.database))
        self.assertEqual(done.returncode, 9, done.stderr)
        self.assertIn('store-id', done.stderr)

    def test_two_processes_that_start_at_once_migrate_once(self):
        started, errors = [], []

        def start():
            try:
                started.append(self.serve('--jobs', '1'))
            except AssertionError as error:
                errors.append(error)
        threads = [threading.Thread(target=start) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(errors, [])
        wait_until(lambda: self.sql('SELECT count(*) FROM strata.processes') == [['3']],
                   'three processes')

    def test_no_message_tells_the_password(self):
        wrong = 'very%40secret'
        address = f'postgresql://strata:{wrong}@127.0.0.1:{POSTGRES.port}/postgres'
        for options in (['--database', address], ['--databse', address],
                        ['--database', address + '?nonsense=1']):
            done = self.run_serve('--data', str(self.data), *options)
            self.assertNotEqual(done.returncode, 0)
            for secret in (wrong, 'very@secret'):
                self.assertNotIn(secret, done.stderr + done.stdout)


class BackupTest(NodesCase):
    def test_a_dump_and_the_folder_are_the_whole_store(self):
        server = self.serve('--jobs', '1')
        id = self.post(server, 50)
        self.ended(server, id)
        put = server.curl('/v1/models/cube.obj', '-X', 'PUT', body=CUBE)
        self.assertEqual(put.status, 201)
        dump = subprocess.run(['pg_dump', '-n', 'strata', POSTGRES.url(self.database)],
                              check=True, capture_output=True).stdout
        copy = self.data.parent / 'copy'
        subprocess.run(['cp', '-a', self.data, copy], check=True)
        server.stop()
        restored = self.database + 'r'
        POSTGRES.sql(f'CREATE DATABASE {restored}')
        subprocess.run(['psql', '-q', '-X', '-v', 'ON_ERROR_STOP=1', POSTGRES.url(restored)],
                       input=dump, check=True, capture_output=True)
        self.data = copy
        again = self.serve('--jobs', '1', url=POSTGRES.url(restored))
        self.assertCommandsBytes(again, id, 50)
        self.assertEqual(again.curl('/v1/models/cube.obj').json()['sha256'],
                         hashlib.sha256(CUBE).hexdigest())


    def test_a_copy_of_sqlite_and_the_folder_are_the_whole_store(self):
        copy = self.data.parent / 'copy'
        server = Server('--data', str(self.data), '--models', str(spot().parent))
        self.nodes.append(server)
        id = self.post(server, 50)
        self.ended(server, id)
        copy.mkdir(mode=0o700)
        with sqlite3.connect(self.data / 'strata.db') as database:
            database.execute(f"VACUUM INTO '{copy / 'strata.db'}'")
        later = self.post(server, 51)  # Not in the copy: a leftover there.
        self.ended(server, later)
        subprocess.run(['cp', '-a', self.data / 'blobs', self.data / 'uploads', copy], check=True)
        again = Server('--data', str(copy), '--models', str(spot().parent))
        self.nodes.append(again)
        self.assertCommandsBytes(again, id, 50)
        self.assertEqual(again.curl(f'/v1/jobs/{later}').status, 404)
        files = [path for path in (copy / 'blobs').rglob('*') if path.is_file()]
        self.assertEqual(len(files), 1)


def main():
    global POSTGRES
    cluster.skip_without_postgres()
    POSTGRES = cluster.Cluster()
    try:
        harness.main()
    finally:
        POSTGRES.stop()


if __name__ == '__main__':
    main()
