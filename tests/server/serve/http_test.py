#!/usr/bin/env python3
"""HTTP as curl speaks it: what is answered to a well-behaved client."""
import base64
import hashlib
import io
import json
import pathlib
import re
import zipfile

import harness
from harness import (CUBE, ServerCase, sample_by_command, spot, tiles_by_command, tiles_in_zip,
                     writes_vdb)

WHITE_PIXEL = base64.b64decode(
    'iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR42mP4//8/AAX+Av4zEpUUAAAAAElFTkSuQmCC')


class Samples(ServerCase):

    def test_every_format_has_the_bytes_of_the_command(self):
        for name, media_type in [('drc', 'model/vnd.draco'), ('ply', 'model/vnd.ply'),
                                 ('xyz', 'text/plain'), ('npz', 'application/x-npz'),
                                 ('csv', 'text/csv'), ('glb', 'model/gltf-binary'),
                                 ('vdb', 'model/vnd.openvdb')]:
            if name == 'vdb' and not writes_vdb():
                continue
            expected = sample_by_command(spot(), name, '--resolution', '40')
            answer = self.server.curl(f'/v1/samples?resolution=40&format={name}',
                                      body=spot().read_bytes())
            self.assertEqual(answer.status, 200, answer.body)
            self.assertEqual(answer.headers['content-type'], media_type)
            self.assertEqual(int(answer.headers['content-length']), len(expected))
            self.assertTrue(answer.body == expected, f'{name}: other bytes than the command')

    def test_every_option_has_the_bytes_of_the_command(self):
        options = {'lambda': '2.5', 'min-distance': '0.8', 'seed': '18446744073709551615',
                   'integrator': 'subdivide', 'attributes': 'normal,cell,area',
                   'voxel-size': '0.07'}
        flags = [word for name, value in options.items() for word in (f'--{name}', value)]
        query = '&'.join(f'{name}={value}' for name, value in options.items())
        plain = self.server.curl(f'/v1/samples?format=npz&{query}', body=spot().read_bytes())
        under = self.server.curl(f'/v1/samples?format=npz&{query.replace("-", "_")}',
                                 body=spot().read_bytes())
        expected = sample_by_command(spot(), 'npz', *flags)
        self.assertEqual(plain.status, 200, plain.body)
        self.assertTrue(plain.body == expected)
        self.assertTrue(under.body == expected)
        for name, value in [('height', '5'), ('position-error', '0.05')]:
            answer = self.server.curl(f'/v1/samples?{name}={value}', body=spot().read_bytes())
            self.assertTrue(answer.body == sample_by_command(spot(), 'drc', f'--{name}', value))

    def test_uniform_samples_have_the_bytes_of_the_command(self):
        for query, flags in [('method=uniform&count=3000', ['--count', '3000']),
                             ('method=uniform&resolution=30', ['--resolution', '30'])]:
            answer = self.server.curl(f'/v1/samples?format=ply&{query}', body=spot().read_bytes())
            expected = sample_by_command(spot(), 'ply', '--method', 'uniform', *flags)
            self.assertEqual(answer.status, 200, answer.body)
            self.assertTrue(answer.body == expected, query)

    def test_textures_are_found_in_a_zip_and_nowhere_beside_a_mesh_alone(self):
        obj = b'mtllib m.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nusemtl red\nf 1 2 3\n'
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, 'w') as archive:
            for name, content in [('m.obj', obj), ('m.mtl', b'newmtl red\nKd 1 0.2 0\nmap_Kd a.png\n'),
                                  ('a.png', WHITE_PIXEL)]:
                archive.writestr(name, content)
        inside = self.server.curl('/v1/samples?format=csv&attributes=texture', body=packed.getvalue())
        self.assertEqual(inside.status, 200, inside.body)
        self.assertIn(b',255,51,0\n', inside.body)
        alone = self.server.curl('/v1/samples?format=csv&attributes=texture', body=obj)
        self.assertProblem(alone, 415, 'unsupported-format', "needs the file 'm.mtl', and this input has no folder")
        self.assertEqual(self.server.curl('/v1/samples?attributes=all', body=obj).status, 200)

    def test_more_samples_than_a_tile_are_the_folder_of_tiles_in_a_zip(self):
        query = '/v1/samples?resolution=40&tile_samples=500'
        answer = self.server.curl(query, body=spot().read_bytes())
        self.assertEqual(answer.status, 200, answer.body)
        self.assertEqual(answer.headers['content-type'], 'application/zip')
        self.assertEqual(int(answer.headers['content-length']), len(answer.body))
        expected = tiles_by_command(spot(), '--resolution', '40', '--tile-samples', '500')
        self.assertGreater(len(expected), 5)
        self.assertEqual(sorted(tiles_in_zip(answer.body)), sorted(expected))
        self.assertTrue(tiles_in_zip(answer.body) == expected, 'other bytes than the command')
        for run in ('threads=1', 'memory=67108864'):
            again = self.server.curl(f'{query}&{run}', body=spot().read_bytes())
            self.assertTrue(again.body == answer.body, run)
        one = self.server.curl('/v1/samples?resolution=40', body=spot().read_bytes())
        self.assertEqual(one.headers['content-type'], 'model/vnd.draco')

    def test_how_it_runs_changes_no_byte(self):
        expected = sample_by_command(spot(), 'ply', '--resolution', '30')
        for run in ('threads=1', 'memory=67108864', 'batch_size=3', 'strict=true', 'strict'):
            answer = self.server.curl(f'/v1/samples?resolution=30&format=ply&{run}',
                                      body=spot().read_bytes())
            self.assertTrue(answer.body == expected, run)

    def test_accept_chooses_the_format(self):
        for accept, media_type in [('model/vnd.ply', 'model/vnd.ply'),
                                   ('text/plain;q=0.5, application/x-npz', 'application/x-npz'),
                                   ('*/*', 'model/vnd.draco'),
                                   ('model/*', 'model/vnd.draco'),
                                   ('model/vnd.draco;q=0, */*', 'model/vnd.ply'),
                                   ('application/octet-stream', 'model/vnd.draco')]:
            answer = self.server.curl('/v1/samples?resolution=5', '-H', f'Accept: {accept}',
                                      body=CUBE)
            self.assertEqual(answer.headers['content-type'], media_type, accept)
        self.assertProblem(self.server.curl('/v1/samples', '-H', 'Accept: image/png', body=CUBE),
                           406, 'not-acceptable', 'model/vnd.draco, model/vnd.ply')

    def test_the_summary_is_in_a_header(self):
        answer = self.server.curl('/v1/samples?resolution=9&format=xyz', body=CUBE)
        summary = json.loads(answer.headers['strata-summary'])
        rows = [line for line in answer.body.splitlines() if not line.startswith(b'#')]
        self.assertEqual(summary['samples']['after_rejection'], len(rows))
        self.assertEqual(summary['input'], 'body')
        self.assertEqual(summary['lattice']['resolution'], 9)

    def test_chunked_and_expecting_bodies_are_taken(self):
        expected = self.server.curl('/v1/samples?resolution=8&format=ply', body=CUBE).body
        for header in ('Transfer-Encoding: chunked', 'Expect: 100-continue'):
            answer = self.server.curl('/v1/samples?resolution=8&format=ply', '-H', header,
                                      body=CUBE)
            self.assertTrue(answer.body == expected, header)
        old = self.server.curl('/v1/samples?resolution=8&format=ply', '--http1.0', body=CUBE)
        self.assertTrue(old.body == expected)


class Problems(ServerCase):

    def test_a_bad_mesh_is_the_client_s_error_with_the_place(self):
        for body, status, kind, detail in [
                (b'ply\nformat ascii 1.0\nelement vertex x\n', 422, 'corrupt-input',
                 'body: line 3:'),
                (b'v 0 0 0\nv 0 0 1\nv 0 0 2\nf 1 2 3\n', 422, 'empty-surface', 'body: '),
                (b'\x00\x01\x02 neither', 415, 'unsupported-format', 'expected PLY, OBJ'),
                (b'', 400, 'malformed-request', 'empty')]:
            self.assertProblem(self.server.curl('/v1/samples', body=body), status, kind, detail)

    def test_strict_refuses_what_would_be_skipped(self):
        mesh = CUBE + b'f 1 1 2\n'
        self.assertEqual(self.server.curl('/v1/samples?resolution=3', body=mesh).status, 200)
        self.assertProblem(self.server.curl('/v1/samples?resolution=3&strict=true', body=mesh),
                           422, 'corrupt-input', 'body')

    def test_an_option_out_of_range_names_its_range_and_default(self):
        for query, words in [
                ('resolution=0', "resolution: found '0', expected a whole number from 1 to"),
                ('resolution=99999999999', "resolution: found '99999999999', expected"),
                ('resolution=1e3', "resolution: found '1e3', expected"),
                ('resolution=', "resolution: found '', expected"),
                ('lambda=-1', "lambda: found '-1', expected a number from 0 to 500 (default 5)"),
                ('lambda=nan', "lambda: found 'nan'"),
                ('lambda=1e999', "lambda: found '1e999'"),
                ('min_distance=5', "min_distance: found '5', expected"),
                ('min-distance=x', "min_distance: found 'x', expected"),
                ('seed=18446744073709551616', "seed: found '18446744073709551616'"),
                ('integrator=magic', "integrator: found 'magic', expected exact or subdivide"),
                ('method=random', "method: found 'random', expected stratified or uniform"),
                ('method=uniform&count=0', "count: found '0', expected a whole number"),
                ('count=10', 'count is an option of method uniform'),
                ('method=uniform&count=10&lambda=3', 'count excludes lambda, min_distance and'),
                ('format=stl', "format: found 'stl', expected drc, ply, xyz, npz, csv, glb or vdb"),
                ('attributes=a%20b', "attributes: found 'a b', expected normal, triangle"),
                ('normals=flat', "normals: found 'flat', expected vertex or face"),
                ('memory=1', 'memory: found'),
                ('strict=perhaps', 'strict'),
                ('resolution=4&height=3', 'height'),
                ('resolution=4&resolution=5', 'resolution: given twice'),
                ('resolutoin=4', "unknown option 'resolutoin'; did you mean 'resolution'?"),
                ('output=/etc/passwd', "unknown option 'output'"),
                ('scratch=/tmp', "unknown option 'scratch'")]:
            answer = self.server.curl(f'/v1/samples?{query}', body=CUBE)
            self.assertProblem(answer, 400, 'invalid-argument', words)

    def test_what_no_endpoint_takes_is_said_with_what_it_does(self):
        self.assertProblem(self.server.curl('/nowhere'), 404, 'no-such-endpoint', '/nowhere')
        wrong = self.server.curl('/v1/samples', '-X', 'PATCH')
        self.assertProblem(wrong, 405, 'method-not-allowed', 'PATCH /v1/samples')
        self.assertIn('POST', wrong.headers['allow'])
        self.assertProblem(self.server.curl('/livez', '-X', 'DELETE'), 405, 'method-not-allowed')

    def test_a_wrapped_mesh_is_refused_by_name(self):
        for kind in ('multipart/form-data; boundary=x', 'application/json'):
            answer = self.server.curl('/v1/samples', '-H', f'Content-Type: {kind}', body=CUBE)
            self.assertProblem(answer, 415, 'unsupported-media-type', kind)


class Operations(ServerCase):

    def test_a_request_id_comes_back_and_stands_in_the_log(self):
        trace = '00-' + 'ab' * 16 + '-' + 'cd' * 8 + '-01'
        answer = self.server.curl('/livez', '-H', 'X-Request-Id: mine-1',
                                  '-H', f'traceparent: {trace}')
        self.assertEqual(answer.headers['x-request-id'], 'mine-1')
        line = self.server.request_line('mine-1')
        self.assertEqual((line['method'], line['path'], line['status']), ('GET', '/livez', 200))
        self.assertEqual(line['traceparent'], trace)
        odd = self.server.curl('/livez', '-H', 'X-Request-Id: a b"c',
                               '-H', 'traceparent: 00-x')
        made = odd.headers['x-request-id']
        self.assertRegex(made, '^[0-9a-f]{16}$')
        self.assertNotIn('traceparent', self.server.request_line(made))

    def test_metrics_count_what_was_asked(self):
        def counted():
            return self.server.metric('strata_requests_total{endpoint="/v1/samples",'
                                      'protocol="http",status="200"}')
        before = counted()
        jobs = self.server.metric('strata_jobs_total{outcome="succeeded"}')
        self.server.curl('/v1/samples?resolution=4', body=CUBE)
        harness.wait_until(lambda: counted() == before + 1, 'the request to be counted')
        self.assertEqual(self.server.metric('strata_jobs_total{outcome="succeeded"}'), jobs + 1)
        text = self.server.curl('/metrics')
        self.assertTrue(text.headers['content-type'].startswith('text/plain; version=0.0.4'))
        for line in text.body.decode().splitlines():
            self.assertRegex(line, r'^(# (HELP|TYPE) \w+ .+|\w+(\{[^}]*\})? -?[0-9.e+Inf-]+)$')

    def test_the_openapi_names_every_endpoint_and_option(self):
        api = self.server.curl('/openapi.json').json()
        self.assertEqual(api['openapi'], '3.1.0')
        self.assertEqual(set(api['paths']), set(harness.routes()))
        options = {p['name'] for p in api['paths']['/v1/samples']['post']['parameters']
                   if p.get('in') == 'query'}
        self.assertEqual(options, harness.sample_option_names())

    def test_head_answers_without_a_body(self):
        answer = self.server.exchange(b'HEAD /livez HTTP/1.1\r\nHost: localhost\r\n'
                                      b'Connection: close\r\n\r\n')
        self.assertTrue(answer.startswith(b'HTTP/1.1 200'))
        self.assertTrue(answer.endswith(b'\r\n\r\n'))
        self.assertIn(b'Content-Length: 3', answer)

    def test_several_requests_share_a_connection(self):
        raw = self.server.exchange(b'GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n'
                                   b'GET /readyz HTTP/1.1\r\nHost: localhost\r\n\r\n'
                                   b'GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n')
        self.assertEqual(len(re.findall(b'HTTP/1.1 200 OK', raw)), 3)


class Viewer(ServerCase):

    def files(self):
        """Path on the server, path in the source, of every file of the viewer."""
        dist = pathlib.Path(harness.ARGUMENTS['source']) / 'server/viewer/dist'
        found = [(f'/{file.relative_to(dist)}', file) for file in dist.rglob('*') if file.is_file()]
        self.assertGreater(len(found), 5)
        return [('/' if path == '/index.html' else path, file) for path, file in found]

    def test_every_file_is_served_as_it_is_built(self):
        types = {'.html': 'text/html; charset=utf-8', '.js': 'text/javascript; charset=utf-8',
                 '.css': 'text/css; charset=utf-8', '.svg': 'image/svg+xml',
                 '.wasm': 'application/wasm', '.txt': 'text/plain; charset=utf-8'}
        for path, file in self.files():
            answer = self.server.curl(path)
            self.assertEqual(answer.status, 200, path)
            self.assertTrue(answer.body == file.read_bytes(), path)
            self.assertEqual(answer.headers['content-type'], types[file.suffix], path)

    def test_what_a_browser_has_is_not_sent_again(self):
        for path, file in self.files():
            tag = f'"{hashlib.sha256(file.read_bytes()).hexdigest()}"'
            answer = self.server.curl(path, '-H', f'If-None-Match: {tag}')
            self.assertEqual((answer.status, answer.body), (304, b''), path)
            self.assertEqual(answer.headers['etag'], tag)
            self.assertEqual(answer.headers['cache-control'], 'no-cache')
            self.assertEqual(self.server.curl(path, '-H', 'If-None-Match: "x"').status, 200)

    def test_the_page_may_load_from_its_server_alone(self):
        policy = self.server.curl('/').headers['content-security-policy']
        self.assertIn("default-src 'none'", policy)
        sources = {word for rule in policy.split(';') for word in rule.split()[1:]}
        self.assertEqual(sources, {"'none'", "'self'", "'wasm-unsafe-eval'"})

    def test_other_names_are_not_found(self):
        for path in ('/assets/', '/assets/none.js', '/assets/../index.html', '/index.html',
                     '/assets/%2e%2e/%2e%2e/CMakeLists.txt'):
            self.assertProblem(self.server.curl(path, '--path-as-is'), 404, 'no-such-endpoint')
        self.assertProblem(self.server.curl('/', body=b'x'), 405, 'method-not-allowed', 'GET')


if __name__ == '__main__':
    harness.main()
