"""HTTP/2 by hand, for clients that gRPC's own libraries would not be."""
import socket
import struct

import harness

PREFACE = b'PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n'
DATA, HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY = 0, 1, 3, 4, 6, 7
END_STREAM, END_HEADERS = 1, 4


def frame(kind, flags=0, stream=0, payload=b''):
    return struct.pack('>I', len(payload))[1:] + bytes([kind, flags]) + struct.pack('>I', stream) + payload


def header_block(*pairs):
    """HPACK: literals without indexing, each shorter than 127 bytes."""
    block = b''
    for name, value in pairs:
        block += b'\0' + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()
    return block


def call_headers(path, *more):
    return header_block((':method', 'POST'), (':scheme', 'http'), (':path', path),
                        (':authority', 'localhost'), ('content-type', 'application/grpc'),
                        ('te', 'trailers'), *more)


class Connection:
    """A connection to the gRPC port that has said hello (unless told not to)."""

    def __init__(self, server, hello=True):
        self.socket = socket.create_connection(('127.0.0.1', server.grpc_port), harness.PATIENCE)
        self.socket.settimeout(harness.PATIENCE)
        self.buffer = b''
        if hello:
            self.send(PREFACE + frame(SETTINGS))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, raw):
        """What a server that has closed does not take is lost."""
        try:
            self.socket.sendall(raw)
        except (BrokenPipeError, ConnectionResetError):
            pass

    def open_call(self, stream, path, *more):
        self.send(frame(HEADERS, END_HEADERS, stream, call_headers(path, *more)))

    def frames(self):
        """(kind, flags, stream, payload) until the server closes; pings and settings are answered."""
        while True:
            while len(self.buffer) < 9 or len(self.buffer) < 9 + int.from_bytes(self.buffer[:3], 'big'):
                try:
                    piece = self.socket.recv(65536)
                except ConnectionResetError:
                    return
                if not piece:
                    return
                self.buffer += piece
            size = int.from_bytes(self.buffer[:3], 'big')
            kind, flags = self.buffer[3], self.buffer[4]
            stream = int.from_bytes(self.buffer[5:9], 'big') & 0x7fffffff
            payload, self.buffer = self.buffer[9:9 + size], self.buffer[9 + size:]
            if kind == SETTINGS and not flags & 1:
                self.send(frame(SETTINGS, 1))
            if kind == PING and not flags & 1:
                self.send(frame(PING, 1, 0, payload))
            yield kind, flags, stream, payload

    def await_end(self):
        """The kinds of the frames that came until the server closed."""
        return [kind for kind, _, _, _ in self.frames()]
