#!/usr/bin/env python3
"""Every call times every fault, over gRPC; connections that are no good; and how many there may be."""
import concurrent.futures
import importlib
import os
import random
import socket
import tempfile
import threading
import unittest

import grpc

import harness
import raw_http2
import rpc_test
from harness import CUBE, Server, make_keys, spot
from rpc_test import CHUNK, RpcCase

Code = grpc.StatusCode
SAMPLE = '/strata.v1.Sampling/Sample'
READS = {'Get', 'List', 'Download', 'Wait', 'Watch'}  # What a key that may read is enough for.
GARBAGE = (b'\xff', b'\x0a\xff\xff\xff\xff\x0f', b'\x08', b'\x0a\x05ab', os.urandom(64), b'\x0b' * 50)


def methods():
    """(/service/method, whether a read key is enough) of every method in proto/."""
    found = []
    for name in ('sampling', 'models', 'jobs'):
        module = importlib.import_module(f'strata.v1.{name}_pb2')
        for service in module.DESCRIPTOR.services_by_name.values():
            found += [(f'/{service.full_name}/{method.name}', method.name in READS)
                      for method in service.methods]
    return found


class FaultsCase(RpcCase):
    """What the service holds is looked at before and after; it has these limits of time."""
    limits = ()

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.full, cls.read, keys = make_keys(cls.folder.name)
        cls.options = ('--keys', str(keys), '--data', f'{cls.folder.name}/data', '--models',
                       str(spot().parent), '--header-size', '8K', *cls.limits)
        super().setUpClass()

    @classmethod
    def tearDownClass(cls):
        super().tearDownClass()
        cls.folder.cleanup()

    def setUp(self):
        self.key = [('authorization', f'Bearer {self.full}')]
        self.assertWorks()
        self.before = self.held()

    def tearDown(self):
        self.assertWorks()
        harness.wait_until(lambda: harness.holds_no_more(self.held(), self.before),
                           f'{self.before} to be all that is held')
        for line in list(self.server.log):
            self.assertNotEqual(line.get('event'), 'text', line)

    def held(self):
        """gRPC keeps threads and connections of its own for a while; nothing else may stay."""
        held = self.server.held()
        kinds = held['descriptors'].items()
        return {**held, 'threads': 0, 'descriptors': {k: n for k, n in kinds if k != 'socket'}}

    def assertWorks(self):
        body, _, _ = self.sample(self.requests(CUBE, resolution=3), metadata=self.key)
        self.assertTrue(body)

    def code(self, path, messages, key=None, channel=None, **more):
        """The status of a call with raw messages."""
        call = (channel or self.channel).stream_stream(path)(
            iter(messages), metadata=self.key if key is None else key,
            **{'timeout': harness.PATIENCE, **more})
        try:
            list(call)
        except grpc.RpcError:
            pass
        return call.code()


class Faults(FaultsCase):
    """Every method, with raw messages, by one connection: none that is idle, nor a call on a busy
    machine, is ended here for being slow."""
    limits = ('--grace', '60', '--header-timeout', '60', '--idle-timeout', '3600')

    def test_every_method_asks_for_the_key_that_it_needs(self):
        self.assertGreater(len(methods()), 10)
        for path, read_is_enough in methods():
            for key, expected in ((None, Code.UNAUTHENTICATED), ('x', Code.UNAUTHENTICATED),
                                  (self.full[:-1], Code.UNAUTHENTICATED),
                                  (self.read, None if read_is_enough else Code.PERMISSION_DENIED),
                                  (self.full, None)):
                metadata = [('authorization', f'Bearer {key}')] if key else []
                with self.subTest(path=path, key=(key or '')[:8]):
                    code = self.code(path, [b''], metadata)
                    refused = {Code.UNAUTHENTICATED, Code.PERMISSION_DENIED}
                    if expected:
                        self.assertEqual(code, expected)
                    else:
                        self.assertNotIn(code, refused)

    def test_bytes_that_are_no_message_are_refused_by_every_method(self):
        for path, _ in methods():
            for message in GARBAGE:
                with self.subTest(path=path, message=message[:8]):
                    self.assertIn(self.code(path, [message]),
                                  (Code.INVALID_ARGUMENT, Code.INTERNAL, Code.UNIMPLEMENTED))

    def test_bytes_that_are_no_message_in_a_stream_do_not_end_the_mesh_early(self):
        sample = [request.SerializeToString() for request in self.requests(CUBE, resolution=3)]
        from strata.v1 import models_pb2 as models
        put = [models.PutModelRequest(header=models.PutModelHeader(name='half.obj')),
               models.PutModelRequest(chunk=CUBE)]
        put = [request.SerializeToString() for request in put]
        for path, messages in ((SAMPLE, sample), ('/strata.v1.Models/Put', put)):
            for message in GARBAGE:
                with self.subTest(path=path, message=message[:8]):
                    self.assertEqual(self.code(path, [*messages, message]), Code.INVALID_ARGUMENT)
        self.assertEqual(self.server.curl('/v1/models/half.obj', '-H',
                                          f'Authorization: Bearer {self.full}').status, 404)

    def test_methods_that_do_not_exist_are_unimplemented(self):
        for path in ('/strata.v1.Sampling/None', '/strata.v1.None/Sample', '/x', '/', '/x/y/z',
                     '/strata.v1.Sampling/' + 'x' * 3000):
            self.assertEqual(self.code(path, [b'']), Code.UNIMPLEMENTED, path)

    def test_parts_out_of_order_and_too_large_are_refused_by_both_streams(self):
        from strata.v1 import models_pb2 as models
        header = models.PutModelRequest(header=models.PutModelHeader(name='x'))
        chunk = models.PutModelRequest(chunk=CUBE)
        large = models.PutModelRequest(chunk=b'x' * (CHUNK + 1))
        huge = models.PutModelRequest(chunk=b'x' * (2 * CHUNK))
        for parts, expected in (([], Code.INVALID_ARGUMENT), ([chunk], Code.INVALID_ARGUMENT),
                                ([header, header], Code.INVALID_ARGUMENT),
                                ([header, chunk, header], Code.INVALID_ARGUMENT),
                                ([header, models.PutModelRequest()], Code.INVALID_ARGUMENT),
                                ([header, large], Code.INVALID_ARGUMENT),
                                ([header, huge], Code.RESOURCE_EXHAUSTED)):
            raw = [part.SerializeToString() for part in parts]
            self.assertEqual(self.code('/strata.v1.Models/Put', raw), expected, parts[:1])
        sample = next(self.requests(b'')).SerializeToString()
        huge = self.sampling.SampleRequest(chunk=b'x' * (2 * CHUNK)).SerializeToString()
        self.assertEqual(self.code(SAMPLE, [sample, huge]), Code.RESOURCE_EXHAUSTED)

    def test_large_metadata_is_refused(self):
        """gRPC 1.51 may close the connection that they came by, even before the answer is read: here
        it has no other call."""
        large = [*self.key, ('x-large', 'x' * 20_000)]
        alone = [('grpc.use_local_subchannel_pool', 1)]
        with grpc.insecure_channel(f'127.0.0.1:{self.server.grpc_port}', alone) as channel:
            self.assertIn(self.code(SAMPLE, [b''], large, channel),
                          (Code.RESOURCE_EXHAUSTED, Code.INTERNAL, Code.UNAVAILABLE))

    def test_a_deadline_ends_the_job(self):
        requests = [request.SerializeToString()
                    for request in self.requests(CUBE, resolution=3000, format='xyz')]
        self.assertEqual(self.code(SAMPLE, requests, timeout=1), Code.DEADLINE_EXCEEDED)
        harness.wait_until(lambda: not self.server.children(), 'the child to end')

    def test_calls_that_are_cancelled_at_any_point_leave_nothing(self):
        seed = random.randrange(1 << 32)
        print('seed', seed)
        draw = random.Random(seed)
        messages = [request.SerializeToString()
                    for request in self.requests(CUBE, 16, resolution=200, format='xyz')]
        for _ in range(40):
            taken = draw.randrange(len(messages) + 1)
            sent = threading.Event()

            def some():
                yield from messages[:taken]
                sent.set()
                if taken < len(messages):
                    cancelled.wait(harness.PATIENCE)
            cancelled = threading.Event()
            call = self.channel.stream_stream(SAMPLE)(some(), metadata=self.key)
            sent.wait(harness.PATIENCE)
            if taken == len(messages) and draw.random() < 0.5:
                next(call)  # In the middle of the answer.
            call.cancel()
            cancelled.set()


class Slow(FaultsCase):
    """Clients and connections that are ended for being slow, idle or no good."""
    limits = ('--min-rate', '1000', '--grace', '2', '--header-timeout', '2', '--idle-timeout', '2')

    def own_channel(self):
        """One whose connection no call has used before, and which may be about to be closed as idle."""
        return grpc.insecure_channel(f'127.0.0.1:{self.server.grpc_port}',
                                     [('grpc.use_local_subchannel_pool', 1)])

    def assertWorks(self):
        """Tried until it works: on a busy machine this client is too slow, too."""
        def works():
            with self.own_channel() as channel:
                call = channel.stream_stream(SAMPLE)(
                    (request.SerializeToString() for request in self.requests(CUBE, resolution=3)),
                    metadata=self.key, timeout=harness.PATIENCE)
                try:
                    return list(call)
                except grpc.RpcError:
                    self.assertIn(call.code(), (Code.DEADLINE_EXCEEDED, Code.UNAVAILABLE))
        harness.wait_until(works, 'a call to be served')

    def test_a_stream_that_sends_nothing_is_ended(self):
        for path in (SAMPLE, '/strata.v1.Models/Put'):
            hold = threading.Event()

            def nothing():
                hold.wait(harness.PATIENCE)
                return
                yield
            with self.own_channel() as channel:
                call = channel.stream_stream(path)(nothing(), metadata=self.key)
                with self.assertRaises(grpc.RpcError):
                    list(call)
                hold.set()
            self.assertIn(call.code(), (Code.DEADLINE_EXCEEDED, Code.CANCELLED))
            harness.wait_until(lambda: [line for line in self.server.events('request')
                                        if line['method'] == path[1:] and line['status'] == 4],
                               'the call to be noted as too slow')

    def test_a_reader_that_does_not_read_is_ended(self):
        with raw_http2.Connection(self.server) as client:
            client.open_call(1, SAMPLE, ('authorization', f'Bearer {self.full}'),
                             ('x-request-id', 'unread'))
            for request in self.requests(CUBE, resolution=300, format='xyz'):
                raw = request.SerializeToString()
                message = b'\0' + len(raw).to_bytes(4, 'big') + raw
                client.send(raw_http2.frame(raw_http2.DATA, 0, 1, message))
            client.send(raw_http2.frame(raw_http2.DATA, raw_http2.END_STREAM, 1))
            self.assertEqual(self.server.request_line('unread')['status'], 4)

    def test_a_byte_a_second_is_too_slow(self):
        """Ended by the call's rate although bytes keep coming: as fast as they are sent here, a
        message never becomes whole."""
        with raw_http2.Connection(self.server) as client:
            client.open_call(1, SAMPLE, ('authorization', f'Bearer {self.full}'),
                             ('x-request-id', 'slow'))
            client.send(raw_http2.frame(raw_http2.DATA, 0, 1, b'\0\0\0\xff\xff'))
            ended = []
            while not ended:
                client.send(raw_http2.frame(raw_http2.DATA, 0, 1, b'x'))
                client.socket.settimeout(0.2)
                try:
                    piece = client.socket.recv(65536)
                    ended = [line for line in self.server.events('request')
                             if line['request_id'] == 'slow'] or ([True] if not piece else [])
                except TimeoutError:
                    pass
                except ConnectionResetError:
                    ended = [True]
            self.assertEqual(self.server.request_line('slow')['status'], 4)

    def test_a_connection_that_says_nothing_or_half_a_hello_is_closed(self):
        for start in (b'', raw_http2.PREFACE[:10], raw_http2.PREFACE):
            with raw_http2.Connection(self.server, hello=False) as client:
                client.send(start)
                client.await_end()  # Else it would take the client's patience.

    def test_a_connection_that_begins_a_call_and_stops_is_closed(self):
        with raw_http2.Connection(self.server) as client:
            whole = raw_http2.frame(raw_http2.HEADERS, raw_http2.END_HEADERS, 1,
                                    raw_http2.call_headers(SAMPLE))
            client.send(whole[:len(whole) // 2])
            client.await_end()

    def test_an_idle_connection_is_closed_with_a_goodbye(self):
        with raw_http2.Connection(self.server) as client:
            self.assertIn(raw_http2.GOAWAY, client.await_end())

    def test_bytes_that_are_no_http2_are_ended(self):
        seed = random.randrange(1 << 32)
        print('seed', seed)
        draw = random.Random(seed)
        starts = [b'GET / HTTP/1.1\r\nHost: localhost\r\n\r\n', b'\x16\x03\x01\x02\x00\x01\x00' + bytes(512),
                  bytes(1000), raw_http2.PREFACE + b'\xff' * 100,
                  raw_http2.PREFACE + raw_http2.frame(raw_http2.SETTINGS) + b'\0\xff\xff\x09' + bytes(1000),
                  raw_http2.PREFACE + raw_http2.frame(raw_http2.SETTINGS) +
                  raw_http2.frame(raw_http2.HEADERS, raw_http2.END_HEADERS, 1, b'\x80\xff\xff\xff\xff\x0f'),
                  raw_http2.PREFACE + raw_http2.frame(raw_http2.SETTINGS) +
                  raw_http2.frame(raw_http2.DATA, 0, 9, b'x')]
        starts += [draw.randbytes(draw.randrange(1, 300)) for _ in range(30)]
        starts += [raw_http2.PREFACE + raw_http2.frame(raw_http2.SETTINGS) +
                   draw.randbytes(draw.randrange(9, 300)) for _ in range(30)]
        with concurrent.futures.ThreadPoolExecutor(len(starts)) as pool:
            def meet(start):
                with raw_http2.Connection(self.server, hello=False) as client:
                    client.send(start)
                    client.await_end()
            list(pool.map(meet, starts))

    def test_clients_that_vanish_leave_nothing(self):
        call = raw_http2.frame(raw_http2.HEADERS, raw_http2.END_HEADERS, 1, raw_http2.call_headers(
            SAMPLE, ('authorization', f'Bearer {self.full}')))
        for request in self.requests(CUBE, resolution=5):
            raw = request.SerializeToString()
            call += raw_http2.frame(raw_http2.DATA, 0, 1, b'\0' + len(raw).to_bytes(4, 'big') + raw)
        for cut in range(1, len(call), 13):
            with raw_http2.Connection(self.server) as client:
                client.send(call[:cut])
                if cut % 2:
                    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b'\1' + b'\0' * 7)


class Connections(unittest.TestCase):

    def serve(self, *options):
        server = Server(*options)
        self.addCleanup(server.stop)
        return server

    def open(self, server, count):
        """Connections that the service has taken."""
        clients = []
        for _ in range(count):
            client = raw_http2.Connection(server)
            self.addCleanup(client.socket.close)
            self.assertEqual(next(client.frames())[0], raw_http2.SETTINGS)
            clients.append(client)
        return clients

    def count(self, server):
        return server.metric('strata_connections{protocol="grpc"}')

    def test_connections_beyond_the_limit_are_turned_away(self):
        server = self.serve('--connections', '3')
        clients = self.open(server, 3)
        self.assertEqual(self.count(server), 3)
        for _ in range(20):
            with raw_http2.Connection(server, hello=False) as refused:
                self.assertEqual(refused.await_end(), [])
        self.assertEqual(self.count(server), 3)
        with grpc.insecure_channel(f'127.0.0.1:{server.grpc_port}') as channel:
            call = channel.stream_stream(SAMPLE)(iter([]), timeout=harness.PATIENCE)
            with self.assertRaises(grpc.RpcError):
                list(call)
            self.assertEqual(call.code(), Code.UNAVAILABLE, call.details())
        clients[0].socket.close()
        harness.wait_until(lambda: self.count(server) == 2, 'a place')
        with grpc.insecure_channel(f'127.0.0.1:{server.grpc_port}') as channel:
            call = channel.stream_stream(SAMPLE)(iter([]), timeout=harness.PATIENCE,
                                                 wait_for_ready=True)
            with self.assertRaises(grpc.RpcError):
                list(call)
            self.assertEqual(call.code(), Code.INVALID_ARGUMENT, 'it is served')
        self.assertEqual(server.curl('/livez').status, 200, 'HTTP has places of its own')

    def test_connections_that_end_in_any_way_give_their_place_back(self):
        server = self.serve('--connections', '8')
        for round_ in range(12):
            clients = self.open(server, 8)
            for i, client in enumerate(clients):
                if i % 3 == 1:
                    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b'\1' + b'\0' * 7)
                if i % 3 == 2:
                    client.socket.shutdown(socket.SHUT_WR)
                    client.await_end()
                client.socket.close()
            harness.wait_until(lambda: self.count(server) == 0, f'round {round_} to end')
        before = server.held()['descriptors'].get('socket', 0)
        self.assertLess(before, 8)

    def test_silent_streams_of_reflection_do_not_keep_the_service_from_others(self):
        server = self.serve('--requests', '8', '--grace', '1')
        path = '/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo'
        clients = self.open(server, 8)
        for client in clients:
            for stream in range(8):
                client.open_call(2 * stream + 1, path)

        def works():
            with grpc.insecure_channel(f'127.0.0.1:{server.grpc_port}') as channel:
                call = channel.stream_stream(SAMPLE)(iter([]), timeout=harness.PATIENCE)
                try:
                    list(call)
                except grpc.RpcError:
                    return call.code() == Code.INVALID_ARGUMENT
        harness.wait_until(works, 'a call to be served')

    def test_calls_beyond_the_limit_are_told_to_come_again(self):
        server = self.serve('--requests', '4', '--grace', '60')
        clients = self.open(server, 2)
        for client in clients:
            for stream in range(2):
                client.open_call(2 * stream + 1, SAMPLE)
        with grpc.insecure_channel(f'127.0.0.1:{server.grpc_port}') as channel:
            def refused():
                call = channel.stream_stream(SAMPLE)(iter([]), timeout=harness.PATIENCE)
                try:
                    list(call)
                except grpc.RpcError:
                    return call.code() == Code.RESOURCE_EXHAUSTED
            harness.wait_until(refused, 'all places to be taken')
        self.assertEqual(server.curl('/readyz').status, 200)

    def test_silent_calls_cost_little_and_no_thread(self):
        server = self.serve('--grace', '60')
        clients = self.open(server, 8)
        before, threads = server.resident_bytes(), server.held()['threads']
        for client in clients:
            for stream in range(100):  # One request, one answer: its message never comes.
                client.open_call(2 * stream + 1, '/strata.v1.Jobs/Get')
        with grpc.insecure_channel(f'127.0.0.1:{server.grpc_port}') as channel:
            call = channel.stream_stream('/strata.v1.Jobs/Get')(iter([b'']), timeout=harness.PATIENCE)
            with self.assertRaises(grpc.RpcError):
                list(call)
            self.assertEqual(call.code(), Code.UNIMPLEMENTED, 'it is served: there is no --data')
        grown = server.resident_bytes() - before
        print(f'{8 * 100} silent calls: {grown / 1024:.0f} KiB, '
              f'{server.held()["threads"] - threads} threads')
        self.assertLess(grown, 64 << 20)
        self.assertLess(server.held()['threads'] - threads, 32)


def load_tests(loader, tests, pattern):
    rpc_test.make_stubs()
    return tests


if __name__ == '__main__':
    harness.skip_without_grpc()
    harness.main()
