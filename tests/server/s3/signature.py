"""AWS Signature Version 4 for S3, from its description alone: the oracle for what libcurl signs."""
import hashlib
import hmac
import re
import urllib.parse


class Refused(Exception):
    """A request whose signature does not hold. `code` is S3's word for it."""

    def __init__(self, code, message):
        super().__init__(message)
        self.code = code


def sign(secret, date, region, string_to_sign):
    key = ('AWS4' + secret).encode()
    for part in (date, region, 's3', 'aws4_request'):
        key = hmac.new(key, part.encode(), hashlib.sha256).digest()
    return hmac.new(key, string_to_sign.encode(), hashlib.sha256).hexdigest()


def canonical_query(query):
    """Decodes and encodes anew, so that a request that is not in the canonical form shows."""
    pairs = []
    for part in filter(None, query.split('&')):
        name, _, value = part.partition('=')
        pairs.append(tuple(urllib.parse.quote(urllib.parse.unquote_to_bytes(text), safe='-_.~')
                           for text in (name, value)))
    return '&'.join(f'{name}={value}' for name, value in sorted(pairs))


def canonical_path(path):
    return urllib.parse.quote(urllib.parse.unquote_to_bytes(path), safe='/-_.~')


def signature_of(method, target, headers, signed, secret, region):
    """The signature of a request. `headers`: names in small letters; `signed`: those that count."""
    path, _, query = target.partition('?')
    lines = ''.join(f'{name}:{re.sub(" +", " ", headers[name].strip())}\n' for name in signed)
    request = '\n'.join([method, canonical_path(path), canonical_query(query), lines,
                         ';'.join(signed), headers['x-amz-content-sha256']])
    when = headers['x-amz-date']
    scope = f'{when[:8]}/{region}/s3/aws4_request'
    digest = hashlib.sha256(request.encode()).hexdigest()
    text = f'AWS4-HMAC-SHA256\n{when}\n{scope}\n{digest}'
    return sign(secret, when[:8], region, text)


AUTHORIZATION = re.compile(r'AWS4-HMAC-SHA256 Credential=([^/]+)/(\d{8})/([^/]+)/s3/aws4_request, ?'
                           r'SignedHeaders=([^,]+), ?Signature=([0-9a-f]{64})')


def check(method, target, headers, body, keys, region):
    """Raises Refused unless the request is signed with one of `keys` (id -> secret) for `region`."""
    match = AUTHORIZATION.fullmatch(headers.get('authorization', ''))
    if not match:
        raise Refused('AccessDenied', 'Access Denied')
    key, date, scope_region, names, signature = match.groups()
    if key not in keys:
        raise Refused('InvalidAccessKeyId', 'The access key id does not exist in our records.')
    if scope_region != region:
        raise Refused('AuthorizationHeaderMalformed', f'expecting {region}')
    signed = names.split(';')
    must = {name for name in headers if name.startswith('x-amz-')} | {'host'}
    if signed != sorted(signed) or not must <= set(signed):
        raise Refused('AccessDenied', f'unsigned: {must - set(signed)}')
    missing = set(signed) - set(headers)
    if missing or date != headers['x-amz-date'][:8]:
        raise Refused('SignatureDoesNotMatch', f'signed but not sent: {missing}')
    if signature_of(method, target, headers, signed, keys[key], region) != signature:
        raise Refused('SignatureDoesNotMatch', 'The signature does not match.')
    declared = headers['x-amz-content-sha256']
    if declared != 'UNSIGNED-PAYLOAD' and declared != hashlib.sha256(body).hexdigest():
        raise Refused('XAmzContentSHA256Mismatch', 'The body is not what was signed.')


EMPTY = hashlib.sha256(b'').hexdigest()
# The examples of AWS's page "Signature Calculations for the Authorization Header".
SECRET = 'wJalrXUtnFEMI/K7MDENG/bPxRfiCYEXAMPLEKEY'
COMMON = {'host': 'examplebucket.s3.amazonaws.com', 'x-amz-date': '20130524T000000Z'}
PUBLISHED = [
    ('GET', '/test.txt', {**COMMON, 'range': 'bytes=0-9', 'x-amz-content-sha256': EMPTY},
     'f0e8bdb87c964420e857bd35b5d6ed310bd44f0170aba48dd91039c6036bdb41'),
    ('PUT', '/test$file.text',
     {**COMMON, 'date': 'Fri, 24 May 2013 00:00:00 GMT',
      'x-amz-storage-class': 'REDUCED_REDUNDANCY',
      'x-amz-content-sha256': hashlib.sha256(b'Welcome to Amazon S3.').hexdigest()},
     '98ad721746da40c64f1a55b78f14c238d841ea1380cd77a1b5971af0ece108bd'),
    ('GET', '/?lifecycle', {**COMMON, 'x-amz-content-sha256': EMPTY},
     'fea454ca298b7da1c68078a5d1bdbfbbe0d65c699e0f91ac7a200a0136783543'),
    ('GET', '/?max-keys=2&prefix=J', {**COMMON, 'x-amz-content-sha256': EMPTY},
     '34b48302e7b5fa45bde8084f4b7868a86f0a534bc59db6670ed5711ef69dc6f7'),
]


def published_examples_hold():
    return [signature_of(method, target, headers, sorted(headers), SECRET, 'us-east-1') == expected
            for method, target, headers, expected in PUBLISHED]
