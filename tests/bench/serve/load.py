#!/usr/bin/env python3
"""What the service costs: against the command, from the cache, under load, with slow clients.

usage: load.py --strata BINARY --mesh FILE [--resolution N] [--upload-bytes N]
Prints one line a figure. Bounded: about a minute.
"""
import argparse
import concurrent.futures
import http.client
import json
import pathlib
import re
import select
import socket
import statistics
import subprocess
import tempfile
import time


def timed(work):
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


class Service:
    """`strata serve` on free ports, with a data folder of its own."""

    def __init__(self, strata, folder):
        self.process = subprocess.Popen(
            [strata, 'serve', '--http', '127.0.0.1:0', '--grpc', 'off', '--log-format', 'json',
             '--data', f'{folder}/data', '--scratch', folder, '--log-level', 'info',
             '--requests', '1000'],
            stderr=open(f'{folder}/log', 'w'), cwd=folder)
        while not (found := re.search(r'"http":"127.0.0.1:(\d+)"',
                                      pathlib.Path(f'{folder}/log').read_text())):
            select.select([], [], [], 0.01)
        self.port = int(found[1])

    def resident(self):
        text = pathlib.Path(f'/proc/{self.process.pid}/status').read_text()
        return int(re.search(r'VmRSS:\s+(\d+)', text)[1]) / 1024

    def ask(self, method, path, body=None, connection=None):
        client = connection or http.client.HTTPConnection('127.0.0.1', self.port, timeout=300)
        client.request(method, path, body)
        answer = client.getresponse()
        return answer.status, answer.read()


def percentile(values, share):
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def overhead(service, options, mesh):
    path = f'/v1/samples?resolution={options.resolution}&format=ply'
    with tempfile.TemporaryDirectory() as folder:
        command = [options.strata, 'sample', options.mesh, '-o', f'{folder}/out.ply', '--quiet',
                   '--resolution', str(options.resolution)]
        pairs = []
        for _ in range(15):  # In turn, so that both see the same neighbours.
            pairs.append((timed(lambda: subprocess.run(command, check=True))[0],
                          timed(lambda: service.ask('POST', path, mesh))[0]))
    alone = statistics.median(p[0] for p in pairs)
    served = statistics.median(p[1] for p in pairs)
    print(f'command {alone * 1e3:.1f} ms, HTTP {served * 1e3:.1f} ms, ratio {served / alone:.2f}')


def cached(service, options, mesh):
    service.ask('PUT', '/v1/models/mesh', mesh)
    path = f'/v1/samples?model=mesh&resolution={options.resolution}&format=ply'
    service.ask('GET', path)
    client = http.client.HTTPConnection('127.0.0.1', service.port, timeout=60)
    times = [timed(lambda: service.ask('GET', path, None, client))[0] for _ in range(200)]
    print(f'cached: median {statistics.median(times) * 1e3:.2f} ms, 99 % '
          f'{percentile(times, 0.99) * 1e3:.2f} ms')


def load(service, options, mesh, clients):
    paths = {'sampled': ('POST', f'/v1/samples?resolution={options.resolution}', mesh),
             'cached': ('GET', f'/v1/samples?model=mesh&resolution={options.resolution}'
                               '&format=ply', None)}
    for name, request in paths.items():
        count = 64 if name == 'sampled' else 1000
        with concurrent.futures.ThreadPoolExecutor(clients) as pool:
            spent, answers = timed(lambda: list(
                pool.map(lambda _: timed(lambda: service.ask(*request)), range(count))))
        bad = sum(answer[1][0] != 200 for answer in answers)
        times = [answer[0] for answer in answers]
        print(f'{clients} clients, {name}: {count / spent:.0f}/s, median '
              f'{statistics.median(times) * 1e3:.1f} ms, 99 % {percentile(times, 0.99) * 1e3:.1f} ms,'
              f' {bad} failed')


def upload(service, total):
    before, peak, piece = service.resident(), 0, b'# ' + b'x' * 1048573 + b'\n'
    with socket.create_connection(('127.0.0.1', service.port)) as client:
        client.sendall(b'PUT /v1/models/large HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n'
                       b'Content-Length: %d\r\n\r\n' % (total // len(piece) * len(piece)))
        start = time.perf_counter()
        for i in range(total // len(piece)):
            client.sendall(piece)
            if i % 16 == 0:
                peak = max(peak, service.resident())
        status = client.recv(4096).split()[1].decode()
        spent = time.perf_counter() - start
    print(f'upload of {total / 1e9:.1f} GB: {status}, {total / spent / 1e6:.0f} MB/s, '
          f'{peak - before:.1f} MiB over idle')


def slow_clients(service, mesh):
    clients = []
    for _ in range(200):
        client = socket.create_connection(('127.0.0.1', service.port))
        client.sendall(b'POST /v1/samples HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999\r\n\r\n')
        clients.append(client)
    times = []
    for _ in range(5):
        for client in clients:
            client.send(b'v')
        times += [timed(lambda: service.ask('GET', '/livez'))[0] for _ in range(20)]
        select.select([], [], [], 1)
    status = service.ask('POST', '/v1/samples?resolution=20', mesh)[0]
    print(f'200 slow clients: /livez at most {max(times) * 1e3:.1f} ms, a request {status}, '
          f'{service.resident():.0f} MiB resident')
    for client in clients:
        client.close()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--strata', required=True)
    parser.add_argument('--mesh', required=True)
    parser.add_argument('--resolution', type=int, default=170)
    parser.add_argument('--upload-bytes', type=int, default=2_000_000_000)
    options = parser.parse_args()
    mesh = pathlib.Path(options.mesh).read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(options.strata, folder)
        try:
            overhead(service, options, mesh)
            cached(service, options, mesh)
            for clients in (1, 8, 64):
                load(service, options, mesh, clients)
            slow_clients(service, mesh)
            upload(service, options.upload_bytes)
            print(json.dumps({'idle_mib': round(service.resident(), 1)}))
        finally:
            service.process.terminate()
            service.process.wait(60)


if __name__ == '__main__':
    main()
