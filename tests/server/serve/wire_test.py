#!/usr/bin/env python3
"""HTTP as no well-behaved client speaks it: where one server sees a request's end or host and
another sees it elsewhere, and lines that have no end."""
import time

import harness
from harness import CUBE, Answer, ServerCase

LINE = b'POST /v1/samples?resolution=8&format=ply HTTP/1.1\r\n'
HOST = b'Host: localhost\r\n'
CHUNKED = b'Transfer-Encoding: chunked\r\n'
SMUGGLED = b'GET /metrics HTTP/1.1\r\n' + HOST + b'\r\n'


def chunk(body):
    return b'%x\r\n' % len(body) + body + b'\r\n'


class Framing(ServerCase):

    def only(self, raw):
        """The one answer to all of `raw`, after which the server closes."""
        received = self.server.exchange(raw)
        self.assertEqual(received.count(b'X-Request-Id'), 1, received)
        return Answer.parse(received)

    def test_a_coding_besides_chunked_is_refused_and_nothing_after_it_is_a_request(self):
        for coding in (b'xchunked', b'chunked, identity', b'gzip, chunked', b'identity',
                       b'chunked;q=1', b''):
            with self.subTest(coding=coding):
                raw = LINE + HOST + b'Transfer-Encoding: ' + coding + b'\r\n\r\n'
                self.assertIn(self.only(raw + SMUGGLED).status, (400, 501))
        old = LINE.replace(b'1.1', b'1.0') + HOST + b'Connection: keep-alive\r\n' + CHUNKED
        self.assertProblem(self.only(old + b'\r\n' + chunk(b'x') + b'0\r\n\r\n' + SMUGGLED), 400,
                           'malformed-request', 'HTTP/1.0')

    def test_two_ways_to_say_where_a_body_ends_are_none(self):
        for fields in (b'Content-Length: 4\r\n' + CHUNKED, CHUNKED + b'Content-Length: 4\r\n',
                       b'Content-Length: 4\r\nContent-Length: 5\r\n',
                       CHUNKED + b'Transfer-Encoding: identity\r\n'):
            with self.subTest(fields=fields):
                raw = LINE + HOST + fields + b'\r\n0\r\n\r\n' + SMUGGLED
                self.assertProblem(self.only(raw), 400, 'malformed-request')

    def test_a_request_names_its_host_once(self):
        for hosts in (b'', HOST + HOST, HOST + b'Host: evil.example\r\n'):
            with self.subTest(hosts=hosts):
                self.assertProblem(self.only(b'GET /livez HTTP/1.1\r\n' + hosts + b'\r\n'), 400,
                                   'malformed-request', 'Host: found')

    def test_the_absolute_form_is_taken_and_goes_before_the_host(self):
        def ask(target):
            return self.only(b'GET ' + target + b' HTTP/1.1\r\n' + HOST +
                             b'Connection: close\r\n\r\n')
        self.assertEqual(ask(b'http://localhost:1/livez').body, b'ok\n')
        self.assertEqual(ask(b'http://127.0.0.1').headers['content-type'],
                         'text/html; charset=utf-8')
        self.assertProblem(ask(b'http://evil.example/livez'), 421, 'misdirected-request', 'evil')
        for target in (b'http:///livez', b'http://', b'http://localhost?x', b'ftp://localhost/'):
            with self.subTest(target=target):
                self.assertIn(ask(target).status, (400, 421))

    def test_a_trailer_and_chunk_extensions_are_passed_over(self):
        body = b'5;a="b"\r\n' + CUBE[:5] + b'\r\n' + chunk(CUBE[5:]) + b'0\r\nX-Sum: 1\r\n\r\n'
        head = LINE + HOST + CHUNKED + b'Connection: close\r\n\r\n'
        expected = self.server.curl('/v1/samples?resolution=8&format=ply', body=CUBE)
        self.assertTrue(self.only(head + body).body == expected.body)

    def test_lines_between_chunks_without_an_end_are_refused_and_held_nowhere(self):
        piece = b'X-Endless: ' + b'y' * 4000 + b'\r\n'
        for kind, start in (('trailer', chunk(CUBE) + b'0\r\n'), ('extension', b'4;')):
            with self.subTest(kind=kind), self.server.connect() as client:
                before, sent, begin = self.server.resident_bytes(), 0, time.monotonic()
                client.sendall(LINE + HOST + CHUNKED + b'\r\n' + start)
                line = piece if kind == 'trailer' else piece.replace(b'\r\n', b'')
                try:
                    while sent < 64 << 20 and time.monotonic() < begin + harness.PATIENCE:
                        client.sendall(line * 64)
                        sent += len(line) * 64
                    harness.end_writing(client)
                except (BrokenPipeError, ConnectionResetError):
                    pass  # It has answered, read on a little, and closed.
                self.assertLess(self.server.resident_bytes() - before, 16 << 20)
        # One that stops to listen is told.
        self.assertProblem(self.only(LINE + HOST + CHUNKED + b'\r\n4;' + b'e' * (1 << 20)), 431,
                           'header-too-large', 'extension')


if __name__ == '__main__':
    harness.main()
