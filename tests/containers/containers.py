"""podman and podman-compose for the checks, and a client that says what went wrong."""
import contextlib
import json
import os
import pathlib
import socket
import subprocess
import tempfile
import time
import urllib.error
import urllib.request

SOURCE = pathlib.Path(__file__).resolve().parents[2]
IMAGE = os.environ['STRATA_IMAGE']
PATIENCE = 120  # Seconds; only a hang reaches it.


def podman(*command, check=True, **options):
    done = subprocess.run(['podman', *command], capture_output=True, text=True, timeout=300, **options)
    if check and done.returncode:
        raise AssertionError(f'podman {" ".join(command)}: {done.stderr}')
    return done.stdout.strip()


def wait_until(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f'waited {PATIENCE} s for: {what}')
        time.sleep(0.2)
    return value


def free_port():
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


def make_key(role):
    """(key, line of the keys' file), by the image itself."""
    done = subprocess.run(['podman', 'run', '--rm', '--network', 'none', IMAGE, 'key', role, '--role', role],
                          capture_output=True, text=True, check=True)
    return done.stderr.split()[-1], done.stdout


class Project:
    """The services of a compose file, under a name of their own; everything goes at the end."""

    def __init__(self, file):
        self.name = f'strata-check-{os.getpid()}'
        self.file = SOURCE / 'docker' / file
        self.port = free_port()
        self.folder = tempfile.TemporaryDirectory()
        secrets = pathlib.Path(self.folder.name)
        secrets.chmod(0o711)
        self.key, line = make_key('full')
        (secrets / 'keys').write_text(line)
        (secrets / 'database-password').write_text('not a secret: this database lives for minutes\n')
        self.environment = {**os.environ, 'STRATA_SECRETS': str(secrets), 'STRATA_HTTP_PORT': str(self.port),
                            'STRATA_GRPC_PORT': str(free_port())}

    def compose(self, *command):
        done = subprocess.run(['podman-compose', '-p', self.name, '-f', self.file, *command],
                              capture_output=True, text=True, env=self.environment, timeout=600)
        # Its exit status is 0 although a container did not start.
        if done.returncode or 'unable to start' in done.stderr:
            raise AssertionError(f'podman-compose {" ".join(command)}: {done.stdout}{done.stderr}')

    def container(self, service):
        return f'{self.name}_{service}_1'

    def __enter__(self):
        try:
            self.compose('up', '-d')
            wait_until(self.ready, 'the service to be ready')
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for name in podman('ps', '-aq', '--filter', f'label=io.podman.compose.project={self.name}').split():
            podman('rm', '-f', '-t', '0', '-v', name, check=False)
        for name in podman('volume', 'ls', '-q').split():
            if name.startswith(self.name):
                podman('volume', 'rm', '-f', name, check=False)
        podman('network', 'rm', '-f', f'{self.name}_default', check=False)
        self.folder.cleanup()

    def ready(self):
        with contextlib.suppress(OSError, AssertionError):
            return self.request('GET', '/readyz')[0] == 200
        return False

    def request(self, method, path, body=None, headers=None):
        """(status, body). Raises OSError where there is no answer."""
        request = urllib.request.Request(
            f'http://127.0.0.1:{self.port}{path}', data=body, method=method,
            headers={'Authorization': f'Bearer {self.key}', **(headers or {})})
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    def get(self, method, path, body=None, headers=None, expected=(200, 201, 202, 204)):
        status, answer = self.request(method, path, body, headers)
        if status not in expected:
            raise AssertionError(f'{method} {path}: {status} {answer[:500]}')
        return answer

    def run_job(self, model, options):
        """A stored job from its beginning to its result's bytes."""
        job = json.loads(self.get('POST', '/v1/jobs', json.dumps({'model': model, 'options': options}).encode(),
                                  {'Content-Type': 'application/json'}))
        return self.result_of(job['id'])

    def result_of(self, job_id):
        job = wait_until(lambda: self.ended(job_id), f'job {job_id}')
        if job['state'] != 'succeeded':
            raise AssertionError(f'job {job_id}: {job}')
        return self.get('GET', f'/v1/jobs/{job_id}/result')

    def ended(self, job_id):
        job = json.loads(self.get('GET', f'/v1/jobs/{job_id}?wait=5'))
        return None if job['state'] in ('queued', 'running') else job


def samples_of_command(*options):
    """The bytes that `strata sample` of the image writes of the bundled model."""
    done = subprocess.run(
        ['podman', 'run', '--rm', '-i', '--network', 'none', '--read-only', '--cap-drop', 'ALL', '--tmpfs', '/tmp',
         IMAGE, 'sample', '-', '-o', '-', '--quiet', *options],
        input=(SOURCE / 'models' / 'spot.obj').read_bytes(), capture_output=True)
    if done.returncode:
        raise AssertionError(done.stderr.decode())
    return done.stdout
