#!/usr/bin/env python3
"""Batches over the repository of the service: the same outputs and manifest as the command's, progress,
cancel, and a service that is killed in the middle."""
import json
import pathlib
import signal
import sys
import unittest

import batch_harness
from batch_harness import cube, is_alive, unmeasured, wait_until

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / 'serve'))
import harness  # noqa: E402  The service's own.


class ServiceTest(batch_harness.BatchTest):
    def setUp(self):
        super().setUp()
        harness.ARGUMENTS['strata'] = batch_harness.OPTIONS.strata
        self.data = self.path / 'data'

    def serve(self, *options):
        server = harness.Server('--data', str(self.data), '--models', str(self.repo),
                                '--memory', '1G', *options)
        self.addCleanup(lambda: server.process.poll() is None and server.stop(signal.SIGKILL))
        return server

    @staticmethod
    def ask(server, path, *options, body=None):
        answer = server.curl(path, *options, body=None if body is None else
                             (body if isinstance(body, bytes) else json.dumps(body).encode()))
        return answer.status, json.loads(answer.body) if answer.body else None

    def create(self, server, **request):
        status, batch = self.ask(server, '/v1/batches', '-H', 'Content-Type: application/json',
                                 body=request)
        self.assertEqual(status, 202, batch)
        return batch['id']

    def ended(self, server, number):
        def look():
            status, batch = self.ask(server, f'/v1/batches/{number}')
            self.assertEqual(status, 200)
            return batch if batch['state'] not in ('queued', 'running') else None
        return wait_until(look, 'the batch to end')

    def manifest(self, server, number):
        text = server.curl(f'/v1/batches/{number}/manifest').body.decode()
        return {line['path']: line for line in map(json.loads, text.splitlines())}


class Batches(ServiceTest):
    def test_do_as_the_command_does(self):
        self.put_cubes(12)
        self.put('sub/strata.toml', 'lambda = 2\n')
        self.put('sub/x.off', cube(77))
        self.put('bad.off', 'OFF\n1')
        self.batch('--resolution', '12', '--format', 'ply', status=1)
        server = self.serve()
        number = self.create(server, options={'resolution': 12, 'format': 'ply'})
        batch = self.ended(server, number)
        self.assertEqual((batch['state'], batch['models'], batch['sampled'],
                          batch['failed_models']), ('failed', '14', '13', '1'))
        self.assertNotIn('error', batch, 'it came to its end')
        lines = self.manifest(server, number)
        expected = unmeasured(batch_harness.manifest(self.out))
        self.assertEqual(unmeasured(lines), expected)
        for path, line in lines.items():
            if line['status'] == 'sampled':
                got = server.curl(f'/v1/batches/{number}/output?path={line["output"]}')
                self.assertEqual(got.body, (self.out / line['output']).read_bytes(), path)
        events = server.curl(f'/v1/batches/{number}/events').body.decode()
        self.assertEqual(events.count('event: batch'), 1, 'it has ended')
        head = server.exchange(f'HEAD /v1/batches/{number}/events HTTP/1.1\r\n'
                               'Host: localhost\r\n\r\n'.encode())
        self.assertTrue(head.endswith(b'\r\n\r\n'), head)
        for path in ('.strata/progress.json', '../batch.json', 'manifest.jsonl', 'absent', ''):
            status, problem = self.ask(server, f'/v1/batches/{number}/output?path={path}')
            self.assertIn(status, (400, 404), f'{path}: {problem}')
        second = self.create(server, options={'resolution': 12}, include=['sub/**'])
        self.assertEqual(self.ended(server, second)['state'], 'succeeded')
        status, page = self.ask(server, '/v1/batches?page_size=1')
        self.assertEqual([each['id'] for each in page['batches']], [second])
        status, page = self.ask(server, f'/v1/batches?page_token={page["next_page_token"]}')
        self.assertEqual([each['id'] for each in page['batches']], [number])
        self.assertEqual(server.stop(), 0)

    def test_wrong_requests_are_refused(self):
        server = self.serve()
        for request in ({'options': {'resolution': 0}}, {'include': ['']}, {'nothing': 1}):
            status, problem = self.ask(server, '/v1/batches', '-H',
                                       'Content-Type: application/json', body=request)
            self.assertEqual(status, 400, problem)
        for path in ('', '/events', '/manifest', '/output?path=x'):
            status, problem = self.ask(server, f'/v1/batches/{"0" * 32}{path}')
            self.assertEqual(status, 404, problem)
        self.assertEqual(server.stop(), 0)
        without = harness.Server()
        status, problem = self.ask(without, '/v1/batches')
        self.assertEqual((status, problem['type']), (501, '/problems/not-implemented'))
        without.stop()

    def hard(self):
        for i in range(6):
            self.make_mesh(f'{i}.ply', 60_000 + i)
        return {'options': {'resolution': 300, 'lambda': 20}}

    def test_one_that_is_cancelled_ends_and_keeps_what_it_had_finished(self):
        server = self.serve('--jobs', '1')  # One model after the other.
        self.put('a/small.off')
        self.put('a/strata.toml', 'resolution = 8\n')
        for i in range(6):
            self.make_mesh(f'hard/{i}.ply', 60_000 + i)
        self.put('hard/strata.toml', 'resolution = 1000\nlambda = 20\n')  # Seconds for each.
        request = {'options': {}}
        number = self.create(server, **request)
        waiting = self.create(server, **request)
        wait_until(lambda: self.ask(server, f'/v1/batches/{number}')[1].get('sampled'),
                   'the first model')
        status, batch = self.ask(server, f'/v1/batches/{waiting}', '-X', 'DELETE')
        self.assertEqual(batch['state'], 'cancelled')
        self.ask(server, f'/v1/batches/{number}', '-X', 'DELETE')
        self.assertEqual(self.ended(server, number)['state'], 'cancelled')
        lines = self.manifest(server, number)
        self.assertTrue(0 < len(lines) < 7, lines.keys())
        wait_until(lambda: not server.children(), 'its process to end')
        self.assertEqual(server.stop(), 0)

    def test_one_goes_on_when_the_service_was_killed(self):
        request = self.hard()
        self.batch('--resolution', '300', '--lambda', '20')
        for end in (signal.SIGKILL, signal.SIGTERM):
            server = self.serve()
            number = self.create(server, **request)
            wait_until(lambda: self.ask(server, f'/v1/batches/{number}')[1].get('sampled'),
                       'the first model')
            before = self.manifest(server, number)
            children = server.children()
            server.stop(end)
            wait_until(lambda: not any(map(is_alive, children)), 'the batch to end with its service')
            server = self.serve()
            batch = self.ended(server, number)
            self.assertEqual(batch['state'], 'succeeded', batch)
            lines = self.manifest(server, number)
            for path, line in before.items():
                self.assertEqual(lines[path], line, 'done again though it was finished')
            self.assertEqual(unmeasured(lines), unmeasured(batch_harness.manifest(self.out)))
            server.stop()


if __name__ == '__main__':
    batch_harness.main()
