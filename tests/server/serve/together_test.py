#!/usr/bin/env python3
"""Many clients at once, at every endpoint of both protocols: each is answered as if it were alone. Requests that come one
after another are put in order by the acceptor's lock, so what ThreadSanitizer can see, it sees here."""
import concurrent.futures
import http.client
import json
import os
import pathlib
import random
import signal
import socket
import threading
import unittest

import grpc

import harness
import rpc_test
from harness import CUBE, Server, sample_by_command, spot

ROUNDS = 4  # Of each client.
EACH = 2  # Clients that do the same.
RESOLUTIONS = (6, 9, 12, 150)  # The last takes long enough for its progress to be told.
BODIES = [CUBE + b'# %d\n' % number * 2000 for number in range(3)]
JSON = {'Content-Type': 'application/json'}
TUS = {'Tus-Resumable': '1.0.0'}
PIECE = {**TUS, 'Content-Type': 'application/offset+octet-stream'}


class Client:
    """One connection that stays open, and what is asked over it. An answer of a status that is not
    expected is an AssertionError; while the service drains it may also turn the client away."""

    draining = False  # Of all clients.

    def __init__(self, server, seed, expected):
        self.port, self.draw, self.expected = server.http_port, random.Random(seed), expected
        self.connection = http.client.HTTPConnection('127.0.0.1', self.port,
                                                     timeout=harness.PATIENCE)
        # Of its own: channels to one address share a connection otherwise.
        self.channel = grpc.insecure_channel(f'127.0.0.1:{server.grpc_port}',
                                             [('grpc.use_local_subchannel_pool', 1)])

    def close(self):
        self.connection.close()
        self.channel.close()

    def ask(self, method, path, *statuses, body=None, headers=None):
        self.connection.request(method, path, body, headers or {})
        answer = self.connection.getresponse()
        content = answer.read()
        if answer.status == 503 and Client.draining:
            raise ConnectionError('turned away')
        assert answer.status in statuses, (method, path, answer.status, content[:300])
        return answer, content

    def assert_samples(self, content, resolution):
        assert content == self.expected[resolution], f'other bytes at resolution {resolution}'

    @staticmethod
    def assert_ended(state, expected, shown):
        """Whoever waits for an end is let go without one when the service ends."""
        if state in ('queued', 'running') and Client.draining:
            raise ConnectionError('let go')
        assert state in expected, shown

    # --- What one client does, again and again ---

    def samples(self):
        resolution = self.draw.choice(RESOLUTIONS)
        options = f'resolution={resolution}&format=xyz'
        _, content = self.ask('POST', f'/v1/samples?{options}', 200, body=spot().read_bytes())
        self.assert_samples(content, resolution)
        _, content = self.ask('GET', f'/v1/samples?model=spot.obj&{options}', 200)
        self.assert_samples(content, resolution)

    def models(self):
        name = f'/v1/models/shared-{self.draw.randrange(2)}.obj'
        self.ask('PUT', name, 200, 201, body=self.draw.choice(BODIES))
        answer, content = self.ask('GET', f'{name}?content', 200, 404)
        assert answer.status == 404 or content in BODIES, 'a mixture of models'
        self.ask('GET', name, 200, 404)
        if self.draw.randrange(2):
            self.ask('DELETE', name, 204, 404)

    def uploads(self):
        body = self.draw.choice(BODIES)
        answer, _ = self.ask('POST', '/v1/uploads', 201, headers={
            **TUS, 'Upload-Length': str(len(body)), 'Upload-Metadata': 'name dHVz'})
        where, half = answer.getheader('Location'), len(body) // 2
        self.ask('PATCH', where, 204, body=body[:half], headers={**PIECE, 'Upload-Offset': '0'})
        answer, _ = self.ask('HEAD', where, 200, headers=TUS)
        assert answer.getheader('Upload-Offset') == str(half)
        if self.draw.randrange(3) == 0:
            self.ask('DELETE', where, 204, headers=TUS)
            return
        self.ask('PATCH', where, 204, body=body[half:],
                 headers={**PIECE, 'Upload-Offset': str(half)})
        answer, content = self.ask('GET', '/v1/models/tus?content', 200)
        assert content in BODIES, 'a mixture of uploads'

    def jobs(self):
        resolution = self.draw.choice(RESOLUTIONS)
        _, made = self.ask('POST', '/v1/jobs', 202, headers=JSON, body=json.dumps(
            {'model': 'spot.obj', 'options': {'resolution': resolution, 'format': 'xyz'}}))
        where = f'/v1/jobs/{json.loads(made)["id"]}'
        cancel = self.draw.randrange(3) == 0
        if cancel:
            self.ask('DELETE', where, 200, 202, 204)
        elif self.draw.randrange(2):
            _, events = self.ask('GET', f'{where}/events', 200)
            assert b'data: ' in events or Client.draining
        _, job = self.ask('GET', f'{where}?wait=60', 200)
        state = json.loads(job)['state']
        self.assert_ended(state, ('cancelled', 'succeeded') if cancel else ('succeeded',), job)
        if state == 'succeeded':
            self.assert_samples(self.ask('GET', f'{where}/result', 200)[1], resolution)

    def batches(self):
        _, made = self.ask('POST', '/v1/batches', 202, headers=JSON, body=json.dumps(
            {'options': {'resolution': self.draw.choice(RESOLUTIONS)}}))
        where = f'/v1/batches/{json.loads(made)["id"]}'
        cancel = self.draw.randrange(3) == 0
        if cancel:
            self.ask('DELETE', where, 200, 202, 204)
        self.ask('GET', f'{where}/events', 200)
        _, batch = self.ask('GET', where, 200)
        state = json.loads(batch)['state']
        self.assert_ended(state, ('cancelled', 'succeeded') if cancel else ('succeeded',), batch)
        if state == 'succeeded':
            _, manifest = self.ask('GET', f'{where}/manifest', 200)
            for line in map(json.loads, manifest.splitlines()):
                self.ask('GET', f'{where}/output?path={line["output"]}', 200)

    def looks(self):
        for path in ('/livez', '/readyz', '/metrics', '/openapi.json', '/', '/v1/models',
                     '/v1/jobs', '/v1/jobs?state=running', '/v1/batches'):
            self.ask('GET', path, 200)
        self.ask('GET', '/nowhere', 404)

    def calls(self):
        """A model, a direct call and a job over gRPC."""
        from strata.v1 import jobs_pb2, jobs_pb2_grpc, models_pb2, models_pb2_grpc
        _, options, sampling, sampling_grpc = rpc_test.stub_modules()
        patience, resolution = {'timeout': harness.PATIENCE}, self.draw.choice(RESOLUTIONS)
        wanted = options.SampleOptions(resolution=resolution, format='xyz')
        models = models_pb2_grpc.ModelsStub(self.channel)
        body = self.draw.choice(BODIES)
        put = models.Put(iter([
            models_pb2.PutModelRequest(header=models_pb2.PutModelHeader(name='by-grpc.obj')),
            models_pb2.PutModelRequest(chunk=body)]), **patience)
        assert put.size_bytes == len(body), put
        parts = models.Download(models_pb2.DownloadModelRequest(name='by-grpc.obj'), **patience)
        assert b''.join(part.data for part in parts) in BODIES, 'a mixture of models'
        header = sampling.SampleHeader(options=wanted, model='spot.obj')
        parts = sampling_grpc.SamplingStub(self.channel).Sample(
            iter([sampling.SampleRequest(header=header)]), **patience)
        self.assert_samples(b''.join(part.chunk for part in parts), resolution)
        jobs = jobs_pb2_grpc.JobsStub(self.channel)
        job = jobs.Create(jobs_pb2.CreateJobRequest(model='spot.obj', options=wanted), **patience)
        events = list(jobs.Watch(jobs_pb2.WatchJobRequest(id=job.id), **patience))
        last = jobs_pb2.Job.State.Name(events[-1].job.state) if events else 'queued'
        self.assert_ended(last, ('succeeded',), events)
        parts = jobs.Download(jobs_pb2.DownloadResultRequest(id=job.id), **patience)
        self.assert_samples(b''.join(part.data for part in parts), resolution)

    def leaves(self):
        """Goes in the middle of a request, or of the job that it began."""
        whole = harness.long_request()
        cut = self.draw.choice((len(whole), self.draw.randrange(1, len(whole))))
        with socket.create_connection(('127.0.0.1', self.port), harness.PATIENCE) as connection:
            connection.sendall(whole[:cut])
            if cut == len(whole):
                while self.draw.randrange(4):
                    self.ask('GET', '/metrics', 200)


ACTS = (Client.samples, Client.models, Client.uploads, Client.jobs, Client.batches, Client.looks,
        Client.leaves, *([Client.calls] if harness.GRPC else []))


class Together(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.seed = int(os.environ.get('STRATA_SEED') or random.randrange(1 << 32))
        print('seed', cls.seed)
        cls.expected = {resolution: sample_by_command(spot(), 'xyz', '--resolution', str(resolution))
                        for resolution in RESOLUTIONS}

    def setUp(self):
        self.at = harness.folder_with_models(self)
        Client.draining = False

    def serve(self, *options):
        server = Server('--data', str(self.at / 'data'), '--models', str(self.at / 'models'),
                        '--jobs', '3', '--requests', '1000', *options)
        self.addCleanup(server.stop)
        return server

    def run_clients(self, server, rounds, begun=None):
        """What the clients found wrong."""
        def run(number):
            client = Client(server, self.seed + number, self.expected)
            try:
                for _ in range(rounds):
                    ACTS[number % len(ACTS)](client)
                    if begun:
                        begun.release()
            except (OSError, http.client.HTTPException, grpc.RpcError):
                if not Client.draining:
                    raise
            finally:
                client.close()
        with concurrent.futures.ThreadPoolExecutor(EACH * len(ACTS)) as pool:
            ran = [pool.submit(run, number) for number in range(EACH * len(ACTS))]
        return [error for error in (each.exception() for each in ran) if error]

    def check_answers(self, *options):
        server = self.serve(*options)
        self.assertEqual(self.run_clients(server, ROUNDS), [])
        harness.wait_until(lambda: not server.children(), 'the jobs of those who left to end')
        self.assertEqual(server.stop(), 0)

    def test_each_client_is_answered_as_if_it_were_alone(self):
        self.check_answers()

    def test_each_client_is_answered_as_if_it_were_alone_where_jobs_run_in_the_service(self):
        self.check_answers('--isolate', 'off')

    def test_the_service_ends_well_in_the_middle_of_it_all(self):
        server, begun = self.serve('--drain-timeout', '1'), threading.Semaphore(0)
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            load = pool.submit(self.run_clients, server, 10**6, begun)
            for _ in range(2 * EACH * len(ACTS)):
                self.assertTrue(begun.acquire(timeout=harness.PATIENCE), 'a round')
            Client.draining = True
            server.process.send_signal(signal.SIGTERM)
            self.assertEqual(load.result(), [])
        self.assertEqual(server.stop(), 0)


def load_tests(loader, tests, pattern):
    if harness.GRPC:
        rpc_test.make_stubs()
    return tests


if __name__ == '__main__':
    harness.main()
