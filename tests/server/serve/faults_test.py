#!/usr/bin/env python3
"""Every endpoint times every fault, over HTTP. Each gets a right problem or a clean end, and leaves
nothing behind. The endpoints come from the service's own table: a new one is tried, too."""
import json
import os
import pathlib
import random
import signal
import socket
import tempfile
import unittest

import harness
from harness import CUBE, LONG_MODEL, Answer, Server, ServerCase, make_keys, read_to_end, spot

METHODS = ('GET', 'HEAD', 'POST', 'PUT', 'PATCH', 'DELETE', 'OPTIONS', 'TRACE', 'BREW')
BODY_OF = {  # Of the routes that read one: a good body and its headers.
    ('POST', '/v1/samples'): (CUBE, {}),
    ('PUT', '/v1/models/{name...}'): (CUBE, {}),
    ('POST', '/v1/jobs'): (b'{"model": "kept.obj", "options": {"resolution": 4}}',
                           {'Content-Type': 'application/json'}),
    ('PATCH', '/v1/uploads/{id}'): (CUBE, {'Content-Type': 'application/offset+octet-stream',
                                           'Upload-Offset': '0'}),
}
NUMBERS = ('1e400', '-1e400', '18446744073709551616', '340282366920938463463374607431768211456',
           '-1', 'NaN', 'inf', '0x10', '1' * 1000, '1,5', '')


class Faults(unittest.TestCase):
    """One service with keys and a data folder. What it holds is looked at before and after."""
    assertProblem = ServerCase.assertProblem

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.full, cls.read, keys = make_keys(cls.folder.name)
        cls.server = Server('--grpc', 'off', '--keys', str(keys), '--data',
                            f'{cls.folder.name}/data', '--models', str(spot().parent),
                            '--body-size', '1M', '--header-size', '8K', '--jobs', '2',
                            '--job-time', '20')
        cls.ask(cls, 'PUT', '/v1/models/kept.obj', body=CUBE)
        cls.job = cls.ask(cls, 'POST', '/v1/jobs', {'Content-Type': 'application/json'},
                          BODY_OF['POST', '/v1/jobs'][0]).json()['id']
        cls.ask(cls, 'GET', f'/v1/jobs/{cls.job}?wait=60')

    @classmethod
    def tearDownClass(cls):
        status = cls.server.stop()
        cls.folder.cleanup()
        assert status == 0, f'the server ended with {status}: {cls.server.log[-5:]}'

    def setUp(self):
        # Everything that is made on demand is there: what comes on top of it is a leak.
        self.assertEqual(self.ask('POST', '/v1/samples?resolution=3', body=CUBE).status, 200)
        harness.wait_until(lambda: self.server.held()['descriptors'].get('socket', 0) <= 1 and
                           not self.server.children(), 'earlier connections to end')
        self.before = self.server.held()

    def tearDown(self):
        self.server.await_held(self.before)
        self.assertEqual(self.ask('GET', '/livez').status, 200)
        self.assertEqual(self.ask('POST', '/v1/samples?resolution=3', body=CUBE).status, 200)
        incoming = pathlib.Path(self.folder.name) / 'data' / 'incoming'
        harness.wait_until(lambda: not incoming.exists() or not os.listdir(incoming),
                           'what was half stored to be gone')
        for line in list(self.server.log):
            self.assertNotIn(line.get('event'), ('connection_failed', 'text', 'no_thread'), line)

    # --- One request, raw: curl would mend some of the faults ---

    def raw(self, method, path, headers=None, body=b'', length=None, key=None):
        lines = [f'{method} {path} HTTP/1.1', 'Host: localhost', 'Connection: close',
                 f'Authorization: Bearer {self.full if key is None else key}']
        lines += [f'{name}: {value}' for name, value in (headers or {}).items()]
        if body or length is not None:
            lines.append(f'Content-Length: {len(body) if length is None else length}')
        return '\r\n'.join([*lines, '', '']).encode('latin-1') + body

    def ask(self, method, path, headers=None, body=b'', **more):
        received = self.server.exchange(Faults.raw(self, method, path, headers, body, **more))
        return Answer.parse(received)

    def place(self, method, path):
        """(path with its parameter filled in, headers of the protocol) of a route."""
        if path.startswith('/v1/uploads'):
            tus = {'Tus-Resumable': '1.0.0'}
            if '{' not in path:
                return path, {**tus, 'Upload-Length': '9', 'Upload-Metadata': 'name eA=='}
            made = self.ask('POST', '/v1/uploads', {**tus, 'Upload-Length': str(len(CUBE)),
                                                    'Upload-Metadata': 'name dHVzLm9iag=='})
            return made.headers['location'], tus
        if path == '/v1/samples' and method == 'GET':
            return '/v1/samples?model=kept.obj&resolution=5&format=ply', {}
        if path == '/v1/samples':
            return '/v1/samples?resolution=5&format=ply', {}
        name = 'index.js' if 'file' in path else 'x.obj' if method in ('PUT', 'DELETE') else 'kept.obj'
        job = self.job if method == 'GET' else 'none'
        for parameter, value in (('{file...}', name), ('{name...}', name), ('{id}', job)):
            path = path.replace(parameter, value)
        return path, {}

    def requests(self):
        """Each route: its row, and a good request to it as the parts of raw()."""
        for method, path, access in harness.route_table():
            where, headers = self.place(method, path)
            body, more = BODY_OF.get((method, path), (b'', {}))
            yield (method, path, access), (method, where, {**headers, **more}, body)

    def assertRight(self, received, statuses=range(400, 500)):
        """A whole answer with one of these statuses, or a clean end."""
        if received == b'':
            return
        answer = Answer.parse(received)
        self.assertIn(answer.status, statuses, received[:400])
        if answer.status >= 400 and answer.body:
            self.assertProblem(answer, answer.status, answer.json()['type'].rpartition('/')[2])

    # --- The faults ---

    def test_a_good_request_to_every_endpoint_is_answered_well(self):
        for row, request in self.requests():
            if row[1].startswith('/v1/batches'):
                continue  # Good ones are in tests/server/batch/service_test.py.
            with self.subTest(row=row):
                status = self.ask(*request).status
                self.assertTrue(status < 400 or row[0] == 'DELETE' and status == 404, status)

    def test_a_wrong_method_is_told_the_right_ones(self):
        table = {}
        for method, path, _ in harness.route_table():
            table.setdefault(path, set()).update({method, 'HEAD'} if method == 'GET' else {method})
        for path, taken in table.items():
            where, headers = self.place('GET', path)
            for method in METHODS:
                if method in taken:
                    continue
                with self.subTest(method=method, path=path):
                    answer = self.ask(method, where.partition('?')[0], headers, b'x')
                    self.assertEqual(answer.status, 405)
                    self.assertEqual(set(answer.headers['allow'].split(', ')), taken)
                    if method != 'HEAD':
                        self.assertProblem(answer, 405, 'method-not-allowed', where.partition('?')[0])

    def test_every_endpoint_asks_for_the_key_that_it_needs(self):
        for (method, path, access), request in self.requests():
            for key, known in (('', None), ('x', None), (self.full[:-1], None), (self.full + '0', None),
                               ('strata_' + '0' * 64, None), ('a b', None), (self.read, 'Read')):
                with self.subTest(method=method, path=path, key=key[:8]):
                    answer = self.ask(*request, key=key)
                    refused = 0
                    if access != 'Open' and known is None:
                        refused = 401
                        self.assertEqual(answer.headers['www-authenticate'], 'Bearer')
                    elif access == 'Full':
                        refused = 403
                    if not refused:
                        self.assertNotIn(answer.status, (401, 403))
                        continue
                    self.assertEqual(answer.status, refused)
                    if method != 'HEAD':
                        self.assertProblem(answer, refused,
                                           {401: 'unauthenticated', 403: 'forbidden'}[refused])

    def test_a_key_under_another_scheme_is_none(self):
        for value in ('Basic eDp5', self.full, 'Bearer', 'Bearer ' + 'x' * 5000, 'Bearer\t' + self.full):
            answer = Answer.parse(self.server.exchange(
                b'GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAuthorization: ' +
                value.encode() + b'\r\n\r\n'))
            self.assertProblem(answer, 401, 'unauthenticated')

    def test_a_wrong_content_type_is_refused_wherever_a_body_is_read(self):
        meshes = ('multipart/form-data; boundary=x', 'application/json', 'application/json; charset=x')
        other = ('text/plain', 'application/x-www-form-urlencoded', 'x', '', 'application/xml')
        for (method, path, _), (_, where, headers, body) in self.requests():
            if (method, path) not in BODY_OF:
                continue
            wrong = meshes if 'Content-Type' not in BODY_OF[method, path][1] else (*other, meshes[0])
            for kind in wrong:
                with self.subTest(path=path, kind=kind):
                    answer = self.ask(method, where, {**headers, 'Content-Type': kind}, body)
                    self.assertProblem(answer, 415, 'unsupported-media-type', 'Content-Type')

    def test_a_body_where_none_is_read_is_not_taken_for_a_request(self):
        inner = b'GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n'
        for (method, path, _), (_, where, headers, body) in self.requests():
            if body or method == 'POST':
                continue
            with self.subTest(method=method, path=path):
                raw = self.raw(method, where, headers, inner).replace(b'Connection: close\r\n', b'')
                received = self.server.exchange(raw, close_writing=True)
                self.assertEqual(received.count(b'HTTP/1.1 '), 1, received[-400:])

    def test_broken_json_is_refused(self):
        deep = 10_000
        bodies = [b'{', b'}', b'nul', b'null', b'true', b'1', b'"x"', b'[]', b'{} {}', b'{"model":}',
                  b"{'model':'kept.obj'}", b'{"model":"kept.obj",}', b'\xef\xbb\xbf{}', b'\x00',
                  b'{"model":"\xff\xfe"}', b'{"model":"\\ud800"}', '{"model":"x"}'.encode('utf-16'),
                  b'{"model":"kept.obj"}\x00', b'[' * deep + b']' * deep, b'{"model":' * deep + b'1' + b'}' * deep,
                  b'{"options":' * deep, b'{"model":"' + b'\\' * 9999 + b'"}', b'{"model":["kept.obj"]}',
                  b'{"model":"kept.obj","model":7}', b'{"model":"kept.obj","options":[]}',
                  b'{"model":"kept.obj","options":{"options":{}}}', b'// x\n{}', b'{"model":"kept.obj"/**/}']
        for body in bodies:
            with self.subTest(body=body[:40]):
                answer = self.ask('POST', '/v1/jobs', {'Content-Type': 'application/json'}, body)
                self.assertIn(answer.status, (400, 404), answer.body[:300])
                self.assertRight(self.server.exchange(self.raw(
                    'POST', '/v1/jobs', {'Content-Type': 'application/json'}, body)))

    def test_huge_numbers_in_json_are_refused(self):
        fields = ('resolution', 'voxel_size', 'height', 'lambda', 'min_distance', 'seed', 'threads',
                  'memory', 'batch_size', 'tile_samples', 'position_error')
        self.assertLessEqual(set(fields), harness.sample_option_names())
        for field in fields:
            for number in ('1e400', '-1e400', '1' * 5000, '18446744073709551616', 'NaN', '-Infinity',
                           '"NaN"', '"-Infinity"', '"1e400"', '"18446744073709551616"', '-1', '"-1"', '[]',
                           '{}', '"x"', 'true', '1e', '0x10', '.5', '01'):
                if field == 'voxel_size' and number.strip('"').isdigit() and len(number) < 99:
                    continue  # Within its range.
                body = f'{{"model":"kept.obj","options":{{"{field}":{number}}}}}'.encode()
                with self.subTest(field=field, number=number[:30]):
                    answer = self.ask('POST', '/v1/jobs', {'Content-Type': 'application/json'}, body)
                    self.assertIn(answer.status, (400, 413), answer.body)
                    self.assertIn(answer.json()['type'].rpartition('/')[2],
                                  ('malformed-request', 'invalid-argument', 'over-limit'))

    def test_huge_numbers_in_the_query_are_refused(self):
        texts = ('integrator', 'format', 'attributes', 'strict')
        # Within its range of 1e-60 to 1e60; and a number may be written in base 16.
        good = {('voxel_size', number) for number in NUMBERS[2:4]} | {
            (option, '0x10') for option in ('voxel_size', 'lambda')}
        for method, base in (('POST', '/v1/samples?'), ('GET', '/v1/samples?model=kept.obj&')):
            for option in sorted(harness.sample_option_names()):
                for number in NUMBERS:
                    if (option in texts and number == '') or (option, number) in good:
                        continue
                    with self.subTest(method=method, option=option, number=number[:30]):
                        answer = self.ask(method, f'{base}{option}={number}', None,
                                          CUBE if method == 'POST' else b'')
                        named = 'attribute' if option == 'attributes' else option
                        self.assertProblem(answer, 400, 'invalid-argument', named)
        for path in (f'/v1/jobs/{self.job}?wait=', '/v1/models?page_size=', '/v1/jobs?page_size=',
                     '/v1/jobs?created_after=', '/v1/jobs?created_before=', '/v1/jobs?page_token=',
                     '/v1/models?page_token='):
            for number in NUMBERS:
                if number == '' or 'page_token' in path and len(number) > 100:
                    continue
                with self.subTest(path=path, number=number[:30]):
                    self.assertProblem(self.ask('GET', path + number), 400, 'invalid-argument')

    def test_huge_numbers_in_headers_are_refused_or_passed_over(self):
        patch = {'Tus-Resumable': '1.0.0', 'Content-Type': 'application/offset+octet-stream'}
        create = {'Tus-Resumable': '1.0.0', 'Upload-Metadata': 'name eA=='}
        where, _ = self.place('HEAD', '/v1/uploads/{id}')
        for number in NUMBERS:
            for method, path, headers, name in (
                    ('PATCH', where, patch, 'Upload-Offset'),
                    ('POST', '/v1/uploads', create, 'Upload-Length'),
                    ('POST', '/v1/uploads', create, 'Upload-Defer-Length')):
                with self.subTest(name=name, number=number[:30]):
                    answer = self.ask(method, path, {**headers, name: number}, b'x')
                    self.assertIn(answer.status, (400, 409, 413), answer.body)
            for form in ('bytes={}-', 'bytes=-{}', 'bytes={0}-{0}', '{}', 'bytes={}'):
                ranged = self.ask('GET', f'/v1/jobs/{self.job}/result', {'Range': form.format(number)})
                self.assertIn(ranged.status, (200, 206, 416), form)
            told = self.ask('GET', f'/v1/jobs/{self.job}/events', {'Last-Event-ID': number})
            self.assertIn(told.status, (200, 400))
            length = (f'PUT /v1/models/x HTTP/1.1\r\nHost: localhost\r\nContent-Length: {number}\r\n'
                      f'Authorization: Bearer {self.full}\r\n\r\n').encode()
            self.assertRight(self.server.exchange(length, close_writing=True))

    def test_a_body_that_ends_early_is_refused(self):
        for (method, path, _), (_, where, headers, body) in self.requests():
            if not body:
                continue
            for part in (0, 1, len(body) // 2, len(body) - 1):
                with self.subTest(path=path, part=part):
                    if method == 'PATCH':
                        where, _ = self.place(method, path)
                    raw = self.raw(method, where, headers, body[:part], length=len(body))
                    received = self.server.exchange(raw, close_writing=True)
                    self.assertProblem(Answer.parse(received), 400, 'malformed-request', 'early')
        self.assertEqual(self.ask('GET', '/v1/models/x.obj').status, 404, 'no half of a model is kept')

    def test_clients_that_leave_at_any_point_leave_nothing(self):
        seed = random.randrange(1 << 32)
        print('seed', seed)
        draw = random.Random(seed)
        for _, request in list(self.requests()):
            raw = self.raw(*request)
            head = raw.index(b'\r\n\r\n')
            cuts = [head // 2, head + 2, len(raw)] + ([(head + 4 + len(raw)) // 2] if request[3] else [])
            for cut in cuts:
                for reset in (False, True):
                    with self.server.connect() as client:
                        client.sendall(raw[:cut])
                        if cut == len(raw) and draw.random() < 0.5:
                            client.recv(1)  # Leaves while the answer is written.
                        if reset:
                            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b'\1' + b'\0' * 7)

    def test_a_client_that_leaves_in_the_middle_of_a_large_answer_leaves_nothing(self):
        self.ask('POST', '/v1/jobs', {'Content-Type': 'application/json'},
                 b'{"model": "kept.obj", "options": {"resolution": 300, "format": "xyz"}}')
        for request in (('POST', '/v1/samples?resolution=300&format=xyz', None, CUBE),
                        ('GET', '/v1/samples?model=kept.obj&resolution=300&format=xyz')):
            for reset in (False, True):
                with self.server.connect() as client:
                    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                    client.sendall(self.raw(*request))
                    self.assertEqual(client.recv(12), b'HTTP/1.1 200')
                    if reset:
                        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b'\1' + b'\0' * 7)

    def test_clients_that_leave_while_they_wait_leave_nothing(self):
        made = self.ask('POST', '/v1/jobs', {'Content-Type': 'application/json'},
                        json.dumps({'model': 'kept.obj', 'options': LONG_MODEL}).encode()).json()
        harness.wait_until(self.server.children, 'the job to run')
        clients = []
        for path in (f'/v1/jobs/{made["id"]}?wait=3600', f'/v1/jobs/{made["id"]}/events'):
            for _ in range(10):
                client = self.server.connect()
                client.sendall(self.raw('GET', path))
                clients.append(client)
        for client in clients[10:]:
            client.recv(1)
        for client in clients:
            client.close()
        self.ask('DELETE', f'/v1/jobs/{made["id"]}')

    def test_a_request_line_or_header_of_any_bytes_is_answered_or_ended(self):
        seed = random.randrange(1 << 32)
        print('seed', seed)
        draw = random.Random(seed)
        for _, request in list(self.requests()):
            base = self.raw(*request)
            for _ in range(4):
                raw = bytearray(base)
                for _ in range(draw.randrange(1, 8)):
                    raw[draw.randrange(len(raw))] = draw.randrange(256)
                received = self.server.exchange(bytes(raw), close_writing=True)
                self.assertTrue(received == b'' or received.startswith(b'HTTP/1.'), received[:80])
                self.assertNotIn(b'HTTP/1.1 500', received)


class Killed(unittest.TestCase):

    def test_a_job_whose_service_is_killed_as_it_starts_ends_with_it(self):
        # By itself the job would go on for many minutes: 2.4 billion cells.
        path = harness.LONG.replace('3000', '20000')
        for _ in range(6):
            server = Server()
            with server.connect() as client:
                client.sendall(harness.long_request(path))
                child = harness.wait_until(server.children, 'a child to start')[0]
                server.stop(signal.SIGKILL)
                harness.wait_until(lambda: not harness.is_alive(child), 'the child to end')


if __name__ == '__main__':
    harness.main()
