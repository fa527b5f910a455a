#!/usr/bin/env python3
"""What the service costs: against the command, from the cache, under load, with slow clients, for a
large upload. One command, a table in Markdown, about two minutes:

    tests/bench/serve/load.py [--strata BINARY] [--mesh FILE] [--resolution N] [--quick]

The mesh is the bunny of the test data (bench.py says where that lies), else models/spot.obj.
Clients and service share the processors, so that figures under load are lower bounds.
"""
import argparse
import os
import pathlib
import re
import select
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field

SOURCE = pathlib.Path(__file__).resolve().parents[3]
CLIENTS = (1, 8, 64)
SLOW = 200


@dataclass
class Table:
    rows: list = field(default_factory=list)

    def add(self, what, figure):
        self.rows.append((what, figure))
        print(f'{what}: {figure}', file=sys.stderr)

    def print(self):
        print('| what | figure |\n| --- | --- |')
        for what, figure in self.rows:
            print(f'| {what} | {figure} |')


class Service:
    """`strata serve` on free ports, with a data folder of its own."""

    def __init__(self, strata, folder, *options):
        log = f'{folder}/log'
        self.process = subprocess.Popen(
            [strata, 'serve', '--http', '127.0.0.1:0', '--grpc', 'off', '--log-format', 'json',
             '--data', f'{folder}/data', '--scratch', folder, *options],
            stderr=open(log, 'w'), cwd=folder)
        while not (found := re.search(r'"http":"127.0.0.1:(\d+)"', pathlib.Path(log).read_text())):
            if self.process.poll() is not None:
                sys.exit(pathlib.Path(log).read_text())
            select.select([], [], [], 0.01)
        self.port = int(found[1])

    def connect(self):
        client = socket.create_connection(('127.0.0.1', self.port))
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return client

    def status(self, name):
        """A figure of memory in MiB: VmRSS, VmHWM."""
        text = pathlib.Path(f'/proc/{self.process.pid}/status').read_text()
        return int(re.search(rf'{name}:\s+(\d+)', text)[1]) / 1024

    def reset_peak(self):
        pathlib.Path(f'/proc/{self.process.pid}/clear_refs').write_text('5')

    def stop(self):
        self.process.terminate()
        self.process.wait(120)


def request(method, path, body=b''):
    return (f'{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n\r\n'
            .encode() + body)


class Client:
    """A kept connection that asks one thing over and over. `work` moves what can be moved."""

    def __init__(self, service, raw):
        self.socket = service.connect()
        self.socket.setblocking(False)
        self.raw = memoryview(raw)
        self.times, self.failed = [], 0
        self.begin()

    def begin(self):
        self.sent, self.received, self.whole = 0, b'', None
        self.got = 0
        self.start = time.perf_counter()

    def wants(self):
        return select.EPOLLOUT | select.EPOLLIN if self.sent < len(self.raw) else select.EPOLLIN

    def work(self, ready):
        """Whether an answer is whole."""
        if ready & select.EPOLLOUT and self.sent < len(self.raw):
            try:
                self.sent += self.socket.send(self.raw[self.sent:])
            except BlockingIOError:
                pass
        if not ready & (select.EPOLLIN | select.EPOLLHUP):
            return False
        try:
            piece = self.socket.recv(1 << 18)
        except BlockingIOError:
            return False
        if not piece:
            raise SystemExit('the service closed a connection')
        if self.whole is None:
            self.received += piece
            head, end, body = self.received.partition(b'\r\n\r\n')
            if not end:
                return False
            length = re.search(rb'\r\ncontent-length: (\d+)', head, re.I)
            self.whole, self.got = int(length[1]), len(body)
            self.failed += head.split(None, 2)[1] != b'200'
        else:
            self.got += len(piece)
        if self.got < self.whole:
            return False
        self.times.append(time.perf_counter() - self.start)
        return True


def run_load(service, raw, clients, count):
    """(requests a second, times, how many failed) of `count` requests by `clients` at a time."""
    everybody = [Client(service, raw) for _ in range(clients)]
    poll = select.epoll()
    by_number = {client.socket.fileno(): client for client in everybody}
    for number, client in by_number.items():
        client.begin()
        poll.register(number, client.wants())
    start, started, done = time.perf_counter(), clients, 0
    while done < max(count, clients):
        for number, ready in poll.poll():
            client = by_number[number]
            if client.work(ready):
                done += 1
                if started < count:
                    started += 1
                    client.begin()
                else:
                    poll.unregister(number)
                    continue
            poll.modify(number, client.wants())
    spent = time.perf_counter() - start
    for client in everybody:
        client.socket.close()
    times = [spent_ for client in everybody for spent_ in client.times]
    return done / spent, times, sum(client.failed for client in everybody)


def ask(service, raw):
    """The time and the status of one request on a new connection."""
    start = time.perf_counter()
    with service.connect() as client:
        client.sendall(raw.replace(b'\r\n\r\n', b'\r\nConnection: close\r\n\r\n', 1))
        head = client.recv(1 << 18)
        while client.recv(1 << 18):
            pass
    return time.perf_counter() - start, head.split(None, 2)[1].decode()


def percentile(values, share):
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def millis(seconds):
    return f'{seconds * 1e3:.{2 if seconds < 0.01 else 1}f} ms'


# --- The rows ------------------------------------------------------------------------------------

def overhead(table, service, options, mesh, scale):
    raw = request('POST', f'/v1/samples?resolution={options.resolution}&format=ply', mesh)
    pairs = []
    with tempfile.TemporaryDirectory() as folder:
        command = [options.strata, 'sample', options.mesh, '-o', f'{folder}/out.ply', '--quiet',
                   '--resolution', str(options.resolution)]
        for _ in range(max(3, 21 // scale)):  # In turn, so that both see the same neighbours.
            start = time.perf_counter()
            subprocess.run(command, check=True)
            pairs.append((time.perf_counter() - start, ask(service, raw)[0]))
    command = statistics.median(pair[0] for pair in pairs)
    served = statistics.median(pair[1] for pair in pairs)
    ratio = statistics.median(pair[1] / pair[0] for pair in pairs)
    table.add(f'HTTP over the command, median of {len(pairs)} pairs (at most 1.3)',
              f'{ratio:.2f} ({millis(served)} over {millis(command)})')


def cached(table, service, path, scale):
    for _ in range(2):
        ask(service, request('GET', path))
    _, times, _ = run_load(service, request('GET', path), 1, max(20, 400 // scale))
    table.add('a cached request, median (under 5 ms)', millis(statistics.median(times)))


def load(table, service, options, mesh, path, scale):
    kinds = {'direct': (request('POST', f'/v1/samples?resolution={options.resolution}', mesh), 64),
             'cached': (request('GET', path), 2000), '/livez': (request('GET', '/livez'), 10_000)}
    for kind, (raw, count) in kinds.items():
        for clients in CLIENTS:
            a_second, times, failed = run_load(service, raw, clients, max(clients, count // scale))
            figures = ' / '.join(millis(percentile(times, share)) for share in (0.5, 0.95, 0.99))
            table.add(f'{kind}, {clients} clients: requests a second; latency p50 / p95 / p99; failed',
                      f'{a_second:.0f}; {figures}; {failed}')


def slow_clients(table, service, mesh, scale):
    clients = [service.connect() for _ in range(SLOW)]
    for client in clients:
        client.sendall(b'POST /v1/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999\r\n\r\n')
    times, statuses = [], set()
    for _ in range(max(2, 8 // scale)):
        second = time.perf_counter() + 1
        for client in clients:
            client.send(b'v')
        while time.perf_counter() < second:
            spent, status = ask(service, request('GET', '/livez'))
            times.append(spent)
            statuses.add(status)
            select.select([], [], [], 0.02)
    normal = ask(service, request('POST', '/v1/samples?resolution=20', mesh))[1]
    table.add(f'/livez beside {SLOW} clients at a byte a second: slowest of {len(times)} (under 50 ms)',
              f'{millis(max(times))} (statuses {", ".join(sorted(statuses))}; a normal request {normal}; '
              f'{service.status("VmRSS"):.0f} MiB resident)')
    for client in clients:
        client.close()


def upload(table, service, size):
    piece = b'# ' + b'x' * 1048573 + b'\n'
    count = size // len(piece)
    service.reset_peak()
    idle = service.status('VmRSS')
    with service.connect() as client:
        client.sendall(b'PUT /v1/models/large HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n'
                       b'Content-Length: %d\r\n\r\n' % (count * len(piece)))
        start = time.perf_counter()
        for _ in range(count):
            client.sendall(piece)
        status = client.recv(4096).split()[1].decode()
        spent = time.perf_counter() - start
    table.add(f'an upload of {size / 1e9:.1f} GB (within 64 MiB over idle)',
              f'{service.status("VmHWM") - idle:.1f} MiB over idle, {size / spent / 1e6:.0f} MB/s, '
              f'status {status}')


def parse():
    data = pathlib.Path(os.environ.get('STRATA_TEST_DATA', SOURCE / '../shared/data'))
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--strata', default=str(SOURCE / 'build/ci/server/strata'))
    parser.add_argument('--mesh', default=str(data / 'scans/bun_zipper.ply'))
    parser.add_argument('--resolution', type=int, default=170)
    parser.add_argument('--upload-bytes', type=int, default=2_000_000_000)
    parser.add_argument('--quick', action='store_true', help='a tenth of it, to see that it works')
    options = parser.parse_args()
    if not pathlib.Path(options.mesh).exists():
        print(f'{options.mesh} is missing: models/spot.obj in its place', file=sys.stderr)
        options.mesh = str(SOURCE / 'models/spot.obj')
    return options


def main():
    options = parse()
    scale = 10 if options.quick else 1
    mesh = pathlib.Path(options.mesh).read_bytes()
    path = f'/v1/samples?model=mesh&resolution={options.resolution}&format=ply'
    table = Table()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(options.strata, folder)
        try:
            ask(service, request('PUT', '/v1/models/mesh', mesh))
            table.add('mesh, resolution, processors; load of the machine',
                      f'{pathlib.Path(options.mesh).name}, {options.resolution}, {os.cpu_count()}; '
                      f'{os.getloadavg()[0]:.1f}')
            overhead(table, service, options, mesh, scale)
            cached(table, service, path, scale)
            load(table, service, options, mesh, path, scale)
            slow_clients(table, service, mesh, scale)
            upload(table, service, options.upload_bytes // scale)
        finally:
            service.stop()
    table.print()


if __name__ == '__main__':
    main()
