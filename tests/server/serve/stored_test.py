#!/usr/bin/env python3
"""Models, jobs, cached results and resumable uploads, over HTTP."""
import base64
import hashlib
import json
import tempfile
import unittest

import harness
from harness import (CUBE, LONG_MODEL, Server, ServerCase, sample_by_command, spot, tiles_by_command,
                     tiles_in_zip)


class StoredCase(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.server = Server('--data', f'{cls.folder.name}/data', '--models',
                            str(spot().parent))
        cls.put('cube.obj', CUBE)

    @classmethod
    def tearDownClass(cls):
        assert cls.server.stop() == 0
        cls.folder.cleanup()

    assertProblem = ServerCase.assertProblem

    @classmethod
    def put(cls, name, mesh, *options):
        return cls.server.curl(f'/v1/models/{name}', '-X', 'PUT', *options, body=mesh)

    def post_job(self, body, *options):
        raw = body if isinstance(body, bytes) else json.dumps(body).encode()
        return self.server.curl('/v1/jobs', '-H', 'Content-Type: application/json', *options,
                                body=raw)


class Models(StoredCase):

    def test_a_model_comes_back_as_it_was_put(self):
        put = self.put('cars/mini.obj', CUBE)
        self.assertEqual(put.status, 201, put.body)
        model = self.server.curl('/v1/models/cars/mini.obj').json()
        self.assertEqual(model['sha256'], hashlib.sha256(CUBE).hexdigest())
        self.assertEqual((model['size_bytes'], model['format']), (str(len(CUBE)), 'obj'))
        content = self.server.curl('/v1/models/cars%2Fmini.obj?content')
        self.assertEqual(content.body, CUBE)
        etag = content.headers['etag']
        again = self.server.curl('/v1/models/cars/mini.obj?content', '-H',
                                 f'If-None-Match: {etag}')
        self.assertEqual((again.status, again.body), (304, b''))
        part = self.server.curl('/v1/models/cars/mini.obj?content', '-H', 'Range: bytes=2-5')
        self.assertEqual((part.status, part.body), (206, CUBE[2:6]))
        self.assertEqual(part.headers['content-range'], f'bytes 2-5/{len(CUBE)}')
        beyond = self.server.curl('/v1/models/cars/mini.obj?content', '-H', 'Range: bytes=99999-')
        self.assertProblem(beyond, 416, 'range-not-satisfiable')

    def test_conditions_hold_or_nothing_changes(self):
        self.put('kept.obj', CUBE)
        other = CUBE + b'# other\n'
        etag = '"' + hashlib.sha256(CUBE).hexdigest() + '"'
        for name, condition in (('kept.obj', 'If-None-Match: *'),
                                ('kept.obj', f'If-None-Match: "x", W/{etag}'),
                                ('kept.obj', f'If-Match: "{"0" * 64}"'), ('kept.obj', 'If-Match: ""'),
                                ('kept.obj', f'If-Match: W/{etag}'), ('none.obj', 'If-Match: *')):
            with self.subTest(condition=condition):
                self.assertProblem(self.put(name, other, '-H', condition), 412,
                                   'precondition-failed')
                gone = self.server.curl(f'/v1/models/{name}', '-X', 'DELETE', '-H', condition)
                self.assertProblem(gone, 412, 'precondition-failed')
        self.assertEqual(self.server.curl('/v1/models/kept.obj?content').body, CUBE)
        self.assertEqual(self.put('kept.obj', CUBE, '-H', 'If-Match: *').status, 200)
        self.assertEqual(self.put('kept.obj', other, '-H', f'If-Match: "x", {etag}').status, 200)

    def test_a_condition_that_fails_is_told_before_the_body_is_sent(self):
        self.put('early.obj', CUBE)
        received = self.server.exchange(
            b'PUT /v1/models/early.obj HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: *\r\n'
            b'Expect: 100-continue\r\nContent-Length: 100000\r\n\r\n')
        self.assertTrue(received.startswith(b'HTTP/1.1 412'), received)

    def test_a_parameter_that_an_endpoint_does_not_take_is_said(self):
        self.put('asked.obj', CUBE)
        where = '/v1/models/asked.obj'
        for path, method in ((where, 'GET'), (where, 'PUT'), (where, 'DELETE'),
                             ('/v1/jobs', 'POST'), ('/v1/jobs/x', 'DELETE'),
                             ('/v1/jobs/x/events', 'GET'), ('/v1/jobs/x/result', 'GET')):
            with self.subTest(path=path, method=method):
                answer = self.server.curl(path + '?format=ply', '-X', method, body=CUBE)
                self.assertProblem(answer, 400, 'invalid-argument', "'format'")
        self.assertEqual(self.server.curl(where + '?content').body, CUBE)

    def test_a_proxy_may_weaken_a_tag_and_a_head_has_no_ranges(self):
        self.put('weak.obj', CUBE)
        where = '/v1/models/weak.obj?content'
        etag = self.server.curl(where).headers['etag']
        self.assertEqual(self.server.curl(where, '-H', f'If-None-Match: W/{etag}').status, 304)
        self.assertEqual(self.server.curl(where, '-H', f'If-Match: W/{etag}').status, 412)
        head = self.server.curl(where, '-I', '-H', 'Range: bytes=0-3')
        self.assertEqual((head.status, head.headers['content-length']), (200, str(len(CUBE))))

    def test_models_are_listed_in_pages_and_deleted(self):
        for i in range(5):
            self.put(f'page/{i}', CUBE)
        names, token = [], ''
        while True:
            page = self.server.curl(f'/v1/models?prefix=page/&page_size=2&page_token={token}')
            names += [model['name'] for model in page.json()['models']]
            token = page.json().get('next_page_token', '')
            if not token:
                break
        self.assertEqual(names, [f'page/{i}' for i in range(5)])
        self.assertEqual(self.server.curl('/v1/models/page/3', '-X', 'DELETE').status, 204)
        self.assertProblem(self.server.curl('/v1/models/page/3'), 404, 'not-found')

    def test_names_never_leave_the_folder(self):
        for name in ('..', '../x', 'a/../../x', '/etc/passwd', 'a//b', '.hidden', 'a/.b', 'a%5Cb',
                     '%2E%2E%2Fx', 'a' * 300, 'x/' * 300):
            for answer in (self.put(name, CUBE, '--path-as-is'),
                           self.server.curl(f'/v1/models/{name}', '--path-as-is')):
                self.assertProblem(answer, 400, 'invalid-argument')
        self.assertProblem(self.put('a%00b', CUBE), 400, 'malformed-request')

    def test_the_mounted_folder_is_read_only(self):
        model = self.server.curl('/v1/models/spot.obj').json()
        self.assertTrue(model['read_only'])
        self.assertProblem(self.put('spot.obj', CUBE), 409, 'conflict')
        self.assertProblem(self.server.curl('/v1/models/spot.obj', '-X', 'DELETE'), 409,
                           'conflict')

    def test_a_put_that_is_broken_off_leaves_nothing(self):
        self.server.exchange(b'PUT /v1/models/half HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99\r\n'
                             b'\r\nv 0', close_writing=True)
        self.assertProblem(self.server.curl('/v1/models/half'), 404, 'not-found')


class Results(StoredCase):

    def test_a_stored_model_gives_the_bytes_of_the_command_and_then_from_the_cache(self):
        path = '/v1/samples?model=spot.obj&resolution=33&format=ply'
        expected = sample_by_command(spot(), 'ply', '--resolution', '33')
        first, second = self.server.curl(path), self.server.curl(path + '&lambda=5.0&threads=1')
        self.assertTrue(first.body == expected)
        self.assertTrue(second.body == expected)
        self.assertEqual((first.headers['strata-cache'], second.headers['strata-cache']),
                         ('miss', 'hit'))
        self.assertEqual(first.headers['etag'], second.headers['etag'])
        third = self.server.curl(path, '-H', f'If-None-Match: {first.headers["etag"]}')
        self.assertEqual((third.status, third.body), (304, b''))
        self.assertGreaterEqual(self.server.metric('strata_cache_total{outcome="hit"}'), 2)

    def test_tiles_in_a_zip_are_cached_and_ranged_like_any_result(self):
        path = '/v1/samples?model=spot.obj&resolution=40&tile_samples=600'
        first, second = self.server.curl(path), self.server.curl(path)
        expected = tiles_by_command(spot(), '--resolution', '40', '--tile-samples', '600')
        self.assertTrue(tiles_in_zip(first.body) == expected)
        self.assertEqual((first.headers['strata-cache'], second.headers['strata-cache']),
                         ('miss', 'hit'))
        for answer in (first, second):
            self.assertEqual(answer.headers['content-type'], 'application/zip')
            self.assertIn('"samples.zip"', answer.headers['content-disposition'])
        self.assertTrue(second.body == first.body)
        etag = first.headers['etag']
        part = self.server.curl(path, '-H', 'Range: bytes=100-299', '-H', f'If-Range: {etag}')
        self.assertEqual((part.status, part.body), (206, first.body[100:300]))
        self.assertEqual(self.server.curl(path, '-H', f'If-None-Match: {etag}').status, 304)

    def test_uniform_samples_are_cached_by_what_decides_them(self):
        path = '/v1/samples?model=spot.obj&method=uniform&format=ply'
        first = self.server.curl(f'{path}&count=700')
        again = self.server.curl(f'{path}&count=700&memory=67108864')
        other = self.server.curl(f'{path}&count=701')
        self.assertTrue(first.body == sample_by_command(spot(), 'ply', '--method', 'uniform',
                                                        '--count', '700'))
        self.assertEqual([answer.headers['strata-cache'] for answer in (first, again, other)],
                         ['miss', 'hit', 'miss'])

    def test_a_broken_model_says_so_each_time(self):
        self.put('broken.ply', b'ply\nformat ascii 1.0\nelement vertex x\n')
        for _ in range(2):
            self.assertProblem(self.server.curl('/v1/samples?model=broken.ply'), 422,
                               'corrupt-input', 'broken.ply: line 3')
        self.assertProblem(self.server.curl('/v1/samples?model=nowhere'), 404, 'not-found')
        self.assertProblem(self.server.curl('/v1/samples'), 400, 'invalid-argument', 'model')


class Jobs(StoredCase):

    def test_a_job_ends_with_the_bytes_of_the_command(self):
        made = self.post_job({'model': 'spot.obj', 'options': {'resolution': 21, 'format': 'ply'}})
        self.assertEqual(made.status, 202, made.body)
        self.assertEqual(made.headers['location'], f'/v1/jobs/{made.json()["id"]}')
        done = self.server.curl(made.headers['location'] + '?wait=60').json()
        self.assertEqual(done['state'], 'succeeded', done)
        self.assertEqual(done['options']['resolution'], 21)
        result = self.server.curl(made.headers['location'] + '/result')
        self.assertTrue(result.body == sample_by_command(spot(), 'ply', '--resolution', '21'))
        self.assertEqual(result.headers['etag'], done['summary']['etag'])
        part = self.server.curl(made.headers['location'] + '/result', '-H', 'Range: bytes=-7',
                                '-H', f'If-Range: {result.headers["etag"]}')
        self.assertEqual((part.status, part.body), (206, result.body[-7:]))

    def test_a_job_of_more_samples_than_a_tile_ends_with_a_zip(self):
        options = {'resolution': 40, 'tile_samples': '700'}
        made = self.post_job({'model': 'spot.obj', 'options': options}).json()
        done = self.server.curl(f'/v1/jobs/{made["id"]}?wait=60').json()
        self.assertEqual(done['state'], 'succeeded', done)
        self.assertEqual(done['summary']['media_type'], 'application/zip')
        result = self.server.curl(f'/v1/jobs/{made["id"]}/result')
        self.assertEqual(result.headers['content-type'], 'application/zip')
        expected = tiles_by_command(spot(), '--resolution', '40', '--tile-samples', '700')
        self.assertTrue(tiles_in_zip(result.body) == expected)

    def test_a_failed_job_carries_its_problem(self):
        self.put('bad.ply', b'ply\nformat ascii 1.0\nelement vertex x\n')
        made = self.post_job({'model': 'bad.ply'}).json()
        done = self.server.curl(f'/v1/jobs/{made["id"]}?wait=60').json()
        self.assertEqual(done['state'], 'failed')
        self.assertEqual(done['error']['type'], '/problems/corrupt-input')
        self.assertProblem(self.server.curl(f'/v1/jobs/{made["id"]}/result'), 409, 'conflict')

    def test_events_tell_the_job_until_it_has_ended(self):
        made = self.post_job({'model': 'cube.obj', 'options': {'resolution': 400}}).json()
        answer = self.server.curl(f'/v1/jobs/{made["id"]}/events')
        self.assertEqual(answer.headers['content-type'], 'text/event-stream')
        jobs = [json.loads(line[6:]) for line in answer.body.decode().splitlines()
                if line.startswith('data: ')]
        self.assertEqual(jobs[-1]['state'], 'succeeded')
        ids = [int(line[4:]) for line in answer.body.decode().splitlines()
               if line.startswith('id: ')]
        self.assertEqual(ids, sorted(set(ids)))

    def test_a_head_of_events_waits_for_none(self):
        made = self.post_job({'model': 'cube.obj', 'options': LONG_MODEL}).json()
        received = self.server.exchange(f'HEAD /v1/jobs/{made["id"]}/events HTTP/1.1\r\n'
                                        'Host: localhost\r\n\r\n'.encode())
        self.assertIn(b'text/event-stream', received)
        self.assertTrue(received.endswith(b'\r\n\r\n'), received)
        self.server.curl(f'/v1/jobs/{made["id"]}', '-X', 'DELETE')

    def test_a_running_job_is_cancelled(self):
        made = self.post_job({'model': 'cube.obj', 'options': LONG_MODEL}).json()
        where = f'/v1/jobs/{made["id"]}'
        harness.wait_until(self.server.children, 'a child to run')
        self.server.curl(where, '-X', 'DELETE')
        self.assertEqual(self.server.curl(where + '?wait=60').json()['state'], 'cancelled')
        harness.wait_until(lambda: not self.server.children(), 'the child to end')

    def test_an_idempotency_key_names_one_job(self):
        key = ['-H', 'Idempotency-Key: once']
        body = {'model': 'cube.obj', 'options': {'resolution': 7}}
        first, second = self.post_job(body, *key), self.post_job(body, *key)
        self.assertEqual(first.json()['id'], second.json()['id'])
        self.assertProblem(self.post_job({'model': 'cube.obj', 'options': {'resolution': 8}}, *key),
                           409, 'conflict')

    def test_jobs_are_listed_by_state_and_model(self):
        made = self.post_job({'model': 'spot.obj', 'options': {'resolution': 6}}).json()
        self.server.curl(f'/v1/jobs/{made["id"]}?wait=60')
        listed = self.server.curl('/v1/jobs?state=succeeded&model=spot.obj').json()['jobs']
        self.assertIn(made['id'], [job['id'] for job in listed])
        self.assertEqual({(job['state'], job['model']) for job in listed},
                         {('succeeded', 'spot.obj')})

    def test_broken_requests_are_refused(self):
        for body, status, kind in [
                (b'{', 400, 'malformed-request'), (b'', 400, 'malformed-request'),
                (b'[]', 400, 'malformed-request'), (b'{model: "x"}', 400, 'malformed-request'),
                ({'model': 'cube.obj', 'colour': 1}, 400, 'malformed-request'),
                ({'model': 7}, 400, 'malformed-request'),
                ({'model': 'cube.obj', 'options': {'resolution': 1e99}}, 400, 'malformed-request'),
                ({'model': 'cube.obj', 'options': {'lambda': 501}}, 400, 'invalid-argument'),
                ({}, 400, 'invalid-argument'), ({'model': 'none'}, 404, 'not-found'),
                (b'[' * 100_000, 400, 'malformed-request'),
                (b'"' + b'x' * (2 << 20) + b'"', 413, 'body-too-large')]:
            self.assertProblem(self.post_job(body), status, kind)
        plain = self.server.curl('/v1/jobs', body=b'{}')
        self.assertProblem(plain, 415, 'unsupported-media-type')
        for path in ('/v1/jobs/x', '/v1/jobs/' + '0' * 32, '/v1/jobs/x/result',
                     '/v1/jobs/x/events'):
            self.assertProblem(self.server.curl(path), 404, 'not-found')
        for path in ('/v1/jobs?state=odd', '/v1/jobs?page_size=x', '/v1/jobs?page_token=zz',
                     '/v1/jobs?page_size=5000', '/v1/jobs?nonsense=1', '/v1/models?page_size=-1'):
            self.assertProblem(self.server.curl(path), 400, 'invalid-argument')


class Tus(StoredCase):

    def tus(self, path, method, *headers, body=None):
        options = ['-I'] if method == 'HEAD' else ['-X', method]
        for header in ('Tus-Resumable: 1.0.0', *headers):
            options += ['-H', header]
        return self.server.curl(path, *options, body=body)

    def create(self, name, *headers):
        named = base64.b64encode(name.encode()).decode()
        return self.tus('/v1/uploads', 'POST', f'Upload-Metadata: name {named}', *headers)

    def patch(self, where, offset, body, *headers):
        return self.tus(where, 'PATCH', f'Upload-Offset: {offset}',
                        'Content-Type: application/offset+octet-stream', *headers, body=body)

    def test_an_upload_in_pieces_becomes_a_model(self):
        made = self.create('tus.obj', f'Upload-Length: {len(CUBE)}')
        self.assertEqual(made.status, 201, made.body)
        where = made.headers['location']
        first = self.patch(where, 0, CUBE[:40])
        self.assertEqual((first.status, first.headers['upload-offset']), (204, '40'))
        self.assertProblem(self.patch(where, 7, b'x'), 409, 'conflict')
        self.assertEqual(self.tus(where, 'HEAD').headers['upload-offset'], '40')
        digest = base64.b64encode(hashlib.sha1(CUBE[40:]).digest()).decode()
        wrong = self.patch(where, 40, b'x' * (len(CUBE) - 40), f'Upload-Checksum: sha1 {digest}')
        self.assertEqual(wrong.status, 460, wrong.body)
        last = self.patch(where, 40, CUBE[40:], f'Upload-Checksum: sha1 {digest}')
        self.assertEqual(last.status, 204, last.body)
        self.assertEqual(self.server.curl('/v1/models/tus.obj?content').body, CUBE)

    def test_what_a_broken_connection_brought_is_kept(self):
        where = self.create('cut.obj', f'Upload-Length: {len(CUBE)}').headers['location']
        self.server.exchange(f'PATCH {where} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\n'
                             'Content-Type: application/offset+octet-stream\r\nUpload-Offset: 0\r\n'
                             f'Content-Length: {len(CUBE)}\r\n\r\n'.encode() + CUBE[:33],
                             close_writing=True)
        self.assertEqual(self.tus(where, 'HEAD').headers['upload-offset'], '33')
        self.assertEqual(self.patch(where, 33, CUBE[33:]).status, 204)
        self.assertEqual(self.server.curl('/v1/models/cut.obj?content').body, CUBE)

    def test_the_protocol_is_told_and_held(self):
        told = self.server.curl('/v1/uploads', '-X', 'OPTIONS')
        self.assertEqual((told.status, told.headers['tus-version']), (204, '1.0.0'))
        self.assertIn('creation', told.headers['tus-extension'])
        other = self.server.curl('/v1/uploads', '-X', 'POST', '-H', 'Tus-Resumable: 0.2.2')
        self.assertProblem(other, 412, 'precondition-failed')
        self.assertEqual(other.headers['tus-version'], '1.0.0')
        self.assertProblem(self.create('x', 'Upload-Length: 4', 'Upload-Defer-Length: 1'), 400,
                           'malformed-request')
        self.assertProblem(self.create('x', 'Upload-Length: -1'), 400, 'malformed-request')
        self.assertProblem(self.create('../x', 'Upload-Length: 4'), 400, 'invalid-argument')
        self.assertProblem(self.tus('/v1/uploads', 'POST', 'Upload-Length: 4',
                                    'Upload-Metadata: name %%%'), 400, 'malformed-request')
        self.assertProblem(self.patch('/v1/uploads/none', 0, b'x'), 404, 'not-found')
        where = self.create('gone', 'Upload-Length: 9').headers['location']
        self.assertProblem(self.patch(where, 0, b'x', 'Upload-Length: nine'), 400,
                           'malformed-request', "'nine'")
        got = self.tus(where, 'POST', 'X-HTTP-Method-Override: PATCH', 'Upload-Offset: 0',
                       'Content-Type: application/offset+octet-stream', body=b'xy')
        self.assertEqual((got.status, got.headers['upload-offset']), (204, '2'))
        self.assertEqual(self.tus(where, 'POST', 'X-HTTP-Method-Override: DELETE').status, 204)
        self.assertEqual(self.tus(where, 'HEAD').status, 404)


class Without(ServerCase):

    def test_without_a_data_folder_it_says_so(self):
        for path in ('/v1/models', '/v1/models/x', '/v1/jobs', '/v1/jobs/x',
                     '/v1/samples?model=x'):
            self.assertProblem(self.server.curl(path), 501, 'not-implemented', '--data')


if __name__ == '__main__':
    harness.main()
