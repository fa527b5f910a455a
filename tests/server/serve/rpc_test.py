#!/usr/bin/env python3
"""gRPC as Python's grpcio speaks it, from stubs made of the same proto files."""
import pathlib
import subprocess
import sys
import tempfile
import threading

import grpc

import harness
from harness import (CUBE, ServerCase, sample_by_command, spot, tiles_by_command, tiles_in_zip,
                     writes_vdb)

STUBS = tempfile.TemporaryDirectory()
CHUNK = 1 << 20


def make_stubs():
    """Generates Python modules from proto/ and puts them on the path."""
    proto = pathlib.Path(harness.ARGUMENTS['source']) / 'proto'
    files = [str(p.relative_to(proto)) for p in sorted(proto.glob('strata/v1/*.proto'))]
    files.append('grpc/health/v1/health.proto')
    # Their folder "grpc" would hide the library: the health stubs are moved aside.
    subprocess.run([harness.ARGUMENTS['protoc'], f'-I{proto}', f'--python_out={STUBS.name}',
                    f'--plugin=protoc-gen-grpc={harness.ARGUMENTS["grpc_python_plugin"]}',
                    f'--grpc_out={STUBS.name}', *files], check=True, cwd=proto)
    (pathlib.Path(STUBS.name) / 'grpc').rename(pathlib.Path(STUBS.name) / 'healthstubs')
    sys.path[:0] = [STUBS.name, str(pathlib.Path(STUBS.name) / 'healthstubs' / 'health' / 'v1')]


def stub_modules():
    from strata.v1 import errors_pb2, options_pb2, sampling_pb2, sampling_pb2_grpc
    return errors_pb2, options_pb2, sampling_pb2, sampling_pb2_grpc


class RpcCase(ServerCase):

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.errors, cls.options_, cls.sampling, cls.stubs = stub_modules()
        cls.channel = grpc.insecure_channel(f'127.0.0.1:{cls.server.grpc_port}')
        cls.client = cls.stubs.SamplingStub(cls.channel)

    @classmethod
    def tearDownClass(cls):
        cls.channel.close()
        super().tearDownClass()

    def requests(self, mesh, chunk=CHUNK, **options):
        yield self.sampling.SampleRequest(header=self.sampling.SampleHeader(
            options=self.options_.SampleOptions(**options)))
        for begin in range(0, len(mesh), chunk):
            yield self.sampling.SampleRequest(chunk=mesh[begin:begin + chunk])

    def sample(self, requests, **call):
        """(bytes, summary, the order of the kinds of parts)."""
        body, summary, kinds = b'', None, []
        for response in self.client.Sample(requests, timeout=harness.PATIENCE, **call):
            kind = response.WhichOneof('part')
            if not kinds or kinds[-1] != kind:
                kinds.append(kind)
            if kind == 'chunk':
                self.assertLessEqual(len(response.chunk), CHUNK)
                body += response.chunk
            elif kind == 'summary':
                summary = response.summary
        return body, summary, kinds

    def refusal(self, requests, **call):
        """(status code, strata.v1.Problem of the details)."""
        with self.assertRaises(grpc.RpcError) as caught:
            self.sample(requests, **call)
        details = dict(caught.exception.trailing_metadata()).get('grpc-status-details-bin', b'')
        status = self.errors.ErrorStatus.FromString(details)
        self.assertEqual(status.code, caught.exception.code().value[0])
        problem = self.errors.Problem()
        self.assertTrue(status.details[0].Unpack(problem))
        return caught.exception.code(), problem


class Sampling(RpcCase):

    def test_grpc_http_and_command_give_the_same_bytes(self):
        mesh = spot().read_bytes()
        for name in ('drc', 'ply', 'xyz', 'npz', 'csv', 'glb', *(['vdb'] if writes_vdb() else [])):
            body, summary, kinds = self.sample(
                self.requests(mesh, resolution=40, format=name, seed=7, min_distance=0.7))
            http = self.server.curl(f'/v1/samples?resolution=40&format={name}&seed=7'
                                    '&min-distance=0.7', body=mesh)
            command = sample_by_command(spot(), name, '--resolution', '40', '--seed', '7',
                                        '--min-distance', '0.7')
            self.assertTrue(body == command, name)
            self.assertTrue(http.body == command, name)
            self.assertEqual(summary.size_bytes, len(command))
            self.assertEqual(summary.media_type, http.headers['content-type'])
            self.assertEqual(kinds, ['progress', 'chunk', 'summary'])

    def test_uniform_samples_and_tiles_are_those_of_the_command(self):
        mesh = spot().read_bytes()
        body, summary, _ = self.sample(
            self.requests(mesh, method='uniform', count=2500, format='npz'))
        self.assertTrue(body == sample_by_command(spot(), 'npz', '--method', 'uniform',
                                                  '--count', '2500'))
        self.assertEqual((summary.samples, summary.cells), (2500, 0))
        body, summary, _ = self.sample(self.requests(mesh, resolution=40, tile_samples=500))
        expected = tiles_by_command(spot(), '--resolution', '40', '--tile-samples', '500')
        self.assertTrue(tiles_in_zip(body) == expected)
        self.assertEqual((summary.media_type, summary.size_bytes), ('application/zip', len(body)))

    def test_chunks_of_any_size_give_the_same_bytes(self):
        expected = self.sample(self.requests(CUBE, resolution=9, format='ply'))[0]
        for size in (1, 7, len(CUBE)):
            self.assertEqual(self.sample(self.requests(CUBE, size, resolution=9, format='ply'))[0],
                             expected, size)

    def test_a_large_result_comes_in_chunks(self):
        body, summary, _ = self.sample(self.requests(CUBE, resolution=300, format='xyz'))
        self.assertGreater(len(body), CHUNK)
        self.assertEqual(summary.size_bytes, len(body))


class Refusals(RpcCase):

    def test_a_bad_mesh_carries_the_problem_of_http(self):
        code, problem = self.refusal(self.requests(b'ply\nformat ascii 1.0\nelement vertex x\n'))
        http = self.server.curl('/v1/samples', body=b'ply\nformat ascii 1.0\nelement vertex x\n')
        self.assertEqual(code, grpc.StatusCode.DATA_LOSS)
        self.assertEqual(problem.type, '/problems/corrupt-input')
        self.assertEqual(problem.detail, http.json()['detail'])
        self.assertEqual(problem.status, http.status)

    def test_an_option_out_of_range_is_named(self):
        code, problem = self.refusal(self.requests(CUBE, min_distance=9))
        self.assertEqual(code, grpc.StatusCode.INVALID_ARGUMENT)
        self.assertIn("min_distance: found '9', expected", problem.detail)
        for options in ({'lambda': float('nan')}, {'voxel_size': -1}, {'resolution': 0},
                        {'integrator': 'magic'}, {'threads': 5000}, {'memory': 1}):
            code, _ = self.refusal(self.requests(CUBE, **options))
            self.assertEqual(code, grpc.StatusCode.INVALID_ARGUMENT, options)

    def test_parts_out_of_order_are_refused(self):
        header = next(self.requests(b''))
        chunk = self.sampling.SampleRequest(chunk=CUBE)
        for parts, words in [([], 'empty'), ([chunk], 'expected a header first'),
                             ([header], 'no chunk came'), ([header, chunk, header], 'second'),
                             ([header, self.sampling.SampleRequest(chunk=b'')], '0 bytes'),
                             ([self.sampling.SampleRequest()], 'expected a header first'),
                             ([header, self.sampling.SampleRequest(chunk=b'x' * (CHUNK + 1))],
                              '1048577 bytes')]:
            code, problem = self.refusal(iter(parts))
            self.assertEqual(code, grpc.StatusCode.INVALID_ARGUMENT, words)
            self.assertIn(words, problem.detail)

    def test_a_message_beyond_the_limit_is_refused(self):
        header = next(self.requests(b''))
        with self.assertRaises(grpc.RpcError) as caught:
            self.sample(iter([header, self.sampling.SampleRequest(chunk=b'x' * (2 * CHUNK))]))
        self.assertEqual(caught.exception.code(), grpc.StatusCode.RESOURCE_EXHAUSTED)

    def test_a_cancelled_call_ends_its_job(self):
        call = self.client.Sample(self.requests(CUBE, resolution=3000, format='xyz'))
        for response in call:
            if response.progress.stage > self.options_.Progress.queue:
                break
        harness.wait_until(self.server.children, 'a child to run')
        call.cancel()
        harness.wait_until(lambda: not self.server.children(), 'the child to end')


class Stored(RpcCase):
    """Models and jobs, as HTTP's tests have them: here that gRPC says the same."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.options = ('--data', f'{cls.folder.name}/data')
        super().setUpClass()
        from strata.v1 import jobs_pb2, jobs_pb2_grpc, models_pb2, models_pb2_grpc
        cls.m, cls.j = models_pb2, jobs_pb2
        cls.models = models_pb2_grpc.ModelsStub(cls.channel)
        cls.jobs = jobs_pb2_grpc.JobsStub(cls.channel)
        cls.put('cube.obj', CUBE)

    @classmethod
    def tearDownClass(cls):
        super().tearDownClass()
        cls.folder.cleanup()

    @classmethod
    def put(cls, name, mesh, **header):
        return cls.models.Put(iter(
            [cls.m.PutModelRequest(header=cls.m.PutModelHeader(name=name, **header)),
             cls.m.PutModelRequest(chunk=mesh)]), timeout=harness.PATIENCE)

    def code(self, call, request):
        with self.assertRaises(grpc.RpcError) as caught:
            list(answer) if hasattr(answer := call(request), '__iter__') else answer
        return caught.exception.code()

    def test_models_are_the_same_in_both_protocols(self):
        put = self.put('a/b.obj', CUBE)
        http = self.server.curl('/v1/models/a/b.obj').json()
        self.assertEqual((put.sha256, put.format), (http['sha256'], http['format']))
        listed = self.models.List(self.m.ListModelsRequest(prefix='a/'))
        self.assertEqual([model.name for model in listed.models], ['a/b.obj'])
        chunks = self.models.Download(self.m.DownloadModelRequest(name='a/b.obj'))
        self.assertEqual(b''.join(chunk.data for chunk in chunks), CUBE)
        self.models.Delete(self.m.DeleteModelRequest(name='a/b.obj'))
        self.assertEqual(self.code(self.models.Get, self.m.GetModelRequest(name='a/b.obj')),
                         grpc.StatusCode.NOT_FOUND)
        with self.assertRaises(grpc.RpcError) as caught:
            self.put('cube.obj', CUBE, if_absent=True)
        self.assertEqual(caught.exception.code(), grpc.StatusCode.FAILED_PRECONDITION)
        with self.assertRaises(grpc.RpcError) as caught:
            self.put('empty.obj', b'')
        self.assertEqual(caught.exception.code(), grpc.StatusCode.INVALID_ARGUMENT)

    def test_times_beyond_the_calendar_are_refused(self):
        for far in ({'seconds': 1 << 62}, {'seconds': -(1 << 62)}, {'nanos': -1},
                    {'seconds': 5, 'nanos': 2_000_000_000}):
            for name in ('created_after', 'created_before'):
                with self.subTest(far=far, name=name):
                    self.assertEqual(
                        self.code(self.jobs.List, self.j.ListJobsRequest(**{name: far})),
                        grpc.StatusCode.INVALID_ARGUMENT)
        for far in ({'seconds': 1 << 61}, {'seconds': -(1 << 61)}, {'seconds': 3601}):
            with self.subTest(far=far):
                self.assertEqual(
                    self.code(self.jobs.Wait, self.j.WaitJobRequest(id='x', timeout=far)),
                    grpc.StatusCode.INVALID_ARGUMENT)

    def test_a_job_ends_with_the_bytes_of_a_direct_call(self):
        options = self.options_.SampleOptions(resolution=44, format='ply')
        job = self.jobs.Create(self.j.CreateJobRequest(model='cube.obj', options=options))
        events = list(self.jobs.Watch(self.j.WatchJobRequest(id=job.id)))
        self.assertEqual(events[-1].job.state, self.j.Job.succeeded)
        done = self.jobs.Wait(self.j.WaitJobRequest(id=job.id))
        self.assertEqual(done.state, self.j.Job.succeeded)
        chunks = self.jobs.Download(self.j.DownloadResultRequest(id=job.id, offset=3))
        direct = self.sample(self.requests(CUBE, resolution=44, format='ply'))[0]
        self.assertEqual(b''.join(chunk.data for chunk in chunks), direct[3:])
        header = self.sampling.SampleRequest(header=self.sampling.SampleHeader(
            options=options, model='cube.obj'))
        body, summary, _ = self.sample(iter([header]))
        self.assertEqual((body, summary.cached, summary.etag), (direct, True, done.summary.etag))

    def test_what_does_not_exist_is_not_found(self):
        for call, request in [(self.jobs.Get, self.j.GetJobRequest(id='x')),
                              (self.jobs.Cancel, self.j.CancelJobRequest(id='x')),
                              (self.jobs.Wait, self.j.WaitJobRequest(id='x')),
                              (self.jobs.Watch, self.j.WatchJobRequest(id='x')),
                              (self.jobs.Download, self.j.DownloadResultRequest(id='x')),
                              (self.models.Download, self.m.DownloadModelRequest(name='x'))]:
            self.assertEqual(self.code(call, request), grpc.StatusCode.NOT_FOUND)


class Standard(RpcCase):

    def test_health_is_served(self):
        import health_pb2
        check = self.channel.unary_unary(
            '/grpc.health.v1.Health/Check',
            request_serializer=health_pb2.HealthCheckRequest.SerializeToString,
            response_deserializer=health_pb2.HealthCheckResponse.FromString)
        for service in ('', 'strata.v1.Sampling'):
            self.assertEqual(check(health_pb2.HealthCheckRequest(service=service)).status,
                             health_pb2.HealthCheckResponse.SERVING)

    def test_reflection_lists_the_services(self):
        call = self.channel.stream_stream(
            '/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo',
            request_serializer=lambda raw: raw, response_deserializer=lambda raw: raw)
        # ServerReflectionRequest{list_services: "*"}: field 7, a string.
        answer = b''.join(call(iter([b'\x3a\x01*']), timeout=harness.PATIENCE))
        for name in (b'strata.v1.Sampling', b'grpc.health.v1.Health'):
            self.assertIn(name, answer)

    def test_a_request_id_comes_back(self):
        call = self.client.Sample(self.requests(CUBE, resolution=3),
                                  metadata=[('x-request-id', 'rpc-1')])
        self.assertEqual(dict(call.initial_metadata())['x-request-id'], 'rpc-1')
        list(call)
        line = self.server.request_line('rpc-1')
        self.assertEqual((line['protocol'], line['status']), ('grpc', 0))
        self.assertEqual(line['bytes_in'], len(CUBE))

    def test_many_calls_at_once_all_succeed(self):
        expected = self.sample(self.requests(CUBE, resolution=20, format='ply'))[0]
        bodies = []

        def one():
            bodies.append(self.sample(self.requests(CUBE, resolution=20, format='ply'))[0])
        threads = [threading.Thread(target=one) for _ in range(24)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(bodies, [expected] * 24)


def load_tests(loader, tests, pattern):
    make_stubs()
    return tests


if __name__ == '__main__':
    harness.skip_without_grpc()
    harness.main()
