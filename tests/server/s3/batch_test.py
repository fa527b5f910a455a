"""`strata batch` from buckets and into them: the same bytes as with folders, and nothing lost."""
import argparse
import hashlib
import http.client
import json
import math
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import unittest

from client_test import MIB, wait_until
from store import KEYS, Blocked, Store, cut_after, hang_up, refusal, slow_down

ARGUMENTS = {}
MODELS = 30
OPTIONS = ['--quiet', '--pictures', '3']
SMALL = ['--resolution', '24']


def sphere(rings, seed):
    """A bumpy sphere as OFF."""
    bumps = random.Random(seed)
    phase, height = bumps.uniform(0, 6), bumps.uniform(0.05, 0.3)
    corners, faces = [], []
    for i in range(rings + 1):
        for j in range(2 * rings):
            polar, around = math.pi * i / rings, math.pi * j / rings
            radius = 1 + height * math.sin(3 * polar + phase) * math.cos(4 * around)
            corners.append(f'{radius * math.sin(polar) * math.cos(around):.6f} '
                           f'{radius * math.sin(polar) * math.sin(around):.6f} '
                           f'{radius * math.cos(polar):.6f}')
            if i < rings:
                a, b = i * 2 * rings + j, i * 2 * rings + (j + 1) % (2 * rings)
                faces.append(f'3 {a} {b} {a + 2 * rings}')
                faces.append(f'3 {b} {b + 2 * rings} {a + 2 * rings}')
    return f'OFF\n{len(corners)} {len(faces)} 0\n' + '\n'.join(corners + faces) + '\n'


class BatchTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        """The models, and what a batch in folders makes of them."""
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.local = pathlib.Path(folder.name)
        seed = random.randrange(1 << 32)
        print(f'models of seed {seed}')
        cls.models = {}
        for i in range(MODELS):
            name = ['plain/{}.off', 'with space/{} +%.off', 'ünïcode/{}.off'][i % 3].format(i)
            cls.models[name] = sphere(8 + i % 5, seed + i).encode()
        cls.models['broken/cut.off'] = cls.models['plain/0.off'][:200]
        cls.models['plain/strata.toml'] = b'seed = 7\n'
        for name, body in cls.models.items():
            path = cls.local / 'models' / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(body)
        done = subprocess.run([ARGUMENTS['strata'], 'batch', cls.local / 'models', '-o',
                               cls.local / 'out', *OPTIONS, *SMALL], capture_output=True, text=True)
        assert done.returncode == 1, done.stderr  # One model is broken.
        cls.outputs = {str(path.relative_to(cls.local / 'out')): path.read_bytes()
                       for path in (cls.local / 'out').rglob('*.drc')}
        assert len(cls.outputs) == MODELS, sorted(cls.outputs)

    def setUp(self):
        self.store = Store()
        self.addCleanup(self.store.close)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        for name, body in self.models.items():
            self.put('models', name, body)

    def put(self, bucket, key, body):
        tag = hashlib.md5(body).hexdigest()
        self.store.backend.objects[bucket, key] = body, tag

    def objects(self, bucket, suffix=''):
        with self.store.backend.lock:
            return {key: body for (place, key), (body, _) in self.store.backend.objects.items()
                    if place == bucket and key.endswith(suffix)}

    def environment(self, home='home', **more):
        return {'PATH': os.environ['PATH'], 'HOME': str(self.folder / home),
                **self.store.environment(**more)}

    def start(self, source='s3://models', output='s3://outputs/run', *options, **more):
        return subprocess.Popen(
            [ARGUMENTS['strata'], 'batch', source, '-o', output, *OPTIONS,
             *([] if '--resolution' in options else SMALL), *options],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=self.environment(**more))

    def batch(self, *arguments, status=1, **more):
        process = self.start(*arguments, **more)
        out, err = process.communicate(timeout=600)
        self.assertEqual(process.returncode, status, (out, err))
        for secret in [KEYS['KEYOFTESTS'], 'KEYOFTESTS']:
            self.assertNotIn(secret, out + err)
        return err

    def outputs_in_bucket(self):
        return {key.removeprefix('run/'): body for key, body in
                self.objects('outputs', '.drc').items()}

    def manifest(self):
        text = self.objects('outputs')['run/manifest.jsonl'].decode()
        return {line['path']: line for line in map(json.loads, text.splitlines())}

    def fetched(self):
        """The models that were fetched since the last `forget`."""
        return [r.key for r in self.store.requests
                if r.method == 'GET' and r.bucket == 'models' and r.key.endswith('.off')]

    def assert_complete(self):
        self.assertEqual(self.outputs_in_bucket().keys(), self.outputs.keys())
        for name, body in self.outputs_in_bucket().items():
            self.assertEqual(body, self.outputs[name], name)
        lines = self.manifest()
        self.assertEqual(len(lines), MODELS + 1)
        for line in lines.values():
            if line['path'] != 'broken/cut.off':
                self.assertEqual(hashlib.sha256(self.outputs[line['output']]).hexdigest(),
                                 line['output_sha256'])
        self.assertEqual(self.store.backend.uploads, {})


class FromBucketToBucket(BatchTest):
    def test_the_bytes_are_those_of_a_local_run(self):
        self.batch()
        self.assert_complete()
        self.assertEqual(len(self.objects('outputs', '.png')), 3)
        self.assertIn('broken/cut.off', [line['path'] for line in self.manifest().values()
                                         if line['status'] != 'sampled'])
        left = [path for path in self.folder.rglob('*') if path.suffix in ('.off', '.drc')]
        self.assertEqual(left, [], 'nothing of models and outputs stays on this machine')

    def test_a_report_reads_the_bucket_and_puts_its_page_there(self):
        self.batch()
        done = subprocess.run([ARGUMENTS['strata'], 'report', 's3://outputs/run'], text=True,
                              capture_output=True, timeout=600,
                              env=self.environment(TMPDIR=str(self.folder)))
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn(str(MODELS), done.stdout)
        page = self.objects('outputs')['run/report.html'].decode()
        self.assertIn('s3://outputs/run', page)
        self.assertEqual(page.count('data:image/png'), 3)
        self.assertEqual([str(path) for path in self.folder.glob('strata-report*')], [])

    def test_nothing_is_fetched_or_put_twice(self):
        self.batch()
        self.store.forget()
        self.batch()
        self.assertEqual(self.fetched(), [])
        self.assertEqual([r.key for r in self.store.requests
                          if r.method == 'PUT' and r.key.endswith('.drc')], [])
        self.assert_complete()

    def test_another_machine_goes_on_from_the_manifest_in_the_bucket(self):
        self.batch()
        self.store.forget()
        self.batch(home='another')
        self.assertEqual(self.fetched(), [])
        self.assert_complete()

    def test_one_changed_object_is_one_redone(self):
        self.batch()
        self.put('models', 'plain/3.off', self.models['plain/3.off'] + b'\n')
        self.store.forget()
        self.batch()
        self.assertEqual(self.fetched(), ['plain/3.off'])
        self.assert_complete()

    def test_an_output_that_is_gone_is_redone(self):
        self.batch()
        del self.store.backend.objects['outputs', 'run/plain/3.off.drc']
        self.store.forget()
        self.batch()
        self.assertEqual(self.fetched(), ['plain/3.off'])
        self.assert_complete()

    def test_the_newest_line_of_two_machines_counts(self):
        self.batch()
        self.batch(home='another')
        self.put('models', 'plain/3.off', self.models['plain/6.off'])
        self.batch(home='another')
        self.store.forget()
        self.batch()
        self.assertEqual(self.fetched(), [])
        self.assertEqual(self.outputs_in_bucket()['plain/3.off.drc'],
                         self.outputs['plain/6.off.drc'])

    def test_another_shares_manifest_is_not_replaced_by_the_copy_that_was_read(self):
        whole = 's3://models', 's3://outputs/run'
        done = self.start(*whole, '--share', '0/2', home='first')
        done.communicate(timeout=600)
        key = 'outputs', 'run/manifest-0-of-2.jsonl'
        grown = self.store.backend.objects[key][0] + b'{"path": "the other goes on"\n'

        def grow(handler, request):  # While the second one runs.
            self.put(*key, grown)
            return self.store.backend.handle(request)
        self.store.fail(lambda r: r.method == 'PUT' and '.drc' in r.target, grow)
        second = self.start(*whole, '--share', '1/2', home='second')
        out, err = second.communicate(timeout=600)
        self.assertIn(second.returncode, (0, 1), (out, err))
        self.assertEqual(self.store.backend.objects[key][0], grown)
        self.assertIn(('outputs', 'run/manifest-1-of-2.jsonl'), self.store.backend.objects)

    def test_lines_of_a_process_that_went_on_meanwhile_are_not_replaced(self):
        key = 'outputs', 'run/manifest.jsonl'

        def other(handler, request):
            self.put(*key, b'')
            return self.store.backend.handle(request)
        self.store.fail(lambda r: r.method == 'PUT' and '.drc' in r.target, other)
        self.assertIn('another process has written it', self.batch(status=9))
        self.assertEqual(self.store.backend.objects[key][0], b'')
        self.batch()  # Takes what it had, and what is there.
        self.assert_complete()

    def test_prune_removes_what_has_no_model_any_more(self):
        self.batch()
        self.put('outputs', 'run/mine.txt', b'not of the batch')
        del self.store.backend.objects['models', 'plain/3.off']
        self.batch('s3://models', 's3://outputs/run', '--prune')
        self.assertNotIn('plain/3.off.drc', self.outputs_in_bucket())
        self.assertEqual(len(self.outputs_in_bucket()), MODELS - 1)
        self.assertIn('run/mine.txt', self.objects('outputs'))

    def test_tiles_are_put_before_the_file_that_names_them(self):
        options = ['--resolution', '60', '--tile-samples', '1000', '--include', 'plain/0.off']
        subprocess.run([ARGUMENTS['strata'], 'batch', self.local / 'models', '-o',
                        self.folder / 'tiles', *OPTIONS, *options], check=True)
        expected = {str(path.relative_to(self.folder / 'tiles')): path.read_bytes()
                    for path in (self.folder / 'tiles/plain').rglob('*') if path.is_file()}
        self.assertGreater(len(expected), 3)
        self.batch('s3://models', 's3://outputs/run', *options, status=0)
        self.assertEqual({key.removeprefix('run/'): body for key, body in
                          self.objects('outputs').items() if '/plain/' in key}, expected)
        put = [r.key for r in self.store.requests if r.method == 'PUT' and '/plain/' in r.key]
        self.assertTrue(put[-1].endswith('tileset.json'), put)
        self.store.forget()
        self.batch('s3://models', 's3://outputs/run', *options, status=0)
        self.assertEqual(self.fetched(), [])

    def test_a_kill_at_any_moment_loses_nothing(self):
        seed = random.randrange(1 << 32)
        print(f'kills of seed {seed}')
        moments = random.Random(seed)
        for kill in range(6):
            self.store.forget()
            until = moments.randrange(5, 60)
            process = self.start('s3://models', 's3://outputs/run')
            wait_until(lambda: len(self.store.requests) >= until or process.poll() is not None,
                       f'{until} requests')
            process.send_signal(signal.SIGKILL)
            process.communicate()
            for name, body in self.outputs_in_bucket().items():
                self.assertEqual(body, self.outputs[name], f'{name} after kill {kill}')
        self.batch()
        self.assert_complete()
        self.store.forget()
        self.batch()
        self.assertEqual(self.fetched(), [])

    def test_ctrl_c_keeps_what_is_finished(self):
        # What comes after the first five waits for the signal.
        later = Blocked(self.store, lambda r: r.method == 'PUT' and r.key.endswith('.drc') and
                        len(self.outputs_in_bucket()) >= 5, times=MODELS)
        process = self.start()
        later.wait()
        process.send_signal(signal.SIGINT)
        later.go.set()
        process.communicate(timeout=600)
        self.assertEqual(process.returncode, 130)
        kept = len(self.outputs_in_bucket())
        self.store.forget()
        self.batch()
        self.assertLessEqual(len(self.fetched()), MODELS + 1 - kept + 4)
        self.assert_complete()

    def test_a_second_batch_into_the_same_prefix_is_refused(self):
        held = Blocked(self.store, lambda r: r.method == 'PUT' and r.key.endswith('.drc'))
        process = self.start()
        held.wait()
        message = self.batch(status=9)
        self.assertIn(f'process {process.pid}', message)
        held.go.set()
        process.communicate(timeout=600)
        self.assert_complete()

    def test_trouble_with_the_store_passes(self):
        seed = random.randrange(1 << 32)
        print(f'faults of seed {seed}')
        luck = random.Random(seed)
        for act in (slow_down(), hang_up, cut_after(100)):
            self.store.fail(lambda r: luck.random() < 0.15, act, times=12)
        self.batch(AWS_MAX_ATTEMPTS='10')
        self.assert_complete()

    def test_large_outputs_go_in_parts_or_not_at_all(self):
        options = ['--resolution', '300', '--format', 'ply', '--include', 'plain/0.off']
        self.store.fail(lambda r: 'partNumber=2' in r.target, lambda h, r: refusal(400, 'Odd'),
                        times=99)
        self.batch('s3://models', 's3://outputs/run', *options)
        self.assertEqual(self.objects('outputs', '.ply'), {})
        self.assertEqual(self.store.backend.uploads, {})
        self.store.forget()
        self.batch('s3://models', 's3://outputs/run', *options, status=0)
        (body,) = self.objects('outputs', '.ply').values()
        self.assertGreater(len(body), 8 * MIB)
        subprocess.run([ARGUMENTS['strata'], 'batch', self.local / 'models', '-o',
                        self.folder / 'large', *OPTIONS, *options], check=True)
        self.assertEqual(body, (self.folder / 'large/plain/0.off.ply').read_bytes())


class Elsewhere(BatchTest):
    def test_models_of_a_bucket_go_into_a_folder(self):
        self.batch('s3://models', str(self.folder / 'out'))
        for name, body in self.outputs.items():
            self.assertEqual((self.folder / 'out' / name).read_bytes(), body, name)
        self.assertFalse((self.folder / 'out/.strata/models').exists())

    def test_models_of_a_folder_go_into_a_bucket(self):
        self.batch(str(self.local / 'models'), 's3://outputs/run')
        self.assert_complete()

    def test_keys_that_are_no_paths_are_reported_and_leave_their_folder_never(self):
        body = self.models['plain/0.off']
        odd = ['../up.off', '/etc/lead.off', 'a//b.off', 'a/../../b.off', 'x' * 300 + '.off']
        for key in odd:
            self.put('odd', f'models/{key}', body)
        self.put('odd', 'models/good.off', body)
        self.put('odd', 'models/.hidden.off', body)
        self.put('odd', 'models/folder/', b'')
        self.batch('s3://odd/models', str(self.folder / 'in/out'))
        lines = [json.loads(line) for line in
                 (self.folder / 'in/out/manifest.jsonl').read_text().splitlines()]
        self.assertEqual([line['path'] for line in lines if line['status'] == 'sampled'],
                         ['good.off'])
        reasons = [json.dumps(line) for line in lines if line['status'] != 'sampled']
        self.assertEqual(len(reasons), len(odd))
        for reason in reasons:
            self.assertIn('the key cannot be a path', reason)
        found = [str(path.relative_to(self.folder)) for path in self.folder.rglob('*.drc')]
        self.assertEqual(found, ['in/out/good.off.drc'])

    def test_models_wait_on_disk_within_their_bound(self):
        most = []

        def watch(request):
            total = 0
            for folder, _, files in os.walk(self.folder / 'home/.cache/strata/batch'):
                for name in files if folder.endswith('/.strata/models') else ():
                    try:
                        total += os.stat(os.path.join(folder, name)).st_size
                    except FileNotFoundError:
                        pass  # It was sampled meanwhile.
            most.append(total)
            return False
        self.store.fail(watch, hang_up)
        bound = 4 * max(map(len, self.models.values()))
        self.batch('s3://models', 's3://outputs/run', '--fetch-ahead', str(bound))
        self.assertGreater(max(most), 0)
        # Beside what waits, each of two workers may have asked for one out of turn.
        self.assertLessEqual(max(most), bound + 2 * bound // 4)
        self.assert_complete()

    def test_outputs_among_the_models_are_no_models(self):
        for name, body in self.models.items():
            self.put('both', name, body)
        self.put('both', 'run/plain/odd.off', b'an output')
        self.batch('s3://both', 's3://both/run')
        self.assertEqual({key for key in self.objects('both', '.drc')},
                         {f'run/{name}' for name in self.outputs})
        self.assertIn('would mix', self.batch('s3://both/run', 's3://both', status=2))

    def test_a_bucket_without_credentials_is_an_error_before_anything_else(self):
        message = self.batch(status=2, AWS_ACCESS_KEY_ID='', AWS_SECRET_ACCESS_KEY='')
        self.assertIn('no credentials for s3://', message)
        self.assertEqual(self.store.requests, [])

    def test_workers_do_not_get_the_credentials(self):
        seen = []

        def look(request):
            for path in pathlib.Path('/proc').glob('[0-9]*/environ'):
                try:
                    parent = (path.parent / 'stat').read_text().rsplit(')', 1)[1].split()[1]
                    # Until a worker is a program of its own it shows its parent's.
                    if parent == str(process.pid) and b'run-job' in (
                            path.parent / 'cmdline').read_bytes():
                        seen.append(path.read_bytes())
                except OSError:
                    pass
            return False
        process = self.start()
        self.store.fail(look, hang_up)
        process.communicate(timeout=600)
        self.assertTrue(any(seen), 'no worker was seen')
        self.assertFalse([True for text in seen if KEYS['KEYOFTESTS'].encode() in text])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--strata', required=True)
    known, rest = parser.parse_known_args()
    ARGUMENTS.update(vars(known))
    unittest.main(argv=[sys.argv[0], *rest])


if __name__ == '__main__':
    main()
