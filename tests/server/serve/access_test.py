#!/usr/bin/env python3
"""Who may ask: keys, TLS, certificates; and how the service is configured."""
import pathlib
import subprocess
import tempfile
import unittest

import grpc

import harness
from harness import CUBE, Answer, Server, ServerCase, make_key, strata

SAMPLE = '/strata.v1.Sampling/Sample'


def run_serve(*options, cwd):
    """A service that is expected not to start: (exit status, message)."""
    done = subprocess.run([strata(), 'serve', *options], capture_output=True, text=True, cwd=cwd,
                          timeout=harness.PATIENCE)
    return done.returncode, done.stderr


class Keys(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.full, full_line = make_key('team')
        cls.read, read_line = make_key('viewer', 'read')
        cls.lines = full_line + read_line
        keys = pathlib.Path(cls.folder.name) / 'keys'
        keys.write_text('# who may ask\n\n' + cls.lines)
        cls.server = Server('--keys', str(keys), '--log-level', 'debug')

    @classmethod
    def tearDownClass(cls):
        cls.server.stop()
        cls.folder.cleanup()

    def ask(self, path, key=None, body=None, scheme='Bearer'):
        options = ['-H', f'Authorization: {scheme} {key}'] if key else []
        return self.server.curl(path, *options, body=body)

    def test_a_full_key_may_sample_and_a_read_key_may_look(self):
        path = '/v1/samples?resolution=3'
        self.assertEqual(self.ask(path, self.full, CUBE).status, 200)
        self.assertEqual(self.ask(path, self.full, CUBE, 'bearer').status, 200)
        ServerCase.assertProblem(self, self.ask(path, self.read, CUBE), 403, 'forbidden', 'viewer')
        for key in (self.full, self.read):
            self.assertEqual(self.ask('/metrics', key).status, 200)

    def test_without_a_known_key_only_health_and_the_contract_are_open(self):
        for path, body in (('/metrics', None), ('/v1/samples', CUBE)):
            for key in (None, 'x', self.full[:-1], self.full + '0', self.lines.split()[0]):
                answer = self.ask(path, key, body)
                ServerCase.assertProblem(self, answer, 401, 'unauthenticated')
                self.assertEqual(answer.headers['www-authenticate'], 'Bearer')
        for path in ('/livez', '/readyz', '/openapi.json'):
            self.assertEqual(self.ask(path).status, 200)

    def test_the_log_names_the_key_and_never_shows_it(self):
        self.server.curl('/metrics', '-H', f'Authorization: Bearer {self.full}',
                         '-H', 'X-Request-Id: keyed')
        self.assertEqual(self.server.request_line('keyed')['caller'], 'team')
        for key in (self.full, self.read):
            self.assertNotIn(key.removeprefix('strata_'), str(self.server.log))

    @harness.needs_grpc
    def test_grpc_asks_for_the_same_keys(self):
        with grpc.insecure_channel(f'127.0.0.1:{self.server.grpc_port}') as channel:
            call = channel.stream_stream(SAMPLE)
            for key, code in ((None, grpc.StatusCode.UNAUTHENTICATED),
                              ('x', grpc.StatusCode.UNAUTHENTICATED),
                              (self.read, grpc.StatusCode.PERMISSION_DENIED),
                              (self.full, grpc.StatusCode.INVALID_ARGUMENT)):
                metadata = [('authorization', f'Bearer {key}')] if key else []
                with self.assertRaises(grpc.RpcError) as caught:
                    list(call(iter([]), metadata=metadata, timeout=harness.PATIENCE))
                self.assertEqual(caught.exception.code(), code, key)

    def test_the_file_holds_no_key(self):
        for key in (self.full, self.read):
            self.assertNotIn(key, self.lines)
            self.assertNotIn(key.removeprefix('strata_'), self.lines)


def ask_raw(server, host, method='GET', path='/livez', headers=(), body=b''):
    """One request as a browser would send it: `host` is the header's value, None for no header."""
    lines = [f'{method} {path} HTTP/1.1', *([f'Host: {host}'] if host is not None else []),
             *headers, f'Content-Length: {len(body)}', 'Connection: close', '', '']
    return Answer.parse(server.exchange('\r\n'.join(lines).encode() + body))


class OtherSites(ServerCase):
    """A service without keys, and what a browser sends it for the pages of strangers."""
    options = ('--allowed-host', 'Meshes.example', '--allowed-host', '192.0.2.7')

    def sample(self, host, *headers):
        return ask_raw(self.server, host, 'POST', '/v1/samples?resolution=3&format=ply', headers,
                       CUBE)

    def test_loopbacks_names_and_the_allowed_ones_are_answered_with_any_port(self):
        for name in ('localhost', 'LocalHost.', '127.0.0.1', '127.9.8.7', '[::1]',
                     '[0:0:0:0:0:0:0:1]', 'meshes.example', 'MESHES.example.', '192.0.2.7'):
            for port in ('', ':', ':80', f':{self.server.http_port}'):
                with self.subTest(host=name + port):
                    self.assertEqual(ask_raw(self.server, name + port).status, 200)

    def test_a_name_that_somebody_points_here_gets_nothing(self):
        for host in ('evil.example', f'evil.example:{self.server.http_port}',
                     '127.0.0.1.evil.example', 'localhost.evil.example', 'evil.localhost',
                     'evil.example:localhost',
                     'evil.example@localhost', 'localhost@evil.example', '192.0.2.8', '[::2]',
                     '0.0.0.0', '10.0.0.1', '127.1', 'x.meshes.example', ''):
            with self.subTest(host=host):
                for method, path in (('GET', '/'), ('GET', '/livez'), ('GET', '/metrics'),
                                     ('GET', '/nowhere'), ('POST', '/v1/samples?resolution=3')):
                    answer = ask_raw(self.server, host, method, path)
                    self.assertProblem(answer, 421, 'misdirected-request', '--allowed-host')

    def test_a_page_of_another_site_changes_nothing(self):
        port = self.server.http_port
        for headers in (['Origin: http://evil.example'], ['Origin: null'],
                        [f'Origin: http://localhost:{port + 1}'], ['Origin: http://localhost'],
                        [f'Origin: localhost:{port}'], ['Sec-Fetch-Site: cross-site'],
                        [f'Origin: http://localhost:{port}', 'Sec-Fetch-Site: Cross-Site'],
                        [f'Origin: http://127.0.0.1:{port}']):
            with self.subTest(headers=headers):
                host = f'localhost:{port}'
                self.assertProblem(self.sample(host, *headers), 403, 'cross-site')
                for method, path in (('DELETE', '/v1/models/x'), ('PUT', '/v1/models/x'),
                                     ('PATCH', '/v1/uploads/x'), ('POST', '/v1/jobs')):
                    self.assertProblem(ask_raw(self.server, host, method, path, headers), 403,
                                       'cross-site')

    def test_its_own_pages_links_from_elsewhere_and_programs_are_served(self):
        host = f'localhost:{self.server.http_port}'
        for headers in ([], [f'Origin: http://{host}'],
                        [f'Origin: http://{host.upper()}', 'Sec-Fetch-Site: same-origin'],
                        ['Sec-Fetch-Site: none']):
            answer = self.sample(host, *headers)
            self.assertEqual((answer.status, answer.body[:4]), (200, b'ply\n'), answer.body[:300])
        proxied = self.sample('meshes.example', 'Origin: https://meshes.example')
        self.assertEqual(proxied.status, 200)
        link = ['Sec-Fetch-Site: cross-site', 'Sec-Fetch-Mode: navigate']
        self.assertEqual(ask_raw(self.server, host, path='/', headers=link).status, 200)

    def test_the_address_that_it_listens_on_is_a_name_of_its_own(self):
        server = Server('--http', '0.0.0.0:0', '--insecure')
        self.addCleanup(server.stop)
        for host in ('localhost', '192.0.2.8:81', '[2001:db8::1]'):
            self.assertEqual(ask_raw(server, host).status, 200)
        self.assertProblem(ask_raw(server, 'evil.example'), 421, 'misdirected-request')

    def test_with_keys_the_key_decides(self):
        with tempfile.TemporaryDirectory() as folder:
            keys = pathlib.Path(folder) / 'keys'
            key, line = make_key('team')
            keys.write_text(line)
            server = Server('--keys', str(keys))
            self.addCleanup(server.stop)
        headers = [f'Authorization: Bearer {key}', 'Origin: http://elsewhere.example']
        path = '/v1/samples?resolution=3'
        self.assertEqual(ask_raw(server, 'any.example', 'POST', path, headers, CUBE).status, 200)
        self.assertProblem(ask_raw(server, 'any.example', 'POST', path, headers[1:], CUBE), 401,
                           'unauthenticated')


class Tls(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.at = pathlib.Path(cls.folder.name)
        cls.authority('ca')
        cls.authority('other')
        cls.certificate('server', 'ca')
        cls.certificate('client', 'ca')
        cls.certificate('stranger', 'other')

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    @classmethod
    def openssl(cls, *arguments):
        subprocess.run(['openssl', *arguments], cwd=cls.at, check=True, capture_output=True)

    @classmethod
    def authority(cls, name):
        cls.openssl('req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256',
                    '-nodes', '-keyout', f'{name}.key', '-out', f'{name}.pem', '-subj',
                    f'/CN={name}', '-days', '2')

    @classmethod
    def certificate(cls, name, authority):
        (cls.at / 'extension').write_text('subjectAltName=DNS:localhost,IP:127.0.0.1\n')
        cls.openssl('req', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:P-256', '-nodes',
                    '-keyout', f'{name}.key', '-out', f'{name}.csr', '-subj', f'/CN={name}')
        cls.openssl('x509', '-req', '-in', f'{name}.csr', '-CA', f'{authority}.pem', '-CAkey',
                    f'{authority}.key', '-CAcreateserial', '-out', f'{name}.pem', '-days', '2',
                    '-extfile', 'extension')

    def serve(self, *options):
        server = Server('--tls-certificate', str(self.at / 'server.pem'), '--tls-key',
                        str(self.at / 'server.key'), *options)
        self.addCleanup(server.stop)
        return server

    def curl(self, server, *options):
        """curl's exit status and what it printed."""
        done = subprocess.run(
            ['curl', '--silent', '--max-time', '60', '--cacert', 'ca.pem', *options,
             '--data-binary', '@-', f'https://localhost:{server.http_port}/v1/samples?resolution=9'
             '&format=ply'], cwd=self.at, input=CUBE, capture_output=True)
        return done.returncode, done.stdout

    def rpc_code(self, server, *client):
        read = [(self.at / name).read_bytes() for name in ('ca.pem', *client)]
        credentials = grpc.ssl_channel_credentials(read[0], *read[1:])
        with grpc.secure_channel(f'localhost:{server.grpc_port}', credentials) as channel:
            with self.assertRaises(grpc.RpcError) as caught:
                list(channel.stream_stream(SAMPLE)(iter([]), timeout=harness.PATIENCE))
            return caught.exception.code()

    def test_both_protocols_speak_tls(self):
        server = self.serve()
        status, body = self.curl(server)
        self.assertEqual(status, 0)
        self.assertTrue(body.startswith(b'ply\n'))
        if harness.GRPC:
            self.assertEqual(self.rpc_code(server), grpc.StatusCode.INVALID_ARGUMENT)
        plain = server.exchange(b'GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n')
        self.assertFalse(plain.startswith(b'HTTP'), plain)
        self.assertEqual(self.curl(server, '--tls-max', '1.1')[0], 35)

    def test_a_key_of_another_certificate_is_refused_whichever_protocol_is_on(self):
        for http, rpc in (('off', '127.0.0.1:0'), ('127.0.0.1:0', 'off')):
            done = subprocess.run([strata(), 'serve', '--http', http, '--grpc', rpc,
                                   '--tls-certificate', 'server.pem', '--tls-key', 'client.key'],
                                  cwd=self.at, capture_output=True, text=True, timeout=60)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn('client.key', done.stderr)

    def test_with_a_client_ca_only_its_clients_come_in(self):
        server = self.serve('--tls-client-ca', str(self.at / 'ca.pem'))
        self.assertEqual(self.curl(server, '--cert', 'client.pem', '--key', 'client.key')[0], 0)
        self.assertNotEqual(self.curl(server)[0], 0)
        self.assertNotEqual(
            self.curl(server, '--cert', 'stranger.pem', '--key', 'stranger.key')[0], 0)
        if harness.GRPC:
            self.assertEqual(self.rpc_code(server, 'client.key', 'client.pem'),
                             grpc.StatusCode.INVALID_ARGUMENT)
            self.assertEqual(self.rpc_code(server), grpc.StatusCode.UNAVAILABLE)
            self.assertEqual(self.rpc_code(server, 'stranger.key', 'stranger.pem'),
                             grpc.StatusCode.UNAVAILABLE)


class Configuration(unittest.TestCase):

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.at = pathlib.Path(self.folder.name)

    def assertRefused(self, words, *options, status=2):
        found, message = run_serve(*options, cwd=self.at)
        self.assertEqual(found, status, message)
        self.assertIn(words, message)

    def test_beyond_loopback_needs_keys_or_a_word(self):
        self.assertRefused('--insecure', '--http', '0.0.0.0:0', '--grpc', 'off')
        self.assertRefused('--insecure', '--http', 'off', '--grpc', '[::]:0')
        server = Server('--http', '0.0.0.0:0', '--insecure')
        self.assertEqual(server.curl('/livez').status, 200)
        server.stop()

    def test_options_out_of_range_are_named(self):
        for words, options in [
                ("--http: found 'x', expected ADDRESS:PORT or off", ['--http', 'x']),
                ("--http: found '1.2.3.4:99999'", ['--http', '1.2.3.4:99999']),
                ('both off', ['--http', 'off', '--grpc', 'off']),
                ("--jobs: found '0', expected a whole number from 1 to 1024", ['--jobs', '0']),
                ("--body-size: found 'big'", ['--body-size', 'big']),
                ("--isolate: found 'maybe', expected on or off", ['--isolate', 'maybe']),
                ('--job-memory is more than --memory', ['--memory', '64M', '--job-memory', '1G']),
                ('give both or none', ['--tls-key', 'x']),
                ("--allowed-host: found 'http://x', expected a host's name",
                 ['--allowed-host', 'y', '--allowed-host', 'http://x']),
                ('--nonsense', ['--nonsense', '1'])]:
            self.assertRefused(words, *options)

    def test_files_that_do_not_fit_are_named(self):
        self.assertRefused('nowhere.toml', '--config', 'nowhere.toml', status=3)
        self.assertRefused('nokeys', '--keys', 'nokeys', status=3)
        (self.at / 'keys').write_text('abc full me\n')
        self.assertRefused('keys, line 1', '--keys', 'keys')
        self.assertRefused('nocert', '--tls-certificate', 'nocert', '--tls-key', 'nokey')
        for text, words in [('jobs = 0\n', "strata.toml, line 1: jobs: found '0'"),
                            ('\n\nbody-size = "4Q"\n', "line 3: body-size: found '4Q'"),
                            ('allowed-host = ["a", 1.5]\n', 'line 1: allowed-host: expected'),
                            ('jobs =\n', 'line 1'),
                            ('\njob = 1\n', "line 2: unknown option 'job'; did you mean 'jobs'"),
                            ('jobs = [1]\n', 'line 1: jobs: expected')]:
            (self.at / 'strata.toml').write_text(text)
            self.assertRefused(words)

    def test_the_command_line_goes_before_the_file(self):
        server = Server('--body-size', '100K', config='body-size = "10"\nheader-fields = 5\n')
        self.addCleanup(server.stop)
        self.assertEqual(server.curl('/v1/samples?resolution=3', body=CUBE).status, 200)
        many = [word for i in range(9) for word in ('-H', f'A{i}: b')]
        self.assertEqual(server.curl('/livez', *many).status, 431)

    def test_allowed_hosts_stand_in_the_file_as_a_name_or_a_list(self):
        for text, names in (('"a.example"', ['a.example']),
                            ('["a.example", "b"]', ['a.example', 'b'])):
            server = Server(config=f'allowed-host = {text}\n')
            self.addCleanup(server.stop)
            for name in names:
                self.assertEqual(ask_raw(server, name).status, 200)
            self.assertEqual(ask_raw(server, 'c').status, 421)

    def test_a_port_in_use_is_said(self):
        server = Server()
        self.addCleanup(server.stop)
        taken = f'127.0.0.1:{server.http_port}'
        self.assertRefused('cannot listen', '--http', taken, '--grpc', 'off', status=8)
        self.assertRefused('cannot listen', '--grpc', taken, '--http', 'off', status=8)

    def test_every_option_stands_in_the_help_and_the_manual_with_its_default(self):
        shown = subprocess.run([strata(), 'serve', '--help'], capture_output=True, text=True)
        self.assertEqual(shown.returncode, 0)
        source = pathlib.Path(harness.ARGUMENTS['source'])
        table = (source / 'server/serve_option_table.cc').read_text()
        names = harness.re.findall(r'\{"([a-z0-9-]+)", "[^"]+", k[A-Z]', table)
        self.assertGreater(len(names), 25)
        helped = harness.re.findall(r'^  --([a-z0-9-]+) .*\n(?: {20}.*\n)*? +Default (.+)\.$',
                                    shown.stdout, harness.re.M)
        self.assertEqual([name for name, _ in helped], names)
        manual = (source / 'docs/http.md').read_text()
        rows = harness.re.findall(r'^\| `([a-z0-9-]+)` \| .+ \| (.+) \|$', manual, harness.re.M)
        written = {name: default.strip('`') for name, default in rows}
        for name, default in helped:
            self.assertEqual((name, written.get(name)), (name, default))

    def test_the_default_limits_of_headers_and_bodies_are_in_force(self):
        self.assertRefused('--insecure', '--http', '0.0.0.0:0')  # insecure: off.
        server = Server()
        self.addCleanup(server.stop)
        many = [word for i in range(64) for word in ('-H', f'A{i}: b')]
        self.assertEqual(server.curl('/livez', *many).status, 431)  # header-fields: 64.
        self.assertEqual(server.curl('/livez', *many[:120]).status, 200)
        large = ['-H', 'A: ' + 'x' * (16 << 10)]
        self.assertEqual(server.curl('/livez', *large).status, 431)  # header-size: 16K.
        length = ['Content-Length: 4294967297', 'Expect: 100-continue']  # body-size: 4G.
        answer = Answer.parse(server.exchange(
            '\r\n'.join(['POST /v1/samples?resolution=3 HTTP/1.1', 'Host: localhost', *length, '',
                         '']).encode()))
        self.assertEqual(answer.status, 413)


if __name__ == '__main__':
    harness.main()
