"""An S3 store of the test's own on loopback: it checks every signature, and fails as it is told.

What it keeps lies in memory, or with another store (s3rver) that it passes requests on to.
"""
import contextlib
import datetime
import hashlib
import http.client
import http.server
import socket
import threading
import urllib.parse
from xml.sax.saxutils import escape

import signature

KEYS = {'KEYOFTESTS': 'secret/of+the=tests'}
REGION = 'test-region-1'


class Fault:
    """What happens to the requests that it takes, at most `times` of them."""

    def __init__(self, takes, act, times=1):
        self.takes, self.act, self.left = takes, act, times


class Answer:
    def __init__(self, status, body=b'', headers=None):
        self.status = status
        self.body = body.encode() if isinstance(body, str) else body
        self.headers = dict(headers or {})


def refusal(status, code, message='', more='', headers=None):
    return Answer(status, f'<?xml version="1.0" encoding="UTF-8"?>\n<Error><Code>{code}</Code>'
                          f'<Message>{escape(message)}</Message>{more}</Error>', headers)


class Request:
    def __init__(self, method, target, headers, body):
        self.method, self.target, self.headers, self.body = method, target, headers, body
        path, _, query = target.partition('?')
        self.query = dict(urllib.parse.parse_qsl(query, keep_blank_values=True))
        bucket, _, key = path[1:].partition('/')
        self.bucket = bucket
        self.key = urllib.parse.unquote_to_bytes(key).decode('utf-8', 'surrogateescape')


def encoded(key):
    """As S3 encodes keys in listings."""
    return urllib.parse.quote(key.encode('utf-8', 'surrogateescape'), safe='/*-._').replace(
        '%20', '+')


class Memory:
    """The objects of any bucket, with the promises of S3."""

    def __init__(self, page=1000):
        self.objects, self.uploads, self.page = {}, {}, page
        self.conditional = True  # Whether a put minds If-None-Match.
        self.lock = threading.Lock()
        self.serial = 0

    def handle(self, request):
        with self.lock:
            if not request.key:
                return self._bucket(request)
            if 'uploads' in request.query:
                return self._begin(request)
            if 'uploadId' in request.query:
                return self._upload(request)
            return getattr(self, '_' + request.method.lower())(request)

    def _bucket(self, request):
        prefix = request.query.get('prefix', '')
        if 'uploads' in request.query:
            rows = ''.join(
                f'<Upload><Key>{encoded(key)}</Key><UploadId>{name}</UploadId>'
                f'<Initiated>{began}</Initiated></Upload>'
                for name, (bucket, key, began, _) in sorted(self.uploads.items())
                if bucket == request.bucket and key.startswith(prefix))
            return Answer(200, '<ListMultipartUploadsResult><EncodingType>url</EncodingType>'
                               f'<IsTruncated>false</IsTruncated>{rows}</ListMultipartUploadsResult>')
        assert request.query['list-type'] == '2', request.target
        after = request.query.get('continuation-token', '')
        keys = sorted(key for bucket, key in self.objects
                      if bucket == request.bucket and key.startswith(prefix) and key > after)
        shown = keys[:self.page]
        rows = ''.join(
            f'<Contents><Key>{encoded(key)}</Key><ETag>"{etag}"</ETag><Size>{len(body)}</Size>'
            '<LastModified>2026-01-01T00:00:00.000Z</LastModified></Contents>'
            for key in shown for body, etag in [self.objects[request.bucket, key]])
        more = len(keys) > len(shown)
        next_token = f'<NextContinuationToken>{escape(shown[-1])}</NextContinuationToken>' \
            if more else ''
        return Answer(200, '<?xml version="1.0"?><ListBucketResult '
                           'xmlns="http://s3.amazonaws.com/doc/2006-03-01/">'
                           '<EncodingType>url</EncodingType>'
                           f'<IsTruncated>{"true" if more else "false"}</IsTruncated>{next_token}'
                           f'{rows}</ListBucketResult>')

    def _put(self, request):
        condition = request.headers.get('if-none-match')
        assert condition in (None, '*'), condition
        if condition and self.conditional and (request.bucket, request.key) in self.objects:
            return refusal(412, 'PreconditionFailed', 'At least one of the preconditions did not hold')
        etag = hashlib.md5(request.body).hexdigest()
        self.objects[request.bucket, request.key] = request.body, etag
        return Answer(200, headers={'ETag': f'"{etag}"'})

    def _head(self, request):
        return self._get(request)

    def _get(self, request):
        found = self.objects.get((request.bucket, request.key))
        if not found:
            return refusal(404, 'NoSuchKey', 'The specified key does not exist.')
        body, etag = found
        wanted = request.headers.get('if-match')
        if wanted and wanted.strip('"') != etag:
            return refusal(412, 'PreconditionFailed')
        headers = {'ETag': f'"{etag}"', 'Last-Modified': 'Thu, 01 Jan 2026 00:00:00 GMT'}
        if 'range' in request.headers:
            first, _, last = request.headers['range'].removeprefix('bytes=').partition('-')
            part = body[int(first):int(last) + 1 if last else None]
            if not part:
                return refusal(416, 'InvalidRange')
            headers['Content-Range'] = (f'bytes {first}-{int(first) + len(part) - 1}/'
                                        f'{len(body)}')
            return Answer(206, part, headers)
        return Answer(200, body, headers)

    def _delete(self, request):
        self.objects.pop((request.bucket, request.key), None)
        return Answer(204)

    def _begin(self, request):
        self.serial += 1
        name = f'upload+{self.serial}/='
        began = datetime.datetime.now(datetime.timezone.utc).strftime('%Y-%m-%dT%H:%M:%S.000Z')
        self.uploads[name] = request.bucket, request.key, began, {}
        return Answer(200, f'<InitiateMultipartUploadResult><UploadId>{name}</UploadId>'
                           '</InitiateMultipartUploadResult>')

    def _upload(self, request):
        name = request.query['uploadId']
        if name not in self.uploads:
            return refusal(404, 'NoSuchUpload')
        parts = self.uploads[name][3]
        if request.method == 'PUT':
            etag = hashlib.md5(request.body).hexdigest()
            parts[int(request.query['partNumber'])] = request.body, etag
            return Answer(200, headers={'ETag': f'"{etag}"'})
        del self.uploads[name]
        if request.method == 'DELETE':
            return Answer(204)
        bodies = [body for _, (body, _) in sorted(parts.items())]
        assert all(len(body) >= 5 << 20 for body in bodies[:-1]), 'a part below 5 MiB'
        etags = ''.join(f'<Part><PartNumber>{number}</PartNumber><ETag>"{etag}"</ETag></Part>'
                        for number, (_, etag) in sorted(parts.items()))
        assert etags.encode() in request.body, request.body
        etag = hashlib.md5(b''.join(hashlib.md5(body).digest() for body in bodies)).hexdigest()
        etag += f'-{len(bodies)}'
        self.objects[request.bucket, request.key] = b''.join(bodies), etag
        return Answer(200, '<CompleteMultipartUploadResult>'
                           f'<ETag>"{etag}"</ETag></CompleteMultipartUploadResult>')


class PassOn:
    """Another store behind this one, which need not check signatures or bodies itself."""

    def __init__(self, port):
        self.port = port

    def handle(self, request):
        connection = http.client.HTTPConnection('127.0.0.1', self.port, timeout=60)
        headers = {name: value for name, value in request.headers.items() if name != 'expect'}
        connection.request(request.method, request.target, request.body or None, headers)
        answer = connection.getresponse()
        body = answer.read()
        kept = {name: value for name, value in answer.getheaders()
                if name.lower() not in ('connection', 'transfer-encoding', 'content-length', 'date',
                                        'keep-alive')}
        if request.method == 'HEAD':
            kept['Content-Length'] = answer.getheader('content-length', '0')
        connection.close()
        return Answer(answer.status, body, kept)


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = 'HTTP/1.1'
    timeout = 60

    def log_message(self, *arguments):
        pass

    def handle(self):
        with contextlib.suppress(ConnectionError):  # Clients are killed here.
            super().handle()

    def _serve(self):
        store = self.server.store
        length = int(self.headers.get('content-length', 0))
        body = self.rfile.read(length)
        if len(body) < length:  # The client went away: nothing of it is kept.
            self.close_connection = True
            return
        headers = {name.lower(): value for name, value in self.headers.items()}
        request = Request(self.command, self.path, headers, body)
        with store.lock:
            store.requests.append(request)
            fault = next((f for f in store.faults if f.left > 0 and f.takes(request)), None)
            if fault:
                fault.left -= 1
        if fault:
            answer = fault.act(self, request)
            if answer is None:
                self.close_connection = True
                return
        else:
            answer = store.answer(request)
        self.send(request, answer)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = _serve

    def send(self, request, answer, cut=None):
        """Sends an answer, or the first `cut` bytes of its body."""
        self.send_response(answer.status)
        for name, value in answer.headers.items():
            self.send_header(name, value)
        if 'Content-Length' not in answer.headers:
            self.send_header('Content-Length', str(len(answer.body)))
        self.end_headers()
        if request.method != 'HEAD':
            with contextlib.suppress(OSError):
                self.wfile.write(answer.body[:cut])


class Store:
    """Answers on a free port of loopback until it is closed."""

    def __init__(self, backend=None, region=REGION):
        self.backend = backend or Memory()
        self.region, self.keys = region, dict(KEYS)
        self.requests, self.faults = [], []
        self.lock = threading.Lock()
        self.server = http.server.ThreadingHTTPServer(('127.0.0.1', 0), Handler)
        self.server.daemon_threads = True
        self.server.store = self
        self.port = self.server.server_port
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.01,),
                                       daemon=True)
        self.thread.start()

    @property
    def endpoint(self):
        return f'http://127.0.0.1:{self.port}'

    def environment(self, **more):
        """Of a client: nothing of the caller's own AWS settings, one try a tenth of a second."""
        return {'AWS_ACCESS_KEY_ID': 'KEYOFTESTS', 'AWS_SECRET_ACCESS_KEY': KEYS['KEYOFTESTS'],
                'AWS_REGION': self.region, 'AWS_ENDPOINT_URL_S3': self.endpoint,
                'AWS_CONFIG_FILE': '/dev/null', 'AWS_SHARED_CREDENTIALS_FILE': '/dev/null',
                'no_proxy': '127.0.0.1', **more}

    def answer(self, request):
        try:
            signature.check(request.method, request.target, request.headers, request.body,
                            self.keys, self.region)
        except signature.Refused as refused:
            more = f'<Region>{self.region}</Region>' if 'Malformed' in refused.code else ''
            status = 400 if 'Mismatch' in refused.code or 'Malformed' in refused.code else 403
            return refusal(status, refused.code, str(refused), more)
        return self.backend.handle(request)

    def fail(self, takes, act, times=1):
        with self.lock:
            self.faults.append(Fault(takes, act, times))

    def count(self, method, part=''):
        with self.lock:
            return sum(r.method == method and part in r.target for r in self.requests)

    def forget(self):
        with self.lock:
            self.requests.clear()
            self.faults.clear()

    def close(self):
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()


class Blocked:
    """Holds back what the store does with one request, or with its answer, until it is let go."""

    def __init__(self, store, takes, before=True, times=1):
        self.came, self.go, self.done = (threading.Event() for _ in range(3))
        self.before = before
        store.fail(takes, self.act, times)

    def act(self, handler, request):
        answer = None if self.before else handler.server.store.answer(request)
        self.came.set()
        self.go.wait(120)
        answer = answer or handler.server.store.answer(request)
        self.done.set()
        return answer

    def wait(self):
        assert self.came.wait(60), 'the request never came'


def hang_up(handler, request):
    """The connection breaks without an answer."""
    with contextlib.suppress(OSError):
        handler.connection.shutdown(socket.SHUT_RDWR)


def cut_after(count):
    """The right answer, whose body breaks off after `count` bytes."""
    def act(handler, request):
        handler.send(request, handler.server.store.answer(request), count)
        handler.wfile.flush()
        hang_up(handler, request)
    return act


def slow_down(seconds=None):
    headers = {} if seconds is None else {'Retry-After': str(seconds)}
    return lambda handler, request: refusal(503, 'SlowDown', 'Please reduce your request rate.',
                                            headers=headers)
