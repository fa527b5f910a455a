"""What others may do to a repository, to a folder of outputs and to its manifest: nothing is lost, removed or
passed over in silence."""
import json
import os
import pathlib
import shutil
import signal
import socket
import stat
import subprocess
import tempfile
import threading
import unittest

from batch_harness import (CUBE, PATIENCE, QUICK, BatchTest, command, cube, main, manifest, outputs,
                           sha256, unmeasured, wait_until)
import batch_harness

NOBODY = 65534


def edited(folder, model, changes):
    """Writes one line of the manifest anew."""
    lines = manifest(folder)
    for key, value in changes.items():
        lines[model][key] = value
    (folder / 'manifest.jsonl').write_text(''.join(json.dumps(line) + '\n' for line in lines.values()))


class HostileManifest(BatchTest):
    def setUp(self):
        super().setUp()
        for name in ('a.off', 'b.off', 'c.off'):
            self.put(name, cube(ord(name[0])))
        self.batch(*QUICK)
        self.text = (self.out / 'manifest.jsonl').read_text()

    def test_that_names_other_files_is_refused_and_they_stay(self):
        victim = self.path / 'victim.drc'
        victim.write_text('precious')
        mine = self.out / 'mine.txt'
        mine.write_text('mine')
        os.remove(self.repo / 'a.off')
        for changes in ({'output': '../victim.drc'}, {'output': str(victim)}, {'output': 'mine.txt'},
                        {'output': 'b.off.drc'}, {'output': 'a.off.txt'}, {'output': 'a.off.x.drc'},
                        {'output': 'a.off/x.drc'}, {'output': 'a.off./../../victim.drc'},
                        {'output_hex': b'mine.txt\0a.off.drc'.hex()}, {'output_hex': '2e2e2f76'},
                        {'picture': '../victim.drc'}, {'picture': '.strata/pictures/../../mine.txt'},
                        {'picture': '/etc/passwd'}, {'companions': [{'path': '../x.bin'}]},
                        {'path': '../victim', 'output': '../victim.drc'},
                        {'path': ''}, {'path_hex': b'a\0b'.hex()}):
            with self.subTest(**changes):
                (self.out / 'manifest.jsonl').write_text(self.text)
                edited(self.out, 'a.off', changes)
                before = outputs(self.out)
                text = self.batch(*QUICK, '--prune', status=4)
                self.assertIn('manifest.jsonl, line 1: no line of a manifest: ', text)
                self.assertEqual(outputs(self.out), before)
                self.assertEqual(victim.read_text(), 'precious')

    def test_of_odd_values_is_refused(self):
        for change in ({'output_bytes': -1}, {'output_bytes': 1e300}, {'samples': '7'}, {'edge': []},
                       {'skipped': {'zero_area': -2}}, {'measured': {}}, {'measured': 7}, {'options': None},
                       {'status': 7}, {'stamp': 3}, {'picture': 5}, {'input_sha256': {}}):
            with self.subTest(**change):
                (self.out / 'manifest.jsonl').write_text(self.text)
                edited(self.out, 'a.off', change)
                before = outputs(self.out)
                running = self.start(*QUICK)
                text = running.communicate(timeout=PATIENCE)[1]
                # What is a value of the right kind may say anything: then the model is done again.
                self.assertIn(running.returncode, (0, 4), text)
                self.assertEqual(outputs(self.out), before)

    def test_of_brackets_without_end_is_refused(self):
        deep = '[' * 1_000_000
        for line in (deep, f'{{"options":{deep}{"]" * 1_000_000}}}', '{"a":' * 200_000):
            (self.out / 'manifest.jsonl').write_text(line + '\n' + self.text)
            self.assertIn('line 1', self.batch(*QUICK, status=4))

    def test_cut_anywhere_leads_to_the_same_outputs(self):
        whole, before = self.text, outputs(self.out)
        said = unmeasured(manifest(self.out))
        for size in range(0, len(whole), max(1, len(whole) // 19)):
            (self.out / 'manifest.jsonl').write_text(whole[:size])
            self.batch(*QUICK)
            self.assertEqual(outputs(self.out), before, f'cut after {size} bytes')
            self.assertEqual(unmeasured(manifest(self.out)), said, f'cut after {size} bytes')

    def test_has_no_report_show_other_files(self):
        self.batch('--resolution', '12', '--pictures', '3', '--force')
        name = next(iter(manifest(self.out).values()))['picture']
        picture = self.out / name
        secret = self.path / 'secret.png'
        secret.write_bytes(picture.read_bytes() + b'secret')
        shown = (lambda: (self.report(self.out), (self.out / 'report.html').read_text().count('<img'))[1])
        self.assertEqual(shown(), 3)
        picture.unlink()
        picture.symlink_to(secret)
        self.assertEqual(shown(), 2, 'a link is not followed')
        picture.unlink()
        os.mkfifo(picture)
        self.assertEqual(shown(), 2, 'a pipe is not waited for')


class Repository(BatchTest):
    def test_no_mesh_is_passed_over_in_silence(self):
        self.put('good.off')
        self.put('sub/good.off')
        os.mkfifo(self.repo / 'pipe.off')
        (self.repo / 'nowhere.off').symlink_to('nothing.off')
        (self.repo / 'self.off').symlink_to('self.off')
        outside = self.path / 'outside.off'
        outside.write_text(CUBE)
        (self.repo / 'outside.off').symlink_to(outside)
        (self.repo / 'inside.off').symlink_to('sub/good.off')
        (self.repo / 'loop').symlink_to('.')
        with socket.socket(socket.AF_UNIX) as listening:
            os.chdir(self.repo)
            listening.bind('socket.off')
        text = self.batch(*QUICK, status=1)
        lines = manifest(self.out)
        self.assertEqual({path for path, line in lines.items() if line['status'] == 'sampled'},
                         {'good.off', 'sub/good.off', 'inside.off'})
        for path, why in (('pipe.off', 'a pipe, socket or device'), ('socket.off', 'a pipe, socket or device'),
                          ('nowhere.off', 'leads nowhere'), ('self.off', 'leads nowhere'),
                          ('outside.off', 'leads out of')):
            self.assertEqual(lines[path]['error']['type'], 'unsupported-format', path)
            self.assertIn(why, lines[path]['error']['message'])
            self.assertIn(f'{path}: failed', text)
        self.assertIn('5 of them before', self.batch(*QUICK, status=1), 'they are not tried again')
        self.batch(*QUICK, *(f'--exclude={path}' for path in lines if lines[path]['status'] == 'failed'))
        (self.repo / 'nothing.off').write_text(CUBE)
        self.batch(*QUICK, status=1)
        self.assertEqual(manifest(self.out)['nowhere.off']['status'], 'sampled', 'now it leads to a file')

    def as_nobody(self):
        """Gives the outputs to another user; what runs a command as that user."""
        if os.getuid() != 0:
            self.skipTest('needs root, to give a folder to another user')
        self.path.chmod(0o755)
        self.out.mkdir()
        os.chown(self.out, NOBODY, NOBODY)
        if subprocess.run(command('--version'), user=NOBODY, capture_output=True).returncode != 0:
            self.skipTest('another user may not run the program')
        return {'user': NOBODY, 'group': NOBODY, 'extra_groups': []}

    def test_a_folder_that_may_not_be_opened_is_one_failure(self):
        nobody = self.as_nobody()
        self.put('good.off')
        self.put('locked/x.off')
        self.put('locked.off')
        for path in ('locked', 'locked.off'):
            (self.repo / path).chmod(0)
        text = self.batch(*QUICK, '--prune', status=1, **nobody)
        lines = manifest(self.out)
        self.assertEqual(lines['good.off']['status'], 'sampled')
        for path in ('locked', 'locked.off'):
            self.assertIn('Permission denied', lines[path]['error']['message'])
        self.assertIn('locked: failed: storage', text)
        self.batch(*QUICK, '--exclude=locked/', '--exclude=locked.off', **nobody)
        self.out.chmod(0o555)
        self.assertIn('Permission denied', self.batch(*QUICK, status=8, **nobody))

    def test_what_may_not_be_seen_now_is_not_gone(self):
        nobody = self.as_nobody()
        self.put('good.off')
        self.put('locked/x.off')
        self.batch(*QUICK, **nobody)
        before = outputs(self.out)
        (self.repo / 'locked').chmod(0)
        self.batch(*QUICK, '--prune', status=1, **nobody)
        self.assertEqual(outputs(self.out), before)

    def test_options_that_cannot_be_read_end_it(self):
        self.put('a/x.off')
        (self.path / 'shared.toml').write_text('resolution = 9')
        (self.repo / 'a/strata.toml').symlink_to(self.path / 'shared.toml')
        self.assertIn('a/strata.toml: found what is no file below', self.batch(*QUICK, status=5))

    def test_a_message_gives_a_terminal_no_orders(self):
        self.put('x.off')
        (self.repo / 'strata.toml').write_text('"a\\u001b[31m\\u009bz" = 1')
        text = self.batch(*QUICK, status=2)
        self.assertIn('a\\x1b[31m\\x9bz', text)
        self.assertNotIn('\x1b', text)

    def test_a_model_that_changes_all_the_time_ends_as_its_bytes_say(self):
        texts = [cube(i) for i in range(1, 40)]
        stopped = threading.Event()

        def change():
            for i in range(1_000_000):
                (self.repo / 'new').write_text(texts[i % len(texts)])
                os.rename(self.repo / 'new', self.repo / 'x.off')
                if stopped.is_set():
                    return
        self.put('x.off', texts[0])
        writer = threading.Thread(target=change)
        writer.start()
        try:
            for _ in range(8):
                running = self.start(*QUICK)
                text = running.communicate(timeout=PATIENCE)[1]
                self.assertIn(running.returncode, (0, 1), text)
                if running.returncode == 1:
                    self.assertIn('changed while it was read', text)
        finally:
            stopped.set()
            writer.join()
        self.batch(*QUICK)
        line = manifest(self.out)['x.off']
        self.assertEqual(line['input_sha256'], sha256(self.repo / 'x.off'))
        fresh = self.path / 'fresh'
        self.batch(*QUICK, out=fresh)
        self.assertEqual(outputs(self.out), outputs(fresh))

    def test_a_list_that_is_none_is_refused(self):
        self.put('a.off')
        self.put('.hidden/b.off')
        self.assertIn('found a folder', self.batch(*QUICK, '--list', self.repo, status=2))
        names = self.path / 'names'
        for text, status in (('.hidden/b.off\n', 2), ('../repo/a.off\n', 3), ('/etc/passwd\n', 3),
                             ('x' * 300 + '\n', 3), ('', 0), ('./a.off\r\na.off', 0)):
            names.write_text(text)
            self.batch(*QUICK, '--list', names, status=status)
        self.assertEqual(set(manifest(self.out)), {'a.off'})

    def test_names_at_the_systems_limit_are_sampled_or_fail(self):
        self.put('x' * 247 + '.off')  # 251 bytes: its output's name has 255.
        self.put('y' * 251 + '.off')
        self.put('-o')
        self.put('--prune.off')
        self.batch(*QUICK, '--all', status=1)
        lines = manifest(self.out)
        self.assertEqual([path[0] for path, line in lines.items() if line['status'] == 'failed'], ['y'])
        self.assertIn('File name too long', lines['y' * 251 + '.off']['error']['message'])
        self.assert_as_manifest_says()


class Outputs(BatchTest):
    def test_may_lie_behind_links_and_on_another_file_system(self):
        self.put('a/x.off')
        self.batch(*QUICK)
        expected = outputs(self.out)
        (self.path / 'real').mkdir()
        link = self.path / 'link'
        link.symlink_to('real')
        (self.repo / 'out').symlink_to(self.path / 'real')
        self.batch(*QUICK, out=link)
        self.assertEqual(outputs(self.path / 'real'), expected)
        self.assertIn('1 unchanged', self.batch(*QUICK, out=self.repo / 'out'))
        inside = self.repo / 'inside'
        self.batch(*QUICK, out=inside)
        self.assertIn('models     1:', self.batch(*QUICK, out=inside), 'outputs are no models')
        os.remove(inside / 'a/x.off.drc')
        (inside / 'a/x.off.drc').symlink_to(self.path / 'elsewhere')
        self.batch(*QUICK, out=inside)
        self.assertEqual((self.path / 'elsewhere').read_bytes(), expected['a/x.off.drc'])
        self.assertIn('1 unchanged', self.batch(*QUICK, out=inside), 'behind a link it is there, too')
        shutil.rmtree(inside)
        if os.access('/dev/shm', os.W_OK):
            with tempfile.TemporaryDirectory(dir='/dev/shm') as other:
                self.batch(*QUICK, out=pathlib.Path(other) / 'out')
                self.assertEqual(outputs(pathlib.Path(other) / 'out'), expected)

    def test_a_second_batch_behind_a_link_is_refused(self):
        self.put_cubes(30)
        link = self.path / 'link'
        self.out.mkdir()
        link.symlink_to(self.out)
        first = self.start(*QUICK)
        wait_until(lambda: (self.out / 'manifest.jsonl').exists() and (self.out / 'manifest.jsonl').read_text(),
                   'the first line')
        second = self.start(*QUICK, out=link)
        text = second.communicate(timeout=PATIENCE)[1]
        status = first.communicate(timeout=PATIENCE) and first.returncode
        self.assertEqual(status, 0)
        self.assertIn(second.returncode, (0, 9), text)  # 0: the first had come to its end.
        self.assert_as_manifest_says()

    def test_what_others_put_in_their_place_stays(self):
        self.put('a.off')
        self.put('b.off')
        self.put('c.off')
        (self.out / 'a.off.drc').mkdir(parents=True)
        (self.out / 'a.off.drc/mine').write_text('mine')
        text = self.batch(*QUICK, status=1)
        self.assertIn('a.off: failed: storage: ', text)
        self.assertEqual((self.out / 'a.off.drc/mine').read_text(), 'mine')
        shutil.rmtree(self.out / 'a.off.drc')
        self.batch(*QUICK)
        (self.out / 'c.off.drc').write_text('what somebody else wrote here')
        for name in ('b.off', 'c.off'):
            os.remove(self.repo / name)
        self.assertIn('pruned     1', self.batch(*QUICK, '--prune'))
        self.assertEqual((self.out / 'c.off.drc').read_text(), 'what somebody else wrote here')
        self.assertFalse((self.out / 'b.off.drc').exists())

    def test_a_limit_of_files_sizes_is_an_error(self):
        self.put_cubes(12)
        limit = (lambda: __import__('resource').setrlimit(__import__('resource').RLIMIT_FSIZE, (4096, 4096)))
        running = self.start('--resolution', '12', '--pictures', '0', preexec_fn=limit)
        text = running.communicate(timeout=PATIENCE)[1]
        self.assertEqual(running.returncode, 8, text)
        self.assertIn('File too large', text)
        self.batch(*QUICK)
        self.assert_as_manifest_says()


class Pruning(BatchTest):
    def setUp(self):
        super().setUp()
        for name in ('a.off', 'b.off', 'c/d.off', 'e.off'):
            self.put(name, cube(ord(name[0])))

    def test_knows_the_outputs_of_shares(self):
        for share in range(2):
            self.batch(*QUICK, '--share', f'{share}/2')
        os.remove(self.repo / 'c/d.off')
        os.remove(self.repo / 'a.off')
        self.assertIn('pruned     2', self.batch(*QUICK, '--prune'))
        self.assertEqual(set(outputs(self.out)), {'b.off.drc', 'e.off.drc'})
        self.assertEqual(json.loads(self.report(self.out, '--json'))['models'], 2)
        self.assertNotIn('pruned', self.batch(*QUICK, '--prune'), 'there is nothing more')
        self.put('a.off', cube(3))
        self.batch(*QUICK)
        self.assertEqual(json.loads(self.report(self.out, '--json'))['models'], 3)

    def test_removes_nothing_when_the_repository_is_not_there(self):
        self.batch(*QUICK)
        before = outputs(self.out)
        os.rename(self.repo, self.path / 'away')
        self.repo.mkdir()
        self.assertIn('holds none of the 4 models', self.batch(*QUICK, '--prune', status=3))
        self.assertEqual(outputs(self.out), before)
        os.rmdir(self.repo)
        os.rename(self.path / 'away', self.repo)
        self.assertIn('4 unchanged', self.batch(*QUICK, '--prune'))

    def test_takes_no_notice_of_filters(self):
        self.batch(*QUICK)
        self.batch(*QUICK, '--prune', '--include', 'b.off')
        self.batch(*QUICK, '--prune', '--exclude', 'c/')
        self.assertEqual(len(outputs(self.out)), 4)


class Runs(BatchTest):
    def test_a_failure_stays_one_when_its_file_is_touched(self):
        self.put('bad.off', 'OFF\n1')
        self.put('good.off')
        self.batch(*QUICK, status=1)
        os.utime(self.repo / 'bad.off', (1, 1))
        os.utime(self.repo / 'good.off', (1, 1))
        text = self.batch(*QUICK, status=1)
        self.assertIn('1 unchanged, 1 failed (corrupt-input 1), 1 of them before', text)
        self.assertIn('1 of them before', self.batch(*QUICK, status=1))

    def test_of_shares_and_of_all_agree_on_what_is_there(self):
        for i in range(6):
            self.put(f'{i}.off', cube(i))
        one, two = (('--format=ply', '--min-distance=0', f'--seed={seed}') for seed in (1, 2))
        self.batch(*QUICK, *one)
        first = outputs(self.out)
        for share in range(2):
            self.batch(*QUICK, *two, '--share', f'{share}/2')
        second = outputs(self.out)
        self.assertEqual({name: len(each) for name, each in first.items()},
                         {name: len(each) for name, each in second.items()}, 'their sizes tell nothing')
        self.assertNotEqual(first, second)
        self.batch(*QUICK, *one)
        self.assertEqual(outputs(self.out), first, 'what a share wrote since is none of these options')
        self.batch(*QUICK, '--share', '0/1', '--format=drc')
        for share in range(3):
            self.batch(*QUICK, *two, '--share', f'{share}/3')
        self.assertEqual(outputs(self.out), second, 'outputs of the former format are gone')
        self.assertIn('6 unchanged', self.batch(*QUICK, *two))

    def test_signals_end_it_with_their_status_and_lose_nothing(self):
        self.put_cubes(60)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGPIPE, signal.SIGKILL):
            out = self.path / f'out{number}'
            running = self.start(*QUICK, out=out)
            wait_until(lambda: (out / 'manifest.jsonl').exists() and (out / 'manifest.jsonl').read_text(),
                       'the first line')
            running.send_signal(number)
            running.communicate(timeout=PATIENCE)
            caught = number not in (signal.SIGPIPE, signal.SIGKILL)
            self.assertIn(running.returncode, (128 + number if caught else -number, 0))
            kept = manifest(out)
            self.batch(*QUICK, out=out)
            after = manifest(out)
            self.assertEqual(len(after), 60)
            for path, line in kept.items():
                self.assertEqual(after[path], line, 'what was done is not done again')
            self.assert_as_manifest_says(out)

    def test_credentials_go_no_further_than_the_batch(self):
        self.make_mesh('large.ply', 400_000)
        secrets = {'AWS_ACCESS_KEY_ID': 'AKIAEXAMPLE', 'AWS_SECRET_ACCESS_KEY': 'very-secret',
                   'AWS_SESSION_TOKEN': 'a-token'}
        running = self.start('--resolution', '600', '--pictures', '0', env={**os.environ, **secrets})
        try:
            workers = wait_until(lambda: batch_harness.children(running.pid) or running.poll() is not None,
                                 'a worker')
            self.assertIsNot(workers, True, 'it ended before it was looked at')

            worker = pathlib.Path(f'/proc/{workers[0]}')
            # Until it is a program of its own it shows its parent's.
            wait_until(lambda: b'run-job' in (worker / 'cmdline').read_bytes(), 'the worker to start')
            text = (worker / 'environ').read_bytes()
            self.assertIn(b'PATH=', text)
            for secret in secrets.values():
                self.assertNotIn(secret.encode(), text)
        finally:
            running.kill()
            running.communicate(timeout=PATIENCE)


if __name__ == '__main__':
    main()
