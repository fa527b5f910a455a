#!/usr/bin/env python3
"""What is large or many: an upload of 2 GB, 200 clients at a trickle, 64 jobs at once. No time is
asserted here: tests/bench/serve/load.py measures."""
import concurrent.futures
import os
import pathlib
import re
import tempfile
import threading
import unittest

import harness
from harness import CUBE, Answer, Server, ServerCase, read_to_end

MIB = 1 << 20
SIZE = 2_000_000_000


def peak_bytes(server):
    """The most that was resident since reset_peak."""
    text = pathlib.Path(f'/proc/{server.process.pid}/status').read_text()
    return int(re.search(r'VmHWM:\s+(\d+)', text)[1]) * 1024


def reset_peak(server):
    pathlib.Path(f'/proc/{server.process.pid}/clear_refs').write_text('5')


class Upload(unittest.TestCase):

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        free = os.statvfs(self.folder.name)
        if free.f_bavail * free.f_frsize < 3 * SIZE:
            self.skipTest('less than 6 GB of disk are free')
        self.server = Server('--data', f'{self.folder.name}/data')
        self.addCleanup(self.server.stop)
        # Two gigabytes that take no disk here.
        self.mesh = open(f'{self.folder.name}/sparse', 'w+b')
        self.addCleanup(self.mesh.close)
        self.mesh.truncate(SIZE)

    def send(self, head):
        """The answer to a request with the sparse file as its body, and the peak over idle."""
        self.server.curl('/v1/samples?resolution=3', body=CUBE)
        self.server.curl('/v1/models/small.obj', '-X', 'PUT', body=CUBE)
        reset_peak(self.server)
        idle = self.server.resident_bytes()
        with self.server.connect() as client:
            client.sendall(head + b'Host: localhost\r\nConnection: close\r\n'
                                  b'Content-Length: %d\r\n\r\n' % SIZE)
            self.assertEqual(client.sendfile(self.mesh), SIZE)
            answer = Answer.parse(read_to_end(client))
        over = peak_bytes(self.server) - idle
        print(f'2 GB: {over / MIB:.1f} MiB over idle')
        return answer, over

    def test_a_model_of_two_gigabytes_is_stored_within_64_mib(self):
        answer, over = self.send(b'PUT /v1/models/large.bin HTTP/1.1\r\n')
        self.assertEqual(answer.status, 201, answer.body)
        self.assertLess(over, 64 * MIB)
        self.assertEqual(self.server.curl('/v1/models/large.bin').json()['size_bytes'], str(SIZE))

    def test_a_mesh_of_two_gigabytes_is_received_within_64_mib(self):
        answer, over = self.send(b'POST /v1/samples HTTP/1.1\r\n')
        ServerCase.assertProblem(self, answer, 415, 'unsupported-format')  # Zeros are no mesh.
        self.assertLess(over, 64 * MIB)
        harness.wait_until(lambda: not os.listdir(self.server.path / 'scratch'), 'its file to go')


class Many(unittest.TestCase):

    def test_others_are_served_while_200_clients_send_a_byte_at_a_time(self):
        server = Server()
        self.addCleanup(server.stop)
        clients = [server.connect() for _ in range(200)]
        for client in clients:
            self.addCleanup(client.close)
            client.sendall(b'POST /v1/samples?resolution=3 HTTP/1.1\r\nHost: localhost\r\n'
                           b'Connection: close\r\nContent-Length: %d\r\n\r\n' % len(CUBE))
        for byte in range(20):
            for client in clients:
                client.sendall(CUBE[byte:byte + 1])
            self.assertEqual(server.curl('/livez').status, 200)
            self.assertEqual(server.curl('/v1/samples?resolution=9', body=CUBE).status, 200)
        connected = server.metric('strata_connections{protocol="http"}')
        self.assertGreaterEqual(connected, 200)
        for client in clients:  # They were slow, not wrong.
            client.sendall(CUBE[20:])
        for client in clients:
            self.assertEqual(Answer.parse(read_to_end(client)).status, 200)

    @harness.measures_memory
    def test_64_jobs_at_once_are_all_done_within_the_memory(self):
        memory, jobs = 256 * MIB, 4
        server = Server('--memory', '256M', '--jobs', str(jobs))
        self.addCleanup(server.stop)
        path = '/v1/samples?resolution=250&format=ply'
        expected = server.curl(path, body=CUBE).body
        idle, most = server.resident_bytes(), {'own': 0, 'jobs': 0, 'promised': 0, 'running': 0}
        done = threading.Event()

        def private_bytes(child):
            try:
                text = pathlib.Path(f'/proc/{child}/status').read_text()
                return int(re.search(r'RssAnon:\s+(\d+)', text)[1]) * 1024
            except (OSError, TypeError):
                return 0  # It has ended.

        def look():
            while not done.wait(0.02):
                children = server.children_at_once()
                now = {'own': server.resident_bytes() - idle, 'running': len(children),
                       'jobs': sum(private_bytes(child) for child in children),
                       'promised': server.metric('strata_job_memory_bytes')}
                for name, value in now.items():
                    most[name] = max(most[name], value)
        looking = threading.Thread(target=look)
        looking.start()
        try:
            with concurrent.futures.ThreadPoolExecutor(64) as pool:
                answers = list(pool.map(lambda _: server.curl(path, body=CUBE), range(64)))
        finally:
            done.set()
            looking.join()
        print({name: value if name == 'running' else f'{value / MIB:.0f} MiB'
               for name, value in most.items()})
        self.assertEqual({answer.status for answer in answers}, {200})
        self.assertEqual({answer.body for answer in answers}, {expected})
        self.assertLessEqual(most['promised'], memory)
        self.assertLessEqual(most['running'], jobs)
        self.assertGreater(most['jobs'], 0)
        self.assertLess(most['jobs'], memory)
        self.assertLess(most['own'], 64 * MIB)


if __name__ == '__main__':
    harness.main()
