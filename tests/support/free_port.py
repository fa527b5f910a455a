"""A port of loopback for a server that has to be told one."""
import pathlib
import random
import socket


def free_port():
    """Free now, and none that the system gives to outgoing connections: those of other tests would
    take it by chance before its server does."""
    lowest = int(pathlib.Path('/proc/sys/net/ipv4/ip_local_port_range').read_text().split()[0])
    ports = range(10_000, lowest if lowest > 20_000 else 65_536)
    for port in random.sample(ports, 1000):
        with socket.socket() as probe:
            try:
                probe.bind(('127.0.0.1', port))
            except OSError:
                continue
            return port
    raise OSError(f'no free port among {ports}')
