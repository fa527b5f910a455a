#!/usr/bin/env python3
"""Who may ask: keys, TLS, certificates; and how the service is configured."""
import pathlib
import subprocess
import tempfile
import unittest

import grpc

import harness
from harness import CUBE, Server, ServerCase, strata

SAMPLE = '/strata.v1.Sampling/Sample'


def make_key(name, role='full'):
    """(key, line) as `strata key` prints them."""
    done = subprocess.run([strata(), 'key', name, '--role', role], capture_output=True, text=True,
                          check=True)
    return done.stderr.split()[-1], done.stdout


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
                list(channel.stream_stream(SAMPLE)(iter([]), timeout=10))
            return caught.exception.code()

    def test_both_protocols_speak_tls(self):
        server = self.serve()
        status, body = self.curl(server)
        self.assertEqual(status, 0)
        self.assertTrue(body.startswith(b'ply\n'))
        self.assertEqual(self.rpc_code(server), grpc.StatusCode.INVALID_ARGUMENT)
        plain = server.exchange(b'GET /livez HTTP/1.1\r\nHost: x\r\n\r\n')
        self.assertFalse(plain.startswith(b'HTTP'), plain)
        self.assertEqual(self.curl(server, '--tls-max', '1.1')[0], 35)

    def test_with_a_client_ca_only_its_clients_come_in(self):
        server = self.serve('--tls-client-ca', str(self.at / 'ca.pem'))
        self.assertEqual(self.curl(server, '--cert', 'client.pem', '--key', 'client.key')[0], 0)
        self.assertNotEqual(self.curl(server)[0], 0)
        self.assertNotEqual(
            self.curl(server, '--cert', 'stranger.pem', '--key', 'stranger.key')[0], 0)
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
                ('--nonsense', ['--nonsense', '1'])]:
            self.assertRefused(words, *options)

    def test_files_that_do_not_fit_are_named(self):
        self.assertRefused('nowhere.toml', '--config', 'nowhere.toml', status=3)
        self.assertRefused('nokeys', '--keys', 'nokeys', status=3)
        (self.at / 'keys').write_text('abc full me\n')
        self.assertRefused('keys, line 1', '--keys', 'keys')
        self.assertRefused('nocert', '--tls-certificate', 'nocert', '--tls-key', 'nokey')
        for text, words in [('jobs = 0\n', "--jobs: found '0'"), ('jobs =\n', 'line 1'),
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

    def test_a_port_in_use_is_said(self):
        server = Server()
        self.addCleanup(server.stop)
        self.assertRefused('cannot listen', '--http', f'127.0.0.1:{server.http_port}', '--grpc',
                           'off', status=8)
        self.assertRefused('cannot listen', '--grpc', f'127.0.0.1:{server.grpc_port}', '--http',
                           'off', status=8)

    def test_every_option_stands_in_the_help_and_the_manual_with_its_default(self):
        shown = subprocess.run([strata(), 'serve', '--help'], capture_output=True, text=True)
        self.assertEqual(shown.returncode, 0)
        manual = (pathlib.Path(harness.ARGUMENTS['source']) / 'docs/http.md').read_text()
        table = (pathlib.Path(harness.ARGUMENTS['source']) /
                 'server/serve_option_table.cc').read_text()
        names = harness.re.findall(r'\{"([a-z-]+)", "[^"]+", k[A-Z]', table)
        self.assertGreater(len(names), 25)
        for name in names:
            self.assertIn(f'--{name} ', shown.stdout)
            self.assertIn(f'| `{name}` |', manual)


if __name__ == '__main__':
    harness.main()
