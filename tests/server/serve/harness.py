"""A service of the test's own on loopback, and raw sockets to it."""
import collections
import errno
import io
import json
import os
import pathlib
import re
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import zipfile

ARGUMENTS = {}  # Set by main().
# Off in most tests under ThreadSanitizer (tests/support/run_under_tsan.py).
GRPC = os.environ.get('STRATA_TEST_GRPC') != 'off'
UNDER_TSAN = 'STRATA_TEST_GRPC' in os.environ
# Seconds for what normally takes milliseconds; only a hang reaches it. ThreadSanitizer is slow.
PATIENCE = 300.0 if UNDER_TSAN else 60.0
SKIPPED = 77  # CTest's word for it.


def strata():
    return ARGUMENTS['strata']


needs_grpc = unittest.skipUnless(GRPC, 'gRPC is off: its library is not built for ThreadSanitizer')
measures_memory = unittest.skipIf(UNDER_TSAN, "ThreadSanitizer's own memory counts as the program's")


def skip_without_grpc():
    """Ends a program whose tests all need it."""
    if not GRPC:
        print('skipped: gRPC is off, its library is not built for ThreadSanitizer')
        sys.exit(SKIPPED)


def wait_until(condition, what, patience=PATIENCE):
    """Polls until `condition` holds; fails, naming `what`, when it never does."""
    deadline = time.monotonic() + patience
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f'waited {patience} s for: {what}')
        select.select([], [], [], 0.01)
    return value


def is_symbolizer(pid):
    """Whether a process is the helper that a sanitizer starts for its reports."""
    try:
        return pathlib.Path(f'/proc/{pid}/comm').read_text().startswith('llvm-symbolizer')
    except (FileNotFoundError, ProcessLookupError):
        return False


def arguments(pid):
    """The command line of a process; nothing once it has ended."""
    try:
        return pathlib.Path(f'/proc/{pid}/cmdline').read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b''


def is_alive(pid):
    """Whether a process runs; one that nobody has waited for yet does not."""
    try:
        state = pathlib.Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in 'ZX'


class Logged:
    """A process of the service whose JSON log is read as it comes."""

    def begin(self, command, *options, folder, environment=None):
        self.log = []
        self.process = subprocess.Popen(
            [strata(), command, '--log-format', 'json', *options], stderr=subprocess.PIPE,
            text=True, cwd=folder, env={**os.environ, **(environment or {})})
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.process.stderr:
            try:
                self.log.append(json.loads(line))
            except ValueError:
                self.log.append({'event': 'text', 'line': line})

    def events(self, name):
        return [line for line in list(self.log) if line.get('event') == name]

    def end(self, number):
        """Ends the process with a signal, unless it has ended; returns its exit status."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        status = self.process.wait(PATIENCE)
        self.reader.join()
        self.process.stderr.close()
        return status


class Server(Logged):
    """`strata serve` with free ports and a JSON log, ended with SIGTERM."""

    def __init__(self, *options, config='', environment=None):
        self.folder = tempfile.TemporaryDirectory()
        self.path = pathlib.Path(self.folder.name)
        (self.path / 'scratch').mkdir()
        (self.path / 'strata.toml').write_text(config)
        listen = [] if any(o.startswith('--http') for o in options) else ['--http', '127.0.0.1:0']
        if not any(o.startswith('--grpc') for o in options):
            listen += ['--grpc', '127.0.0.1:0' if GRPC else 'off']
        if '--scratch' not in options:
            listen += ['--scratch', str(self.path / 'scratch')]
        for limit in ('--grace', '--header-timeout'):  # No client is slow by a busy machine.
            listen += [] if limit in options else [limit, '45']
        self.begin('serve', *listen, *options, folder=self.path, environment=environment)
        started = wait_until(lambda: self.events('serving') or self.process.poll() is not None,
                             'the server to listen')
        if started is True:
            self.reader.join()
            raise AssertionError(f'the server ended: {self.log}')
        self.http_port = self._port('http')
        self.grpc_port = self._port('grpc')

    def _port(self, protocol):
        where = self.events('serving')[0][protocol]
        return int(where.rsplit(':', 1)[1]) if ':' in where else 0

    def request_line(self, request_id):
        """The log line of a request, which comes just after its answer."""
        return wait_until(lambda: [line for line in self.events('request')
                                   if line['request_id'] == request_id],
                          f'the log line of {request_id}')[0]

    def children(self):
        found = []
        for path in pathlib.Path(f'/proc/{self.process.pid}/task').glob('*/children'):
            try:
                found += path.read_text().split()
            except (FileNotFoundError, ProcessLookupError):
                pass  # The thread ended meanwhile.
        return [pid for pid in found if not is_symbolizer(pid)]

    def children_at_once(self):
        """Those that were there at one moment: a walk over the threads takes a while, and one that
        begins may be counted beside one that has ended."""
        before = set(self.children())
        return [pid for pid in self.children() if pid in before]

    def resident_bytes(self):
        text = pathlib.Path(f'/proc/{self.process.pid}/status').read_text()
        return int(re.search(r'VmRSS:\s+(\d+)', text)[1]) * 1024

    def held(self):
        """What a request could leave behind: descriptors by kind, threads, children, scratch files."""
        process = pathlib.Path(f'/proc/{self.process.pid}')
        kinds = collections.Counter()
        for link in (process / 'fd').iterdir():
            try:
                kinds[os.readlink(link).partition(':[')[0]] += 1
            except FileNotFoundError:
                pass  # Closed meanwhile.
        return {'descriptors': dict(sorted(kinds.items())),
                'threads': len(list((process / 'task').iterdir())),
                'children': len(self.children()),
                'scratch': sorted(os.listdir(self.path / 'scratch'))}

    def await_held(self, before):
        """Fails unless it comes to hold no more than it held `before`."""
        try:
            wait_until(lambda: holds_no_more(self.held(), before), 'everything to be given back')
        except AssertionError as error:
            raise AssertionError(f'{error}: before {before}, now {self.held()}') from None

    def stop(self, number=signal.SIGTERM):
        """Ends the service, returns its exit status."""
        status = self.end(number)
        self.folder.cleanup()
        return status

    # --- curl ---

    def curl(self, path, *options, body=None):
        """One request by curl: Answer."""
        with tempfile.TemporaryDirectory() as folder:
            out, head = pathlib.Path(folder) / 'out', pathlib.Path(folder) / 'head'
            done = subprocess.run(
                ['curl', '--silent', '--show-error', '--max-time', str(2 * PATIENCE), '--output', out,
                 '--dump-header', head, *(['--data-binary', '@-'] if body is not None else []),
                 *options, f'http://127.0.0.1:{self.http_port}{path}'],
                input=body, capture_output=True)
            if done.returncode:
                raise AssertionError(f'curl {path}: {done.stderr.decode()}')
            return Answer(head.read_bytes(), out.read_bytes() if out.exists() else b'')

    # --- raw bytes ---

    def connect(self):
        connection = socket.create_connection(('127.0.0.1', self.http_port), PATIENCE)
        connection.settimeout(PATIENCE)
        return connection

    def exchange(self, raw, close_writing=False):
        """Sends raw bytes, reads until the server closes: all that came."""
        with self.connect() as connection:
            try:
                connection.sendall(raw)
            except (BrokenPipeError, ConnectionResetError):
                pass  # The server may answer and close before everything is sent.
            if close_writing:
                end_writing(connection)
            return read_to_end(connection)

    def metric(self, name):
        """The value of an exposed series, by its whole name with labels."""
        text = self.curl('/metrics').body.decode()
        found = re.search(rf'^{re.escape(name)} (\S+)$', text, re.M)
        return float(found[1]) if found else 0.0


def holds_no_more(now, before):
    """Whether a service holds no more `now` than `before`. It may hold less: what it does from time to
    time by itself may have been under way before."""
    kinds = now['descriptors'].items()
    return (all(count <= before['descriptors'].get(kind, 0) for kind, count in kinds) and
            now['threads'] <= before['threads'] and now['children'] <= before['children'] and
            set(now['scratch']) <= set(before['scratch']))


def end_writing(connection):
    """Nothing more is sent. A server that has answered and is gone does not mind."""
    try:
        connection.shutdown(socket.SHUT_WR)
    except OSError as error:
        if error.errno != errno.ENOTCONN:
            raise


def read_to_end(connection):
    received = b''
    try:
        while piece := connection.recv(65536):
            received += piece
    except ConnectionResetError:
        pass
    return received


class Answer:
    """A status, headers (names in lower case) and a body."""

    def __init__(self, head, body):
        blocks = [block for block in head.split(b'\r\n\r\n') if block.startswith(b'HTTP/')]
        lines = blocks[-1].decode('latin-1').split('\r\n')
        self.status = int(lines[0].split()[1])
        self.headers = {}
        for line in lines[1:]:
            name, _, value = line.partition(':')
            self.headers[name.lower()] = value.strip()
        self.body = body

    @classmethod
    def parse(cls, raw):
        """From raw bytes; an interim 100 is skipped."""
        while raw.startswith(b'HTTP/1.1 100'):
            raw = raw.partition(b'\r\n\r\n')[2]
        head, _, body = raw.partition(b'\r\n\r\n')
        return cls(head + b'\r\n\r\n', body)

    def json(self):
        return json.loads(self.body)


def make_key(name, role='full'):
    """(key, line) as `strata key` prints them."""
    done = subprocess.run([strata(), 'key', name, '--role', role], capture_output=True, text=True,
                          check=True)
    return done.stderr.split()[-1], done.stdout


def make_keys(folder):
    """(full key, read-only key, the file that `--keys` takes), the file in `folder`."""
    full, full_line = make_key('full')
    read, read_line = make_key('read', 'read')
    path = pathlib.Path(folder) / 'keys'
    path.write_text(full_line + read_line)
    return full, read, path


def writes_vdb():
    """Whether strata-vdb lies beside the program: builds with sanitizers are without it."""
    return pathlib.Path(strata()).with_name('strata-vdb').exists()


def sample_by_command(mesh, suffix, *options):
    """What `strata sample` writes."""
    with tempfile.TemporaryDirectory() as folder:
        output = pathlib.Path(folder) / f'out.{suffix}'
        subprocess.run([strata(), 'sample', mesh, '-o', output, '--quiet', *options], check=True)
        return output.read_bytes()


def tiles_by_command(mesh, *options):
    """The files of the folder that `strata sample` writes, by their paths in it."""
    with tempfile.TemporaryDirectory() as folder:
        output = pathlib.Path(folder) / 'out.drc'
        subprocess.run([strata(), 'sample', mesh, '-o', output, '--quiet', *options], check=True)
        return {str(file.relative_to(output)): file.read_bytes()
                for file in output.rglob('*') if file.is_file()}


def tiles_in_zip(body):
    """The files of a zip of tiles, by their paths; what makes its bytes repeatable is checked."""
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        members = archive.infolist()
        assert archive.testzip() is None
        assert all(member.compress_type == zipfile.ZIP_STORED for member in members)
        assert all(member.date_time == (1980, 1, 1, 0, 0, 0) for member in members)
        assert members[-1].filename == 'tileset.json'
        return {member.filename: archive.read(member) for member in members}


def spot():
    return pathlib.Path(ARGUMENTS['source']) / 'models' / 'spot.obj'


def folder_with_models(test):
    """A folder of a test's own, that goes with it; `models` in it holds one mesh."""
    folder = tempfile.TemporaryDirectory()
    test.addCleanup(folder.cleanup)
    path = pathlib.Path(folder.name)
    (path / 'models').mkdir()
    shutil.copy(spot(), path / 'models')
    return path


CUBE = b''.join(b'v %d %d %d\n' % (x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)) + b'''\
f 1 2 4 3
f 5 7 8 6
f 1 5 6 2
f 3 4 8 7
f 1 3 7 5
f 2 6 8 4
'''


# A job of many seconds with a small body: 54 million cells.
LONG_MODEL = {'resolution': 3000, 'format': 'xyz'}  # The same of a stored cube.
LONG = '/v1/samples?resolution=3000&format=xyz'


def long_request(path=LONG):
    """LONG as raw bytes."""
    return (b'POST %s HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n' %
            (path.encode(), len(CUBE)) + CUBE)


class ServerCase(unittest.TestCase):
    """A test class with one server for all its tests; `options` are its flags."""
    options = ()

    @classmethod
    def setUpClass(cls):
        cls.server = Server(*cls.options)

    @classmethod
    def tearDownClass(cls):
        status = cls.server.stop()
        assert status == 0, f'the server ended with {status}: {cls.server.log[-5:]}'

    def assertProblem(self, answer, status, kind, detail=''):
        """An RFC 9457 answer of this type, whose detail holds these words."""
        self.assertEqual(answer.status, status, answer.body[:400])
        self.assertEqual(answer.headers['content-type'], 'application/problem+json')
        problem = answer.json()
        self.assertEqual(problem['type'], f'/problems/{kind}', problem)
        self.assertEqual(problem['status'], status)
        self.assertEqual(problem['request_id'], answer.headers['x-request-id'])
        self.assertIn(detail, problem['detail'])
        return problem


def route_table():
    """(method, path, access) of the table in server/http/endpoints.cc; access is Open, Read, Full."""
    text = (pathlib.Path(ARGUMENTS['source']) / 'server/http/endpoints.cc').read_text()
    table = text[text.index('kRoutes'):]
    return re.findall(r'\{"([A-Z]+)", "(/[^"]*)", Access::k(\w+)', table)


def routes():
    """Its paths, as OpenAPI writes them."""
    return [path.replace('...', '') for _, path, _ in route_table()]


def sample_option_names():
    """The fields of strata.v1.SampleOptions."""
    text = (pathlib.Path(ARGUMENTS['source']) / 'proto/strata/v1/options.proto').read_text()
    message = text[text.index('message SampleOptions'):text.index('message Progress')]
    return set(re.findall(r'^ +(?:optional )?\w+ (\w+) = \d+;', message, re.M))


def main():
    import argparse
    parser = argparse.ArgumentParser()
    for name in ('--strata', '--source', '--protoc', '--grpc-python-plugin'):
        parser.add_argument(name, default='')
    options, rest = parser.parse_known_args()
    ARGUMENTS.update(vars(options))
    unittest.main(module='__main__', argv=[sys.argv[0], *rest], verbosity=2)
