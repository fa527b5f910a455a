#!/usr/bin/env python3
"""What manages the service: systemd's notifications, `strata health`, `strata key --help`."""
import os
import pathlib
import select
import signal
import socket
import subprocess
import tempfile
import unittest

import harness
from harness import Server, strata, wait_until


def health(*arguments):
    """(exit status, what it says)."""
    if '--timeout' not in arguments:  # A busy machine may need longer than people wait for it.
        arguments = (*arguments, '--timeout', str(int(harness.PATIENCE)))
    done = subprocess.run([strata(), 'health', *arguments], capture_output=True, text=True,
                          timeout=2 * harness.PATIENCE)
    return done.returncode, done.stdout + done.stderr


class Health(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.server = Server()
        cls.addClassCleanup(cls.server.stop)

    def url(self, path=''):
        return f'http://127.0.0.1:{self.server.http_port}{path}'

    def test_a_service_that_lives_is_answered_with_silence(self):
        for path in ('', '/livez', '/readyz'):
            self.assertEqual(health(self.url(path)), (0, ''))
        self.assertEqual(health(f'http://localhost:{self.server.http_port}'), (0, ''))

    def test_any_answer_but_200_is_a_failure_that_shows_it(self):
        status, said = health(self.url('/nothing'))
        self.assertEqual(status, 8)
        self.assertIn("/nothing was answered with 'HTTP/1.1 404", said)

    def test_nobody_there_is_a_failure(self):
        with socket.socket() as free:
            free.bind(('127.0.0.1', 0))  # Bound, not listening: connections are refused.
            status, said = health(f'http://127.0.0.1:{free.getsockname()[1]}')
        self.assertEqual((status, 'refused' in said), (8, True), said)

    def test_somebody_who_says_nothing_is_not_waited_for(self):
        with socket.create_server(('127.0.0.1', 0)) as silent:
            status, said = health(f'http://127.0.0.1:{silent.getsockname()[1]}', '--timeout', '1')
        self.assertEqual((status, 'timed out' in said), (8, True), said)

    def test_what_is_no_url_is_refused(self):
        for url in ('127.0.0.1:8080', 'ftp://a', 'http://', 'http://a:b', 'http://a:', 'http://a:123456',
                    'http://a b', 'http://a/\r\nX: y'):
            status, said = health(url)
            self.assertEqual((status, 'expected http://HOST' in said), (2, True), url + said)

    def test_the_tools_print_their_help_and_do_nothing(self):
        for tool in ('key', 'health'):
            done = subprocess.run([strata(), tool, '--help'], capture_output=True, text=True)
            self.assertEqual((done.returncode, done.stderr), (0, ''))
            self.assertIn(f'Usage: strata {tool}', done.stdout)

    def test_a_key_needs_a_name_and_a_role_that_exists(self):
        for arguments in ([], ['a b'], ['team', '--role', 'king'], ['one', 'two']):
            done = subprocess.run([strata(), 'key', *arguments], capture_output=True, text=True)
            self.assertEqual((done.returncode, done.stdout), (2, ''), arguments)


class HealthUnderTls(unittest.TestCase):

    def test_a_certificate_is_taken_as_it_is(self):
        with tempfile.TemporaryDirectory() as folder:
            key, certificate = (str(pathlib.Path(folder) / name) for name in ('key', 'certificate'))
            subprocess.run(['openssl', 'req', '-x509', '-newkey', 'rsa:2048', '-nodes', '-subj',
                            '/CN=localhost', '-keyout', key, '-out', certificate],
                           check=True, capture_output=True)
            server = Server('--tls-certificate', certificate, '--tls-key', key)
            self.addCleanup(server.stop)
            self.assertEqual(health(f'https://127.0.0.1:{server.http_port}/readyz'), (0, ''))
            status, _ = health(f'http://127.0.0.1:{server.http_port}')
            self.assertEqual(status, 8)


class Notifications(unittest.TestCase):

    def receive(self, listener):
        readable, _, _ = select.select([listener], [], [], harness.PATIENCE)
        self.assertTrue(readable, 'no notification came')
        return listener.recv(1024)

    def test_systemd_hears_when_it_serves_and_when_it_ends(self):
        with tempfile.TemporaryDirectory() as folder:
            for name in (f'{folder}/notify', f'\0strata-test-{os.getpid()}'):
                with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
                    listener.bind(name)
                    server = Server(environment={'NOTIFY_SOCKET': name.replace('\0', '@')})
                    self.assertEqual(self.receive(listener), b'READY=1')
                    server.process.send_signal(signal.SIGTERM)
                    self.assertEqual(self.receive(listener), b'STOPPING=1')
                    self.assertEqual(server.stop(), 0)

    def test_a_socket_that_is_not_there_changes_nothing(self):
        for name in ('/nonexistent/notify', '', '@', 'x' * 300):
            server = Server(environment={'NOTIFY_SOCKET': name})
            wait_until(lambda: server.events('serving'), 'the service')
            self.assertEqual(server.stop(), 0)


if __name__ == '__main__':
    harness.main()
