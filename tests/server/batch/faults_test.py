#!/usr/bin/env python3
"""What befalls a batch: kill -9 at any moment, workers that die or hang, a full disk. Nothing that was
finished is lost, and the rest is done as if nothing had been."""
import os
import pathlib
import random
import shutil
import signal
import subprocess
import unittest

import batch_harness
from batch_harness import (BatchTest, QUICK, children, is_alive, manifest, outputs, unmeasured,
                           wait_until)

KILLS = 20


def busy_worker(process, seconds=0.3):
    """The worker that has used so much processor time, or None."""
    for worker in children(process):
        try:
            fields = pathlib.Path(f'/proc/{worker}/stat').read_text().rpartition(')')[2].split()
        except OSError:
            continue
        used = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
        if used > seconds:
            return worker
    return None


class Killed(BatchTest):
    def test_a_batch_killed_at_random_moments_ends_as_one_that_was_not(self):
        self.put_cubes(220)
        for i in range(4):
            self.make_mesh(f'large/{i}.ply', 40_000 + 1000 * i)
        self.put('bad.off', 'OFF\n8 6 0\n0 0')
        undisturbed = self.path / 'undisturbed'
        self.batch(*QUICK, status=1, out=undisturbed)
        seed = random.randrange(1 << 32)
        print(f'seed {seed}', flush=True)
        draw, finished, kills = random.Random(seed), 0, 0
        while kills < KILLS:
            running = self.start(*QUICK)
            # A batch that starts anew has less to do each time: after the last model, all again.
            goal = finished + draw.randrange(0, 12)
            path = self.out / 'manifest.jsonl'
            wait_until(lambda: running.poll() is not None or
                       (path.exists() and path.read_bytes().count(b'\n') >= goal), 'a moment')
            if running.poll() is not None:
                running.communicate()
                shutil.rmtree(self.out)
                finished = 0
                continue
            workers = children(running.pid)
            running.kill()
            running.communicate()
            kills += 1
            wait_until(lambda: not any(map(is_alive, workers)), 'the workers to die with it')
            whole = path.read_bytes().rpartition(b'\n')[0] if path.exists() else b''
            now = whole.count(b'\n') + bool(whole)
            self.assertGreaterEqual(now, finished, 'a finished model was lost')
            finished = now
        self.batch(*QUICK, status=1)
        self.assertEqual(outputs(self.out), outputs(undisturbed))
        self.assertEqual(unmeasured(manifest(self.out)), unmeasured(manifest(undisturbed)))
        self.assert_as_manifest_says()
        print(f'{kills} kills, {len(manifest(self.out))} models', flush=True)


class WorkersDie(BatchTest):
    ALONE = ('--jobs', '1', '--pictures', '0')

    def setUp(self):
        super().setUp()
        self.make_mesh('hard.ply', 200_000)
        self.put('strata.toml', 'resolution = 500\nlambda = 30\n')
        self.put('small/strata.toml', 'resolution = 8\n')
        for i in range(5):
            self.put(f'small/{i}.off', batch_harness.cube(i))

    def hit(self, number, *options, times=1, status):
        """Sends a signal to the worker that samples hard.ply, each time it does."""
        running = self.start(*self.ALONE, *options)
        hit = set()
        try:
            for _ in range(times):
                worker = wait_until(
                    lambda: next((each for each in [busy_worker(running.pid)]
                                  if each and each not in hit), None), 'a busy worker')
                hit.add(worker)
                os.kill(worker, number)
            _, text = running.communicate(timeout=2 * batch_harness.PATIENCE)
        finally:
            running.kill()
        self.assertEqual(running.returncode, status, text)
        lines = manifest(self.out)
        self.assertEqual({path for path, line in lines.items() if line['status'] == 'sampled'}
                         - {'hard.ply'}, {f'small/{i}.off' for i in range(5)}, 'others suffered')
        self.assert_as_manifest_says()
        return lines['hard.ply'], text

    def test_one_that_was_killed_from_outside_is_tried_again(self):
        line, text = self.hit(signal.SIGKILL, status=0)
        self.assertEqual((line['status'], line['measured']['attempts']), ('sampled', 2))
        self.assertIn('is tried again', text)

    def test_one_that_is_killed_twice_fails(self):
        line, _ = self.hit(signal.SIGKILL, times=2, status=1)
        self.assertEqual(line['error']['type'], 'killed')
        self.assertEqual(line['measured']['attempts'], 2)

    def test_one_that_crashes_fails_at_once(self):
        line, _ = self.hit(signal.SIGSEGV, status=1)
        self.assertEqual(line['error']['type'], 'crashed')
        self.assertIn('signal 11', line['error']['message'])
        self.assertEqual(line['measured']['attempts'], 1)

    def test_one_that_hangs_runs_out_of_time(self):
        line, _ = self.hit(signal.SIGSTOP, '--timeout', '8', status=1)
        self.assertEqual(line['error']['type'], 'timed-out')

    def test_a_failure_that_was_not_the_models_own_is_redone_by_the_next_run(self):
        self.hit(signal.SIGSEGV, status=1)
        self.batch(*self.ALONE)
        self.assertEqual(manifest(self.out)['hard.ply']['status'], 'sampled')


class DiskFull(BatchTest):
    def setUp(self):
        super().setUp()
        self.disk = self.path / 'disk'
        self.disk.mkdir()
        done = subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=2m', 'strata', self.disk],
                              capture_output=True, check=False)
        if done.returncode != 0:
            self.skipTest(f'no small file system: {done.stderr.decode().strip()}')
        self.addCleanup(subprocess.run, ['umount', self.disk], check=True)

    def test_says_so_keeps_what_was_finished_and_goes_on_when_space_returns(self):
        self.put_cubes(60)
        out = self.disk / 'out'
        options = ('--resolution', '40', '--format', 'ply', '--pictures', '0')
        text = ''
        for _ in range(2):
            running = self.start(*options, out=out)
            _, text = running.communicate(timeout=batch_harness.PATIENCE)
            self.assertIn(running.returncode, (1, 8), text)
            self.assertIn('No space left', text)
            self.assert_nothing_half(out)
            lines = manifest(out)
            done = {path for path, line in lines.items() if line['status'] == 'sampled'}
            self.assertGreater(len(done), 3)
            self.assertLess(len(done), 60)
        subprocess.run(['mount', '-o', 'remount,size=64m', self.disk], check=True)
        text = self.batch(*options, out=out)
        self.assertIn(f'{60 - len(done)} sampled, {len(done)} unchanged', text)
        elsewhere = self.path / 'elsewhere'
        self.batch(*options, out=elsewhere)
        self.assertEqual(outputs(out), outputs(elsewhere))
        self.assertEqual(unmeasured(manifest(out)), unmeasured(manifest(elsewhere)))


if __name__ == '__main__':
    batch_harness.main()
