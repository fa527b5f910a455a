#!/usr/bin/env python3
"""Limits: what is over one is told so, what is within goes on meanwhile."""
import concurrent.futures
import os
import signal
import tempfile
import unittest

import harness
from harness import LONG, CUBE, Answer, Server, ServerCase, long_request, read_to_end

SLOW = ('--min-rate', '1000', '--grace', '3', '--header-timeout', '3')


class SlowClients(ServerCase):
    options = SLOW

    def test_slow_clients_are_cut_off_while_others_are_served(self):
        def slow_client(number):
            client = self.server.connect()
            self.addCleanup(client.close)
            head = b'POST /v1/samples HTTP/1.1\r\nHost: localhost\r\n'
            client.sendall(head + b'Content-Length: 1000\r\n\r\nv' * (number % 2))
            return client

        def all_at_once():
            """Whether the last of them came before the first was cut off: not on a busy machine."""
            clients = [slow_client(i) for i in range(200)]
            together = self.server.metric('strata_connections{protocol="http"}') >= 200
            self.assertEqual(self.server.curl('/livez').status, 200)
            self.assertEqual(self.server.curl('/v1/samples?resolution=5', body=CUBE).status, 200)
            for client in clients:
                self.assertProblem(Answer.parse(read_to_end(client)), 408, 'too-slow')
                client.close()
            return together
        harness.wait_until(all_at_once, '200 slow clients at once')

    def test_a_slow_reader_is_cut_off(self):
        with self.server.connect() as client:
            client.setsockopt(harness.socket.SOL_SOCKET, harness.socket.SO_RCVBUF, 4096)
            client.sendall(b'POST /v1/samples?resolution=700&format=xyz HTTP/1.1\r\nHost: localhost\r\n'
                           b'X-Request-Id: reader\r\n'
                           b'Content-Length: %d\r\n\r\n' % len(CUBE) + CUBE)
            line = self.server.request_line('reader')  # It ends although nothing is read.
            self.assertLess(line['bytes_out'], 100_000_000)


class Busy(unittest.TestCase):

    def serve(self, *options):
        server = Server(*options)
        self.addCleanup(server.stop)
        return server

    def start_long(self, server, count=1):
        """Connections whose jobs take seconds; all of them are running or waiting."""
        clients = []
        for _ in range(count):
            client = server.connect()
            self.addCleanup(client.close)
            client.sendall(long_request())
            clients.append(client)
        harness.wait_until(lambda: server.metric('strata_jobs_running') +
                           server.metric('strata_jobs_waiting') >= count, f'{count} jobs')
        return clients

    def test_requests_beyond_the_limit_are_told_to_come_again(self):
        server = self.serve('--requests', '1')
        self.start_long(server)
        answer = server.curl('/v1/samples?resolution=3', body=CUBE)
        ServerCase.assertProblem(self, answer, 429, 'too-many-requests')
        self.assertGreaterEqual(int(answer.headers['retry-after']), 1)
        self.assertEqual(server.curl('/readyz').status, 200)

    def test_jobs_beyond_the_queue_are_told_to_come_again(self):
        server = self.serve('--jobs', '1', '--queue', '1')
        self.start_long(server, 2)
        answer = server.curl('/v1/samples?resolution=3', body=CUBE)
        ServerCase.assertProblem(self, answer, 503, 'unavailable')
        self.assertGreaterEqual(int(answer.headers['retry-after']), 1)

    def test_an_accepted_job_waits_however_full_the_queue_is(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        server = self.serve('--jobs', '1', '--queue', '1', '--data', folder.name)
        server.curl('/v1/models/cube.obj', '-X', 'PUT', body=CUBE)
        clients = self.start_long(server, 2)
        self.assertEqual(server.curl('/v1/samples?resolution=3', body=CUBE).status, 503)
        made = server.curl('/v1/jobs', '-H', 'Content-Type: application/json',
                           body=b'{"model": "cube.obj", "options": {"resolution": 5}}')
        self.assertEqual(made.status, 202, made.body)
        harness.wait_until(lambda: server.metric('strata_jobs_waiting') == 2, 'the job to wait')
        for client in clients:
            client.close()
        job = server.curl(made.headers['location'] + '?wait=60').json()
        self.assertEqual(job['state'], 'succeeded', job)

    def test_connections_beyond_the_limit_are_turned_away(self):
        server = self.serve('--connections', '3')
        clients = [server.connect() for _ in range(3)]
        for client in clients:
            client.sendall(b'GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n')
            client.recv(4096)
        answer = Answer.parse(server.exchange(b'GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n'))
        self.assertEqual(answer.status, 503)
        self.assertEqual(answer.headers['retry-after'], '1')
        self.assertEqual(answer.json()['type'], '/problems/unavailable')
        for client in clients:
            client.close()
        harness.wait_until(lambda: server.exchange(
            b'GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n').startswith(
                b'HTTP/1.1 200'), 'a place')

    def test_sixty_four_requests_at_once_are_all_answered(self):
        server = self.serve('--memory', '256M', '--jobs', '2')
        expected = server.curl('/v1/samples?resolution=30&format=ply', body=CUBE).body
        with concurrent.futures.ThreadPoolExecutor(64) as pool:
            answers = list(pool.map(
                lambda _: server.curl('/v1/samples?resolution=30&format=ply', body=CUBE),
                range(64)))
        self.assertEqual({answer.status for answer in answers}, {200})
        self.assertEqual({answer.body for answer in answers}, {expected})

    def test_health_answers_while_all_cores_work(self):
        server = self.serve('--jobs', '8', '--memory', '1G')
        self.start_long(server, 8)
        for _ in range(20):
            self.assertEqual(server.curl('/livez', '--max-time', '30').status, 200)

    def test_a_job_beyond_its_time_is_ended(self):
        for isolate in ('on', 'off'):
            server = self.serve('--job-time', '1', '--isolate', isolate)
            answer = server.curl(LONG, body=CUBE)
            problem = ServerCase.assertProblem(self, answer, 413, 'over-limit')
            self.assertIn('1 seconds', problem['detail'])
            self.assertEqual(server.children(), [])

    def test_a_result_beyond_its_size_is_refused(self):
        server = self.serve('--result-size', '10K')
        self.assertEqual(server.curl('/v1/samples?resolution=5', body=CUBE).status, 200)
        answer = server.curl('/v1/samples?resolution=200', body=CUBE)
        ServerCase.assertProblem(self, answer, 413, 'over-limit', '10240 bytes')

    def test_a_job_has_no_more_memory_than_it_was_given(self):
        server = self.serve('--memory', '64M', '--jobs', '1')
        answer = server.curl('/v1/samples?resolution=60&format=ply&memory=68719476736', body=CUBE)
        self.assertEqual(answer.status, 200, 'asks for more, runs with what there is')
        self.assertEqual(
            answer.body, server.curl('/v1/samples?resolution=60&format=ply', body=CUBE).body)

    def test_an_upload_stays_out_of_memory(self):
        server = self.serve('--body-size', '1G')
        server.curl('/v1/samples?resolution=3', body=CUBE)
        before, peak = server.resident_bytes(), 0
        piece = b'# ' + b'x' * 65533 + b'\n'
        with server.connect() as client:
            client.sendall(b'POST /v1/samples?resolution=3 HTTP/1.1\r\nHost: localhost\r\n'
                           b'Connection: close\r\nContent-Length: %d\r\n\r\n' %
                           (len(CUBE) + 3000 * len(piece)) + CUBE)
            for _ in range(3000):  # 197 MB
                client.sendall(piece)
                peak = max(peak, server.resident_bytes())
            self.assertEqual(Answer.parse(read_to_end(client)).status, 200)
        self.assertLess(peak - before, 64 << 20)


class Drain(unittest.TestCase):

    def test_sigterm_lets_requests_end(self):
        server = Server()
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            asked = pool.submit(server.curl, '/v1/samples?resolution=500&format=ply', body=CUBE)
            child = int(harness.wait_until(server.children, 'a job to run')[0])
            os.kill(child, signal.SIGSTOP)  # It ends no sooner than the drain begins.
            server.process.send_signal(signal.SIGTERM)
            harness.wait_until(lambda: server.events('draining'), 'the drain to begin')
            os.kill(child, signal.SIGCONT)
            answer = asked.result()
        self.assertEqual(answer.status, 200)
        self.assertEqual(answer.headers['connection'], 'close')
        self.assertEqual(server.stop(), 0)

    def test_while_draining_new_requests_are_turned_away(self):
        server = Server()
        busy, idle = server.connect(), server.connect()
        self.addCleanup(idle.close)
        busy.sendall(long_request())
        harness.wait_until(server.children, 'a job to run')
        server.process.send_signal(signal.SIGTERM)
        harness.wait_until(lambda: server.events('draining'), 'the drain to begin')
        self.assertEqual(read_to_end(idle), b'', 'idle connections end')
        with self.assertRaises(ConnectionError):
            harness.wait_until(lambda: server.connect().close(), 'the listener to close')
        busy.close()
        self.assertEqual(server.stop(), 0)

    def test_what_outlasts_the_drain_timeout_is_cut(self):
        server = Server('--drain-timeout', '0')
        with server.connect() as client:
            client.sendall(long_request())
            harness.wait_until(server.children, 'a job to run')
            self.assertEqual(server.stop(), 0)
        self.assertEqual(server.events('stopped')[0]['requests_cut'], 1)


if __name__ == '__main__':
    harness.main()
