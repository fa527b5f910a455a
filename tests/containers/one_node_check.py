#!/usr/bin/env python3
"""The image, and docker/compose.yaml: upload, sample, kill, restart, data still there."""
import http.client
import json
import socket
import subprocess
import threading
import unittest

from containers import IMAGE, SOURCE, Project, podman, samples_of_command, wait_until

MOST_BYTES = 150e6
SPOT = (SOURCE / 'models' / 'spot.obj').read_bytes()


class Image(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.image = json.loads(podman('image', 'inspect', IMAGE))[0]

    def test_it_is_small(self):
        print(f'\nimage: {self.image["Size"] / 1e6:.0f} MB')
        self.assertLess(self.image['Size'], MOST_BYTES)

    def test_it_says_what_it_is(self):
        labels = self.image['Labels']
        for name in ('title', 'description', 'licenses', 'version', 'revision', 'created', 'base.name'):
            self.assertIn(f'org.opencontainers.image.{name}', labels)

    def test_it_runs_as_nobody_in_particular_and_ends_at_sigterm(self):
        config = self.image['Config']
        self.assertEqual(config['User'], '10001:10001')
        self.assertEqual(config.get('StopSignal', 'SIGTERM'), 'SIGTERM')
        self.assertEqual(self.image['HealthCheck' if 'HealthCheck' in self.image else 'Healthcheck']['Test'],
                         ['CMD', '/usr/bin/strata', 'health'])

    def test_without_keys_it_does_not_start(self):
        done = subprocess.run(['podman', 'run', '--rm', IMAGE], capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 2)
        self.assertIn('configure --keys', done.stderr)


class OneNode(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.project = cls.enterClassContext(Project('compose.yaml'))
        cls.name = cls.project.container('strata')
        cls.expected = samples_of_command('--format', 'ply', '--resolution', '64')

    def samples(self):
        return self.project.get('GET', '/v1/samples?model=spot.obj&resolution=64&format=ply')

    def start_again(self):
        podman('start', self.name)
        wait_until(self.project.ready, 'the service after its start')

    def test_1_an_upload_is_sampled_with_the_commands_bytes(self):
        self.project.get('PUT', '/v1/models/spot.obj', SPOT)
        self.assertEqual(self.samples(), self.expected)
        self.assertEqual(self.project.get('POST', '/v1/samples?resolution=64&format=ply', SPOT), self.expected)
        self.assertEqual(self.project.run_job('spot.obj', {'resolution': 64, 'format': 'ply'}),
                         self.expected)

    def test_2_without_a_key_nothing_is_told(self):
        self.assertEqual(self.project.request('GET', '/v1/models', headers={'Authorization': ''})[0], 401)

    def test_3_it_is_healthy_and_has_no_rights(self):
        podman('healthcheck', 'run', self.name)
        self.assertEqual(podman('exec', self.name, 'id', '-u'), '10001')
        status = podman('exec', self.name, 'cat', '/proc/1/status')
        self.assertIn('CapEff:\t0000000000000000', status)
        self.assertIn('NoNewPrivs:\t1', status)
        self.assertIn('Name:\tstrata', status)
        for path in ('/x', '/etc/x', '/usr/x', '/etc/strata/x'):
            done = subprocess.run(['podman', 'exec', self.name, 'touch', path], capture_output=True, text=True)
            self.assertIn('Read-only file system', done.stderr, path)

    def test_4_killed_and_started_again_it_has_its_data(self):
        podman('kill', '--signal', 'KILL', self.name)
        wait_until(lambda: podman('inspect', '-f', '{{.State.Running}}', self.name) == 'false', 'its end')
        self.start_again()
        self.assertEqual(self.samples(), self.expected)

    def test_5_sigterm_lets_a_request_in_flight_end(self):
        connection = socket.create_connection(('127.0.0.1', self.project.port), timeout=60)
        self.addCleanup(connection.close)
        connection.sendall(f'POST /v1/samples?resolution=64&format=ply HTTP/1.1\r\nHost: localhost\r\n'
                           f'Authorization: Bearer {self.project.key}\r\nExpect: 100-continue\r\n'
                           f'Content-Length: {len(SPOT)}\r\n\r\n'.encode())
        self.assertIn(b' 100 ', connection.recv(1000))  # From here on it is in flight.
        half = len(SPOT) // 2
        connection.sendall(SPOT[:half])
        stop = threading.Thread(target=lambda: podman('stop', '-t', '45', self.name))
        stop.start()
        wait_until(lambda: not self.project.ready(), 'the service to take no more')
        connection.sendall(SPOT[half:])
        answer = http.client.HTTPResponse(connection)
        answer.begin()
        self.assertEqual((answer.status, answer.read()), (200, self.expected))
        stop.join()
        self.assertEqual(podman('inspect', '-f', '{{.State.ExitCode}}', self.name), '0')
        self.start_again()
        self.assertEqual(self.samples(), self.expected)

    def test_6_made_anew_from_the_image_it_has_its_data(self):
        self.project.compose('down')
        self.project.compose('up', '-d')
        wait_until(self.project.ready, 'the new container')
        self.assertEqual(self.samples(), self.expected)


if __name__ == '__main__':
    unittest.main(verbosity=2)
