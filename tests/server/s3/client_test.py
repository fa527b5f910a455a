"""The client of buckets against a store that checks signatures and fails on demand."""
import argparse
import os
import pathlib
import random
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.parse

import signature
from store import KEYS, Answer, Store, cut_after, hang_up, refusal, slow_down

ARGUMENTS = {}
MIB = 1 << 20
# Names that have broken clients: of paths, of encodings, of query strings, of shells.
AWKWARD = ['plain.ply', 'a b.ply', 'a+b.ply', 'a%20b.ply', '100%', 'ünïcode/模型.ply', 'a//b.ply',
           '../up.ply', 'a/../b.ply', './c.ply', '/lead.ply', 'tail/', 'q?x=1&y=2', 'h#ash', "it's",
           'a*(b)!.ply', 'tilde~', 'semi;colon', 'com,ma', 'eq=ual', 'at@', 'dollar$', 'co:lon',
           '<tag>&amp;', 'quote"', 'back\\slash', ' lead', 'trail ', 'x' * 1024]


def percent_encoded(key):
    return urllib.parse.quote(key, safe='')


def wait_until(condition, what):
    deadline = time.monotonic() + 300
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f'waited 300 s for: {what}')
        select.select([], [], [], 0.01)


class ClientTest(unittest.TestCase):
    def setUp(self):
        self.store = Store()
        self.addCleanup(self.store.close)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    @property
    def objects(self):
        return self.store.backend.objects

    def environment(self, **more):
        return {'PATH': os.environ['PATH'], 'HOME': str(self.folder),
                **self.store.environment(**more)}

    def run_tool(self, *arguments, **more):
        return subprocess.run([ARGUMENTS['tool'], *map(str, arguments)], capture_output=True,
                              text=True, timeout=600, env=self.environment(**more))

    def tool(self, *arguments, **more):
        done = self.run_tool(*arguments, **more)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def refused(self, status, *arguments, **more):
        """The message of a call that must fail so; no secret may be in it."""
        done = self.run_tool(*arguments, **more)
        self.assertEqual(done.returncode, status, (done.stdout, done.stderr))
        for secret in [KEYS['KEYOFTESTS'], 'KEYOFTESTS', 'TOKEN/OF/TESTS']:
            self.assertNotIn(secret, done.stderr)
        self.assertTrue(done.stderr.endswith('\n') and done.stderr.count('\n') == 1, done.stderr)
        return done.stderr

    def put(self, key, body, bucket='bucket'):
        self.store.backend._put(
            type('Put', (), {'bucket': bucket, 'key': key, 'body': body, 'headers': {}})())

    def file(self, size, name='file'):
        seed = random.randrange(1 << 32)
        print(f'{self.id()}: {size} bytes of seed {seed}')
        path = self.folder / name
        path.write_bytes(random.Random(seed).randbytes(size))
        return path

    def fetch(self, key, **more):
        target = self.folder / 'fetched'
        self.tool('get', f's3://bucket/{key}', target, **more)
        return target.read_bytes()


class Conditions(ClientTest):
    def test_only_one_of_several_puts_what_nobody_has_put(self):
        new = ('new', 's3://bucket/key')
        self.assertEqual(self.tool(*new, 'first'), 'put\n')
        self.assertEqual(self.tool(*new, 'second'), 'there\n')
        self.assertEqual(self.objects['bucket', 'key'][0], b'first')
        self.store.fail(lambda r: r.method == 'PUT',
                        lambda *_: refusal(409, 'ConditionalRequestConflict'))
        self.assertEqual(self.tool(*new, 'third'), 'there\n', 'a conflict passes')

    def test_a_store_without_conditions_gets_a_plain_put(self):
        self.put('key', b'former')
        self.store.fail(lambda r: 'if-none-match' in r.headers,
                        lambda *_: refusal(501, 'NotImplemented'))
        self.assertEqual(self.tool('new', 's3://bucket/key', 'text'), 'put\n')
        self.assertEqual(self.objects['bucket', 'key'][0], b'text')

    def test_what_is_refused_for_another_reason_is_not_put(self):
        self.store.fail(lambda r: r.method == 'PUT', lambda *_: refusal(403, 'AccessDenied'))
        self.assertIn('AccessDenied', self.refused(3, 'new', 's3://bucket/key', 'text'))
        self.assertEqual(self.objects, {})


class Ranges(ClientTest):
    def test_are_of_one_version_where_one_is_named(self):
        self.put('key', b'0123456789')
        read = ('read', 's3://bucket/key', 3, 4)
        tag = self.objects['bucket', 'key'][1]
        self.assertEqual(self.tool(*read), '3456')
        self.assertEqual(self.tool(*read, tag), '3456')
        self.put('key', b'abcdefghij')
        self.assertEqual(self.tool(*read), 'defg')
        self.assertIn('was replaced while it was read', self.refused(9, *read, tag))
        self.put('key', b'ab')
        self.assertIn('was replaced while it was read', self.refused(9, *read, tag))

    def test_are_of_one_version_of_a_store_that_does_not_mind_if_match(self):
        self.put('key', b'abcdefghij')

        def careless(handler, request):
            request.headers.pop('if-match')
            return self.store.backend.handle(request)
        self.store.fail(lambda r: r.method == 'GET', careless)
        self.assertIn('was replaced while it was read',
                      self.refused(9, 'read', 's3://bucket/key', 3, 4, 32 * '0'))


class Signature(ClientTest):
    def test_the_oracle_reproduces_the_published_examples(self):
        self.assertEqual(signature.published_examples_hold(), [True] * 4)

    def test_awkward_keys_are_signed_stored_listed_and_fetched(self):
        path = self.file(1000)
        for key in AWKWARD:
            with self.subTest(key=key[:40]):
                percent = percent_encoded(key)
                self.tool('put%', f's3://bucket/{percent}', path)
                self.assertEqual(self.objects['bucket', key][0], path.read_bytes())
                self.tool('get%', f's3://bucket/{percent}', self.folder / 'back')
                self.assertEqual((self.folder / 'back').read_bytes(), path.read_bytes())
                self.tool('head%', f's3://bucket/{percent}')
                listed = self.tool('list%', f's3://bucket/{percent}').split(' ')[0]
                self.assertEqual(signature.canonical_path(listed), listed)
                self.assertIn(f'{listed} 1000 ', self.tool('list', 's3://bucket'))
        self.assertEqual(len(self.tool('list', 's3://bucket').splitlines()), len(AWKWARD))
        for key in AWKWARD:
            self.tool('delete%', 's3://bucket/' + percent_encoded(key))
        self.assertEqual(self.objects, {})

    def test_a_session_token_is_signed(self):
        self.put('a', b'1')
        self.tool('head', 's3://bucket/a', AWS_SESSION_TOKEN='TOKEN/OF/TESTS')
        self.assertEqual(self.store.requests[0].headers['x-amz-security-token'], 'TOKEN/OF/TESTS')

    def test_a_wrong_secret_is_explained(self):
        message = self.refused(3, 'head', 's3://bucket/a', AWS_SECRET_ACCESS_KEY='wrong')
        self.assertIn('403', message)
        message = self.refused(3, 'list', 's3://bucket/a', AWS_SECRET_ACCESS_KEY='wrong')
        self.assertIn('s3://bucket/a: the store answered 403 SignatureDoesNotMatch', message)
        self.assertIn('check AWS_SECRET_ACCESS_KEY', message)
        self.assertEqual(self.store.count('GET'), 1, 'a refusal is not tried again')

    def test_an_unknown_key_is_explained(self):
        message = self.refused(3, 'list', 's3://bucket', AWS_ACCESS_KEY_ID='NOBODY')
        self.assertIn('InvalidAccessKeyId', message)
        self.assertIn('check AWS_ACCESS_KEY_ID', message)

    def test_a_wrong_clock_is_explained(self):
        date = {'Date': 'Thu, 01 Jan 2026 00:00:00 GMT'}

        def skewed(handler, request):
            handler.date_time_string = lambda: date['Date']
            return refusal(403, 'RequestTimeTooSkewed', 'The difference is too large.')
        self.store.fail(lambda r: True, skewed)
        message = self.refused(3, 'list', 's3://bucket')
        self.assertRegex(message, r"clock and the store's differ by \d+ s \(this one is ahead\)")

    def test_the_region_that_the_store_names_is_taken(self):
        self.put('a', b'1')
        self.tool('list', 's3://bucket', AWS_REGION='elsewhere-2')
        self.assertEqual([('elsewhere-2' in r.headers['authorization']) for r in
                          self.store.requests], [True, False])

    def test_a_redirect_is_followed_once_and_signed_anew(self):
        other = Store()
        self.addCleanup(other.close)
        other.backend.objects['bucket', 'a'] = b'1', 'tag'
        self.store.fail(lambda r: True, lambda h, r: Answer(
            307, headers={'Location': other.endpoint + r.target}), times=9)
        self.assertEqual(self.tool('head', 's3://bucket/a'), 'a 1 tag\n')
        other.fail(lambda r: True, lambda h, r: Answer(
            307, headers={'Location': other.endpoint + r.target}), times=9)
        self.assertIn('a redirect that leads nowhere', self.refused(8, 'head', 's3://bucket/a'))

    def test_a_redirect_to_another_machine_in_the_clear_is_not_followed(self):
        self.store.fail(lambda r: True, lambda h, r: Answer(
            307, headers={'Location': 'http://192.0.2.1/bucket/a'}))
        self.refused(8, 'head', 's3://bucket/a')


class Settings(ClientTest):
    def test_plain_http_to_another_machine_is_refused(self):
        message = self.refused(2, 'list', 's3://bucket',
                               AWS_ENDPOINT_URL_S3='http://store.example:9000')
        self.assertIn('--s3-insecure', message)

    def test_a_profile_of_the_files_is_used(self):
        self.put('a', b'1')
        (self.folder / 'credentials').write_text(
            '[default]\naws_access_key_id = NOBODY\naws_secret_access_key = x\n\n# mine\n[mine]\n'
            f'aws_access_key_id = KEYOFTESTS\naws_secret_access_key={KEYS["KEYOFTESTS"]}\n')
        (self.folder / 'config').write_text(
            f'[profile mine]\nregion = {self.store.region}\nendpoint_url = {self.store.endpoint}\n'
            's3 =\n  addressing_style = path\n')
        files = {'AWS_SHARED_CREDENTIALS_FILE': str(self.folder / 'credentials'),
                 'AWS_CONFIG_FILE': str(self.folder / 'config'), 'AWS_ACCESS_KEY_ID': '',
                 'AWS_SECRET_ACCESS_KEY': '', 'AWS_REGION': '', 'AWS_ENDPOINT_URL_S3': ''}
        self.assertIn('a 1 ', self.tool('list', 's3://bucket', AWS_PROFILE='mine', **files))
        self.refused(3, 'list', 's3://bucket', **{**files, 'AWS_REGION': self.store.region,
                                                  'AWS_ENDPOINT_URL_S3': self.store.endpoint})
        self.assertIn("profile 'none'",
                      self.refused(2, 'list', 's3://bucket', AWS_PROFILE='none', **files))

    def test_a_malformed_file_is_named_with_its_line_and_not_quoted(self):
        path = self.folder / 'credentials'
        path.write_text('[default]\n' + KEYS['KEYOFTESTS'].replace('=', '') + '\n')
        message = self.refused(4, 'list', 's3://bucket', AWS_SHARED_CREDENTIALS_FILE=str(path))
        self.assertIn(f'{path}:2: expected', message)
        self.assertNotIn('secret/of', message)


class Trouble(ClientTest):
    def test_throttling_passes(self):
        self.put('a', b'1')
        self.store.fail(lambda r: True, slow_down(), times=3)
        self.assertEqual(self.fetch('a'), b'1')
        self.assertEqual(self.store.count('GET'), 4)

    def test_retry_after_is_obeyed(self):
        self.put('a', b'1')
        self.store.fail(lambda r: True, slow_down(1))
        began = time.monotonic()
        self.tool('head', 's3://bucket/a')
        self.assertGreaterEqual(time.monotonic() - began, 1.0)

    def test_it_gives_up_after_as_many_tries_as_are_allowed(self):
        self.store.fail(lambda r: True, slow_down(), times=99)
        message = self.refused(8, 'head', 's3://bucket/a', AWS_MAX_ATTEMPTS='3')
        self.assertIn('503', message)
        self.assertIn('after 3 tries', message)
        self.assertEqual(self.store.count('HEAD'), 3)

    def test_broken_connections_pass(self):
        self.put('a', b'1')
        self.store.fail(lambda r: True, hang_up, times=2)
        self.assertEqual(self.fetch('a'), b'1')
        path = self.file(100_000)
        self.store.fail(lambda r: r.method == 'PUT', hang_up, times=2)
        self.tool('put', 's3://bucket/b', path)
        self.assertEqual(self.objects['bucket', 'b'][0], path.read_bytes())

    def test_a_store_that_is_gone_is_reported(self):
        with socket.socket() as gone:
            gone.bind(('127.0.0.1', 0))  # Bound, not listening: connections are refused.
            endpoint = f'http://127.0.0.1:{gone.getsockname()[1]}'
            message = self.refused(8, 'head', 's3://bucket/a', AWS_ENDPOINT_URL_S3=endpoint,
                                   AWS_MAX_ATTEMPTS='2')
        self.assertIn('s3://bucket/a: ', message)

    def test_a_broken_transfer_goes_on_where_it_broke(self):
        body = self.file(3 * MIB).read_bytes()
        self.put('a', body)
        for cut in (MIB, MIB // 2):
            self.store.fail(lambda r: r.method == 'GET', cut_after(cut))
        self.assertEqual(self.fetch('a'), body)
        gets = [r for r in self.store.requests if r.method == 'GET']
        self.assertEqual([r.headers.get('range') for r in gets],
                         [None, f'bytes={MIB}-', f'bytes={MIB + MIB // 2}-'])
        self.assertEqual(gets[1].headers['if-match'].strip('"'), self.objects['bucket', 'a'][1])

    def test_what_was_replaced_meanwhile_is_fetched_from_its_start(self):
        before, after = self.file(2 * MIB).read_bytes(), self.file(MIB // 3).read_bytes()
        self.put('a', before)

        def cut_and_replace(handler, request):
            result = cut_after(MIB)(handler, request)
            self.put('a', after)
            return result
        self.store.fail(lambda r: r.method == 'GET', cut_and_replace)
        self.assertEqual(self.fetch('a'), after)

    def test_bytes_that_do_not_match_the_tag_are_fetched_again(self):
        body = self.file(MIB).read_bytes()
        self.put('a', body)

        def corrupt(handler, request):
            answer = self.store.answer(request)
            answer.body = answer.body[:-1] + bytes([answer.body[-1] ^ 1])
            return answer
        self.store.fail(lambda r: r.method == 'GET', corrupt)
        self.assertEqual(self.fetch('a'), body)
        self.store.fail(lambda r: r.method == 'GET', corrupt, times=99)
        message = self.refused(8, 'get', 's3://bucket/a', self.folder / 'x', AWS_MAX_ATTEMPTS='2')
        self.assertIn('has the MD5', message)

    def test_an_object_above_the_limit_is_not_fetched(self):
        self.put('a', bytes(1000))
        self.assertIn('1000 bytes, of which 999', self.refused(
            7, 'get', 's3://bucket/a', self.folder / 'x', 999))

    def test_an_empty_object_is_fetched(self):
        self.put('a', b'')
        self.assertEqual(self.fetch('a'), b'')

    def test_a_missing_object_is_reported(self):
        self.assertIn('s3://bucket/none: no such object',
                      self.refused(3, 'get', 's3://bucket/none', self.folder / 'x'))

    def test_a_store_that_repeats_secrets_does_not_get_them_into_messages(self):
        self.store.fail(lambda r: True, lambda h, r: refusal(
            400, 'Odd', f'{KEYS["KEYOFTESTS"]} KEYOFTESTS TOKEN/OF/TESTS\n'))
        self.assertIn('***', self.refused(8, 'list', 's3://bucket',
                                          AWS_SESSION_TOKEN='TOKEN/OF/TESTS'))


class Listing(ClientTest):
    def test_pages_are_joined(self):
        self.store.backend.page = 1000
        keys = [f'many/{i:05}.ply' for i in range(2500)]
        for key in keys:
            self.put(key, b'')
        self.put('other', b'')
        listed = [line.split(' ')[0] for line in self.tool('list', 's3://bucket/many/').splitlines()]
        self.assertEqual(listed, keys)
        self.assertEqual(self.store.count('GET'), 3)

    def answer_with(self, xml):
        self.store.fail(lambda r: True, lambda h, r: Answer(200, xml), times=99)
        return self.refused(4, 'list', 's3://bucket/a')

    def test_a_list_that_does_not_advance_ends(self):
        page = ('<ListBucketResult><IsTruncated>true</IsTruncated><NextContinuationToken>t'
                '</NextContinuationToken>{}</ListBucketResult>')
        entry = '<Contents><Key>a</Key><Size>1</Size></Contents>'
        self.assertIn('does not advance', self.answer_with(page.format('')))
        self.store.forget()
        self.assertIn('does not advance', self.answer_with(page.format(entry)))

    def test_entities_are_not_expanded(self):
        bomb = '<!DOCTYPE l [<!ENTITY a "aaaaaaaaaa">' + ''.join(
            f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip('abcdefgh', 'bcdefghi')) + ']>'
        xml = (bomb + '<ListBucketResult><Contents><Key>a&i;</Key><Size>1</Size></Contents>'
               '</ListBucketResult>')
        self.store.fail(lambda r: True, lambda h, r: Answer(200, xml))
        self.assertEqual(self.tool('list', 's3://bucket/a'), 'a%26i%3B 1 \n')

    def test_what_is_no_list_is_refused(self):
        for xml in ('', '<html>', '<html/>', '<ListBucketResult><Contents><Key>a</Key><Size>-1</Size>'
                    '</Contents></ListBucketResult>',
                    '<ListBucketResult><Contents><Key>b</Key><Size>1</Size></Contents>'
                    '</ListBucketResult>'):
            with self.subTest(xml=xml):
                self.store.forget()
                self.answer_with(xml)

    def test_an_answer_without_end_is_broken_off(self):
        self.store.fail(lambda r: True, lambda h, r: Answer(200, b' ' * (17 * MIB)), times=99)
        self.assertIn('more than 16 MiB', self.refused(8, 'list', 's3://bucket'))


class Parts(ClientTest):
    def setUp(self):
        super().setUp()
        self.path = self.file(20 * MIB)

    def put_parts(self, **more):
        return self.tool('put', 's3://bucket/large', self.path, **more)

    def assert_whole(self):
        self.assertEqual(self.objects['bucket', 'large'][0], self.path.read_bytes())
        self.assertEqual(self.store.backend.uploads, {})

    def assert_nothing(self):
        self.assertEqual(self.objects, {})
        self.assertEqual(self.store.backend.uploads, {})

    def test_a_large_file_goes_in_parts_and_is_one_object(self):
        self.assertTrue(self.put_parts().endswith('-3\n'))
        self.assert_whole()
        self.assertEqual(self.fetch('large'), self.path.read_bytes())

    def test_parts_that_fail_are_sent_again(self):
        self.store.fail(lambda r: 'partNumber=2' in r.target, slow_down(), times=2)
        self.store.fail(lambda r: 'partNumber=3' in r.target, hang_up)
        self.put_parts()
        self.assert_whole()

    def test_a_part_that_cannot_be_sent_leaves_nothing(self):
        self.store.fail(lambda r: 'partNumber=3' in r.target, slow_down(), times=99)
        self.refused(8, 'put', 's3://bucket/large', self.path, AWS_MAX_ATTEMPTS='2')
        self.assert_nothing()

    def test_an_error_after_200_is_an_error(self):
        late = '<Error><Code>InternalError</Code><Message>late</Message></Error>'
        takes = (lambda r: r.method == 'POST' and 'uploadId' in r.target)
        self.store.fail(takes, lambda h, r: Answer(200, late))
        self.put_parts()
        self.assert_whole()
        self.objects.clear()
        self.store.fail(takes, lambda h, r: Answer(200, late), times=99)
        self.assertIn('InternalError: late', self.refused(
            8, 'put', 's3://bucket/large', self.path, AWS_MAX_ATTEMPTS='2'))
        self.assert_nothing()

    def test_a_lost_answer_to_the_completion_is_made_up_for(self):
        def lose(handler, request):
            self.store.answer(request)
            hang_up(handler, request)
        self.store.fail(lambda r: r.method == 'POST' and 'uploadId' in r.target, lose)
        self.assertTrue(self.put_parts().endswith('-3\n'))
        self.assert_whole()

    def test_a_killed_upload_leaves_no_object_and_is_found_by_its_journal(self):
        journal = {'JOURNAL': str(self.folder / 'uploads')}
        held = []

        def hold(handler, request):
            held.append(request)
            wait_until(lambda: process.poll() is not None, 'the kill')
        self.store.fail(lambda r: 'partNumber=2' in r.target, hold)
        process = subprocess.Popen([ARGUMENTS['tool'], 'put', 's3://bucket/large', self.path],
                                   env=self.environment(**journal))
        wait_until(lambda: held, 'the second part')
        process.send_signal(signal.SIGKILL)
        process.wait()
        self.assertEqual(self.objects, {})
        self.assertEqual(len(self.store.backend.uploads), 1)
        self.assertEqual(self.tool('leftovers', 's3://bucket', **journal), '1\n')
        self.assert_nothing()
        self.assertEqual(self.tool('leftovers', 's3://bucket', **journal), '0\n')
        self.put_parts(**journal)
        self.assert_whole()

    def test_uploads_are_aborted_after_a_day_by_the_clock_of_the_store(self):
        uploads = self.store.backend.uploads
        uploads['old'] = 'bucket', 'out/a', '2020-01-01T00:00:00.000Z', {}
        uploads['new'] = 'bucket', 'out/b', '2099-01-01T00:00:00.000Z', {}
        uploads['not ours'] = 'bucket', 'other/a', '2020-01-01T00:00:00.000Z', {}
        self.assertEqual(self.tool('stale', 's3://bucket/out/', 86400), '1\n')
        self.assertEqual(sorted(uploads), ['new', 'not ours'])

    def test_a_store_that_cannot_list_uploads_is_no_error(self):
        self.store.fail(lambda r: True, lambda h, r: refusal(501, 'NotImplemented'))
        self.assertEqual(self.tool('stale', 's3://bucket/out/', 86400), '0\n')


class SecondClient(ClientTest):
    """boto3 reads what Strata writes, and the other way round: both are right, or wrong alike."""

    def setUp(self):
        super().setUp()
        try:
            import boto3
            import botocore.config
        except ImportError:
            self.skipTest('boto3 is missing: scripts/setup.sh test')
        self.boto = boto3.client(
            's3', endpoint_url=self.store.endpoint, region_name=self.store.region,
            aws_access_key_id='KEYOFTESTS', aws_secret_access_key=KEYS['KEYOFTESTS'],
            config=botocore.config.Config(s3={'addressing_style': 'path'},
                                          proxies={}, retries={'max_attempts': 0}))
        self.addCleanup(self.boto.close)

    def test_both_read_what_the_other_wrote(self):
        path = self.file(9 * MIB)
        for key in [key for key in AWKWARD if '..' not in key and '//' not in key]:
            percent = percent_encoded(key)
            with self.subTest(key=key[:40]):
                self.boto.put_object(Bucket='bucket', Key=key, Body=b'of boto')
                self.tool('get%', f's3://bucket/{percent}', self.folder / 'got')
                self.assertEqual((self.folder / 'got').read_bytes(), b'of boto')
        self.tool('put', 's3://bucket/large', path)
        self.assertEqual(self.boto.get_object(Bucket='bucket', Key='large')['Body'].read(),
                         path.read_bytes())
        listed = {entry['Key'] for entry in self.boto.list_objects_v2(Bucket='bucket')['Contents']}
        self.assertEqual(len(listed), len(self.tool('list', 's3://bucket').splitlines()))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--tool', required=True)
    parser.add_argument('--strata', help='the command, where a test needs it')
    known, rest = parser.parse_known_args()
    ARGUMENTS.update(vars(known))
    unittest.main(argv=[sys.argv[0], *rest])


if __name__ == '__main__':
    main()
