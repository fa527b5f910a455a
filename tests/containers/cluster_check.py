#!/usr/bin/env python3
"""docker/compose.cluster.yaml: jobs on workers, a rolling restart under load without a failed request, PostgreSQL
restarted, workers killed; every result with the command's bytes."""
import collections
import json
import subprocess
import threading
import unittest
import uuid

from containers import SOURCE, Project, podman, samples_of_command, wait_until

SPOT = (SOURCE / 'models' / 'spot.obj').read_bytes()
OPTIONS = {'resolution': 64, 'format': 'ply'}
QUERY = 'resolution=64&format=ply'


class Load:
    """Clients that sample directly, read models and make jobs, until told to stop. Counts what came back."""

    def __init__(self, project, expected, allowed=()):
        self.project, self.expected, self.allowed = project, expected, allowed
        self.counts, self.faults, self.jobs = collections.Counter(), [], []
        self.over = threading.Event()
        work = [self.sample, self.sample, self.model, self.job]
        self.threads = [threading.Thread(target=self.repeat, args=(each,)) for each in work]

    def __enter__(self):
        for thread in self.threads:
            thread.start()
        wait_until(lambda: len(self.counts) >= 3, 'the load to flow')
        return self

    def __exit__(self, *_):
        self.over.set()
        for thread in self.threads:
            thread.join()

    def repeat(self, work):
        while not self.over.is_set():
            try:
                status = work()
                self.counts[f'{work.__name__} {status}'] += 1
                if status not in (200, 202, *self.allowed):
                    self.faults.append(f'{work.__name__}: {status}')
            except Exception as error:  # No answer at all is a fault, too.
                self.faults.append(f'{work.__name__}: {error!r}')

    def sample(self):
        status, body = self.project.request('POST', f'/v1/samples?{QUERY}', SPOT)
        if status == 200 and body != self.expected:
            raise AssertionError('other bytes')
        return status

    def model(self):
        return self.project.request('GET', '/v1/models/spot.obj')[0]

    def job(self):
        body = json.dumps({'model': 'spot.obj', 'options': {**OPTIONS, 'seed': str(len(self.jobs) % 7)}}).encode()
        status, answer = self.project.request(
            'POST', '/v1/jobs', body, {'Content-Type': 'application/json', 'Idempotency-Key': str(uuid.uuid4())})
        if status == 202:
            self.jobs.append(json.loads(answer)['id'])
        self.over.wait(0.2)  # Leaves the queue something to do, not everything.
        return status


class Cluster(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.expected = samples_of_command('--format', 'ply', '--resolution', '64')
        cls.project = cls.enterClassContext(Project('compose.cluster.yaml'))
        cls.project.get('PUT', '/v1/models/spot.obj', SPOT)

    def restart(self, service, grace='45'):
        podman('restart', '-t', grace, self.project.container(service))
        self.await_health(service)

    def await_health(self, service):
        wait_until(lambda: self.answers(service), f'{service} to be ready')

    def answers(self, service):
        """Whether it is ready: a server as the front sees it, a worker as it sees itself."""
        if service.startswith('server'):
            return self.project.request('GET', f'/front/{service}')[0] == 200
        done = subprocess.run(['podman', 'exec', self.project.container(service), 'strata', 'health',
                               'http://127.0.0.1:8080/readyz'], capture_output=True)
        return done.returncode == 0

    def await_jobs(self, load):
        for job in load.jobs:
            self.project.result_of(job)

    def test_1_a_job_runs_with_the_commands_bytes(self):
        self.assertEqual(self.project.run_job('spot.obj', OPTIONS), self.expected)

    def test_2_a_rolling_restart_under_load_fails_no_request(self):
        with Load(self.project, self.expected) as load:
            for service in ('server-1', 'server-2', 'worker-1', 'worker-2', 'server-1', 'server-2'):
                self.restart(service)
        print(f'\nrolling restart: {dict(load.counts)}, faults {len(load.faults)}')
        if load.faults:
            log = subprocess.run(['podman', 'logs', self.project.container('front')], capture_output=True, text=True)
            print('\n'.join(log.stderr.splitlines()[-40:]))
        self.assertEqual(load.faults, [])
        self.await_jobs(load)

    def test_3_killed_workers_and_servers_lose_no_job(self):
        with Load(self.project, self.expected) as load:
            for service in ('worker-1', 'server-1'):
                podman('kill', '--signal', 'KILL', self.project.container(service))
                podman('start', self.project.container(service), check=False)
                self.await_health(service)
        print(f'\nkilled: {dict(load.counts)}, faults {load.faults[:5]}')
        self.await_jobs(load)

    def test_4_postgresql_restarted_is_an_interruption_and_no_loss(self):
        with Load(self.project, self.expected, allowed=(503,)) as load:
            podman('restart', '-t', '60', self.project.container('database'))
            before = load.counts['job 202']
            wait_until(lambda: load.counts['job 202'] > before + 2, 'jobs after the restart')
        print(f'\nPostgreSQL restarted: {dict(load.counts)}, faults {len(load.faults)}')
        self.assertEqual(load.faults, [])
        self.await_jobs(load)
        self.assertEqual(self.project.run_job('spot.obj', OPTIONS), self.expected)


if __name__ == '__main__':
    unittest.main(verbosity=2)
