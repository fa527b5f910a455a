#!/usr/bin/env python3
"""Clients that break the rules, by accident or on purpose: each gets an answer or is cut off, and the
next one is served."""
import os
import random
import signal
import socket
import threading

import harness
from harness import CUBE, Answer, ServerCase, read_to_end

HOST = b'Host: localhost\r\n'


def post(length, extra=b''):
    return (b'POST /v1/samples?resolution=5 HTTP/1.1\r\n' + HOST + extra +
            b'Content-Length: %d\r\n\r\n' % length)


class Hostile(ServerCase):
    options = ('--body-size', '1M', '--header-size', '4K', '--header-fields', '20')

    def tearDown(self):
        self.assertEqual(self.server.curl('/livez').status, 200, 'the service goes on')
        self.assertEqual(self.server.curl('/v1/samples?resolution=3', body=CUBE).status, 200)

    def assertRefused(self, raw, status, kind, **how):
        return self.assertProblem(Answer.parse(self.server.exchange(raw, **how)), status, kind)

    def test_broken_headers_are_refused(self):
        for raw in (b'\r\n\r\n\r\n', b'nonsense\r\n\r\n', b'GET\r\n\r\n',
                    b'GET /livez HTTP/9.9\r\n\r\n', b'GET /livez HTTP/1.1\r\nbad header\r\n\r\n',
                    b'GET /livez HTTP/1.1\r\nA\x00: b\r\n\r\n', b'\x16\x03\x01\x02\x00\x01\x00',
                    b'PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n',
                    b'POST /v1/samples HTTP/1.1\r\nContent-Length: -1\r\n\r\n',
                    b'POST /v1/samples HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n',
                    b'POST /v1/samples HTTP/1.1\r\nContent-Length: 9' + b'9' * 40 + b'\r\n\r\n',
                    b'POST /v1/samples HTTP/1.1\r\nContent-Length: 4\r\n'
                    b'Transfer-Encoding: chunked\r\n\r\n'):
            with self.subTest(raw=raw[:60]):
                answer = self.server.exchange(raw, close_writing=True)
                self.assertTrue(answer == b'' or answer.startswith(b'HTTP/1.1 4'), answer)

    def test_targets_that_are_no_paths_are_refused(self):
        for target in (b'*', b'livez', b'/%', b'/%zz', b'/%00', b'/livez%0a',
                       b'/%ff', b'/v1/samples?a=%', b'/v1/samples?%00=1'):
            raw = b'GET ' + target + b' HTTP/1.1\r\n' + HOST + b'Connection: close\r\n\r\n'
            self.assertRefused(raw, 400, 'malformed-request')
        self.assertRefused(b'GET http://other/ HTTP/1.1\r\n' + HOST + b'Connection: close\r\n\r\n', 421,
                           'misdirected-request')
        for target in (b'/../../etc/passwd', b'/%2e%2e/etc/passwd', b'//livez', b'/livez/',
                       b'/v1/samples/../../livez'):
            raw = b'GET ' + target + b' HTTP/1.1\r\n' + HOST + b'Connection: close\r\n\r\n'
            self.assertRefused(raw, 404, 'no-such-endpoint')

    def test_large_headers_are_refused(self):
        long_one = b'GET /livez HTTP/1.1\r\nA: ' + b'x' * 5000 + b'\r\n\r\n'
        self.assertRefused(long_one, 431, 'header-too-large')
        many = b'GET /livez HTTP/1.1\r\n' + HOST + b'A: b\r\n' * 21 + b'\r\n'
        self.assertRefused(many, 431, 'header-too-large')
        endless = b'GET /' + b'a' * 100_000
        self.assertRefused(endless, 431, 'header-too-large')

    def test_large_bodies_are_refused_before_they_are_read(self):
        self.assertRefused(post(2 << 20), 413, 'body-too-large')
        self.assertRefused(post(1 << 62), 413, 'body-too-large')
        # With Expect the client hears so before it has sent a byte.
        raw = self.server.exchange(post(2 << 20, b'Expect: 100-continue\r\n'))
        self.assertNotIn(b'100 Continue', raw)
        chunked = (b'POST /v1/samples HTTP/1.1\r\n' + HOST + b'Transfer-Encoding: chunked\r\n\r\n' +
                   b'10000\r\n' + b'x' * 65536 + b'\r\n')
        raw = chunked + (b'10000\r\n' + b'x' * 65536 + b'\r\n') * 31
        self.assertRefused(raw, 413, 'body-too-large')

    def test_truncated_bodies_are_refused(self):
        self.assertRefused(post(1000) + CUBE[:50], 400, 'malformed-request', close_writing=True)
        chunked = b'POST /v1/samples HTTP/1.1\r\n' + HOST + b'Transfer-Encoding: chunked\r\n\r\n'
        self.assertRefused(chunked + b'10\r\nabc', 400, 'malformed-request', close_writing=True)
        self.assertRefused(chunked + b'zz\r\nabc\r\n', 400, 'malformed-request')

    def test_clients_that_vanish_leave_nothing_behind(self):
        seed = random.randrange(1 << 32)
        print('seed', seed)
        draw = random.Random(seed)
        whole = post(len(CUBE)) + CUBE
        for _ in range(60):
            connection = self.server.connect()
            connection.sendall(whole[:draw.randrange(len(whole) + 1)])
            if draw.random() < 0.5:  # With a reset instead of an end.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER,
                                      b'\x01\x00\x00\x00\x00\x00\x00\x00')
            connection.close()
        harness.wait_until(lambda: not self.server.children(), 'all children to end')
        harness.wait_until(lambda: self.server.metric('strata_connections{protocol="http"}') <= 1,
                           'all connections to end')
        harness.wait_until(lambda: not os.listdir(self.server.path / 'scratch'), 'their files to go')

    def test_random_bytes_get_an_error_or_nothing(self):
        seed = random.randrange(1 << 32)
        print('seed', seed)
        draw = random.Random(seed)
        base = bytearray(post(len(CUBE)) + CUBE)
        for _ in range(80):
            raw = bytearray(base)
            for _ in range(draw.randrange(1, 12)):
                raw[draw.randrange(len(raw))] = draw.randrange(256)
            answer = self.server.exchange(bytes(raw), close_writing=True)
            self.assertTrue(answer == b'' or answer.startswith(b'HTTP/1.'), answer[:80])
            self.assertNotIn(b'500 Internal', answer)

    def test_a_request_may_come_byte_by_byte(self):
        with self.server.connect() as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            raw = post(len(CUBE), b'Connection: close\r\n') + CUBE
            for i in range(len(raw)):
                connection.send(raw[i:i + 1])
            self.assertEqual(Answer.parse(read_to_end(connection)).status, 200)


class Crashes(ServerCase):

    def test_a_killed_child_fails_its_job_alone(self):
        answers = []

        def ask():
            answers.append(self.server.curl(harness.LONG, body=CUBE))
        asking = threading.Thread(target=ask)
        asking.start()
        child = harness.wait_until(self.server.children, 'a child to run')[0]
        os.kill(int(child), signal.SIGSEGV)
        asking.join()
        problem = self.assertProblem(answers[0], 500, 'internal')
        self.assertIn('signal 11', problem['detail'])
        self.assertEqual(self.server.curl('/v1/samples?resolution=3', body=CUBE).status, 200)

    def test_a_client_that_leaves_ends_its_job(self):
        connection = self.server.connect()
        connection.sendall(harness.long_request())
        harness.wait_until(self.server.children, 'a child to run')
        cancelled = self.server.metric('strata_jobs_total{outcome="cancelled"}')
        connection.close()
        harness.wait_until(lambda: not self.server.children(), 'the child to end')
        harness.wait_until(
            lambda: self.server.metric('strata_jobs_total{outcome="cancelled"}') == cancelled + 1,
            'the job to be counted as cancelled')


if __name__ == '__main__':
    harness.main()
