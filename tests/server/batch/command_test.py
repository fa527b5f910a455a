#!/usr/bin/env python3
"""What `strata batch` and `strata report` do when nothing goes wrong but models."""
import json
import os
import pathlib
import signal
import struct
import subprocess
import unittest

import batch_harness
from batch_harness import (BatchTest, CUBE, PATIENCE, QUICK, children, command, cube, is_alive,
                           manifest, outputs, sha256, unmeasured, wait_until)


def counts(text):
    """"models 3: 1 sampled, 2 unchanged, 0 failed" → (1, 2, 0)."""
    line = next(each for each in text.splitlines() if each.startswith('models'))
    words = line.split(':')[1].replace(',', '').split()
    return int(words[0]), int(words[2]), int(words[4])


class SamplesAFolder(BatchTest):
    def test_outputs_mirror_the_tree_with_the_bytes_of_the_command(self):
        self.put('a/b.off')
        self.put('a/b.obj', 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n')
        self.put('notes.txt', 'no mesh')
        text = self.batch(*QUICK, '--seed', '3', '--format', 'ply')
        self.assertEqual(counts(text), (2, 0, 0))
        self.assertEqual(set(outputs(self.out)), {'a/b.off.ply', 'a/b.obj.ply'})
        for name in ('a/b.off', 'a/b.obj'):
            one = self.path / 'one.ply'
            subprocess.run(command('sample', self.repo / name, '-o', one, '--resolution', '12',
                                   '--seed', '3', '--quiet'), check=True, timeout=PATIENCE)
            self.assertEqual((self.out / f'{name}.ply').read_bytes(), one.read_bytes(), name)
        self.assert_as_manifest_says()

    def test_a_manifest_line_says_what_a_model_came_to(self):
        self.put('cube.off')
        self.put('bad.ply', 'ply\nformat ascii 1.0\nelement vertex 3\n')
        self.batch(*QUICK, status=1)
        lines = manifest(self.out)
        line = lines['cube.off']
        self.assertEqual(line['input_sha256'], sha256(self.repo / 'cube.off'))
        self.assertEqual(line['input_bytes'], len(CUBE))
        self.assertEqual(line['triangles'], 12)
        self.assertAlmostEqual(line['area'], 6)
        self.assertEqual(line['options']['resolution'], 12)
        self.assertEqual(line['options']['lambda'], 5, 'defaults are written out')
        self.assertGreater(line['samples'], 0)
        self.assertEqual(line['output_bytes'], (self.out / line['output']).stat().st_size)
        self.assertGreater(line['measured']['peak_memory_bytes'], 1 << 20)
        failed = lines['bad.ply']
        self.assertEqual((failed['status'], failed['error']['type']), ('failed', 'corrupt-input'))
        self.assertIn('bad.ply', failed['error']['message'])
        self.assertNotIn(str(self.path), json.dumps(failed), 'no path of this machine')

    def test_a_drc_of_many_samples_is_a_folder_of_tiles(self):
        self.put('cube.off')
        self.batch('--resolution', '12', '--tile-samples', '100')
        self.assertTrue((self.out / 'cube.off.drc/tileset.json').exists())
        self.assert_as_manifest_says()
        self.assertEqual(counts(self.batch('--resolution', '12', '--tile-samples', '100')),
                         (0, 1, 0))
        self.batch('--resolution', '12')
        self.assertTrue((self.out / 'cube.off.drc').is_file())
        self.assert_as_manifest_says()

    def test_odd_names_work(self):
        names = [b'-o.off', b'line\nbreak.off', b'caf\xe9.off', b'<script>.off', b'a b/ c\\d.off',
                 '\u4e2d\u6587.off'.encode(), b"'quo\"te'.off", b'%2e.off']
        for i, name in enumerate(names):
            self.put(os.fsdecode(name), cube(i))
        self.assertEqual(counts(self.batch(*QUICK)), (len(names), 0, 0))
        found = {os.fsencode(name) for name in outputs(self.out)}
        self.assertEqual(found, {name + b'.drc' for name in names})
        hexes = [line['path_hex'] for line in manifest(self.out).values() if 'path_hex' in line]
        self.assertEqual(hexes, [b'caf\xe9.off'.hex()])
        self.assertEqual(counts(self.batch(*QUICK)), (0, len(names), 0))

    def test_a_list_names_the_models(self):
        self.put('a.off')
        self.put('b/c\nd.off')
        self.put('e.off')
        listed = self.path / 'list'
        listed.write_bytes(b'a.off\0./b/c\nd.off\0a.off\0')
        self.assertEqual(counts(self.batch(*QUICK, '--list', listed, '--null')), (2, 0, 0))
        listed.write_text('a.off\r\nabsent.off\n')
        self.assertIn('absent.off', self.batch(*QUICK, '--list', listed, status=3))
        listed.write_text('../list\n')
        self.batch(*QUICK, '--list', listed, status=3)

    def test_no_model_at_all_is_no_error(self):
        self.assertEqual(counts(self.batch(*QUICK)), (0, 0, 0))
        self.assertEqual(manifest(self.out), {})


class GoesOn(BatchTest):
    def test_a_second_run_redoes_only_what_changed(self):
        self.put_cubes(10)
        self.put('bad.off', 'OFF\n8 6 0\n0 0')
        self.assertEqual(counts(self.batch(*QUICK, status=1)), (10, 0, 1))
        first = (self.out / 'manifest.jsonl').read_bytes()
        self.assertEqual(counts(self.batch(*QUICK, status=1)), (0, 10, 1))
        self.assertEqual((self.out / 'manifest.jsonl').read_bytes(), first)
        os.utime(self.repo / '3/00003.off', ns=(1, 1))
        self.assertEqual(counts(self.batch(*QUICK, status=1)), (0, 10, 1),
                         'touched, but the same bytes')
        self.put('3/00003.off', cube(500))
        (self.out / '4/00004.off.drc').unlink()
        self.put('bad.off', CUBE)
        self.assertEqual(counts(self.batch(*QUICK)), (3, 8, 0))
        self.assert_as_manifest_says()

    def test_a_model_is_redone_when_a_file_that_it_names_changes_comes_or_goes(self):
        points = [0.0, 0, 0, 1, 0, 0, 0, 1, 0]
        self.put('a/mesh.gltf', json.dumps({
            'asset': {'version': '2.0'}, 'scenes': [{'nodes': [0]}], 'nodes': [{'mesh': 0}],
            'buffers': [{'uri': './points.bin', 'byteLength': 36}],
            'bufferViews': [{'buffer': 0, 'byteLength': 36}],
            'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': 3, 'type': 'VEC3',
                           'min': [0, 0, 0], 'max': [1, 1, 0]}],
            'meshes': [{'primitives': [{'attributes': {'POSITION': 0}}]}]}))
        mesh = (self.repo / 'a/mesh.gltf').stat()
        buffer = self.repo / 'a/points.bin'
        self.put('b.obj', 'mtllib b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n')
        self.assertEqual(counts(self.batch(*QUICK, status=1)), (1, 0, 1))
        buffer.write_bytes(struct.pack('<9f', *points))
        self.assertEqual(counts(self.batch(*QUICK)), (1, 1, 0), 'the buffer is there now')
        self.assertEqual([each['path'] for each in manifest(self.out)['a/mesh.gltf']['companions']],
                         ['points.bin'])
        self.assertEqual(counts(self.batch(*QUICK)), (0, 2, 0))
        first = manifest(self.out)['a/mesh.gltf']
        buffer.write_bytes(struct.pack('<9f', *(2 * value for value in points)))
        self.assertEqual(counts(self.batch(*QUICK)), (1, 1, 0), 'the buffer changed')
        self.assertEqual((self.repo / 'a/mesh.gltf').stat().st_mtime_ns, mesh.st_mtime_ns)
        self.assertAlmostEqual(manifest(self.out)['a/mesh.gltf']['area'], 4 * first['area'])
        buffer.unlink()
        self.assertEqual(counts(self.batch(*QUICK, status=1)), (0, 1, 1), 'the buffer went')
        self.assertEqual(set(outputs(self.out)), {'b.obj.drc'})

    def test_what_all_attributes_left_out_stands_in_the_manifest_and_the_report(self):
        textured = 'mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n'
        self.put('m.mtl', 'newmtl m\nmap_Kd wood.png\n')
        self.put('missing.obj', textured)
        self.put('bad/m.mtl', 'newmtl m\nmap_Kd wood.png\n')
        self.put('bad/wood.png', 'no image')
        self.put('bad/damaged.obj', textured)
        self.put('whole.off')
        self.batch(*QUICK, '--attributes', 'all')
        lines = manifest(self.out)
        self.assertNotIn('left_out', lines['whole.off'])
        for path in ['missing.obj', 'bad/damaged.obj']:
            self.assertEqual(len(lines[path]['left_out']), 1, lines[path])
            self.assertTrue(lines[path]['left_out'][0].startswith('texture: '), lines[path])
            self.assertIn('wood.png', lines[path]['left_out'][0])
        self.assertEqual(counts(self.batch(*QUICK, '--attributes', 'all')), (0, 3, 0))
        told = subprocess.run(command('report', self.out), capture_output=True, text=True, timeout=PATIENCE)
        self.assertIn('left out   2 attributes', told.stdout)

    def test_options_decide_what_is_redone(self):
        self.put('a/x.off')
        self.put('b/y.off')
        self.batch(*QUICK)
        self.put('a/strata.toml', 'lambda = 2\n')
        self.assertEqual(counts(self.batch(*QUICK)), (1, 1, 0))
        self.assertEqual(manifest(self.out)['a/x.off']['options']['lambda'], 2)
        self.assertEqual(counts(self.batch(*QUICK, '--lambda', '5')), (1, 1, 0))
        self.assertEqual(counts(self.batch(*QUICK, '--lambda', '5', '--format', 'npz')), (2, 0, 0))
        self.assertEqual(set(outputs(self.out)), {'a/x.off.npz', 'b/y.off.npz'},
                         'outputs of another format are gone')
        self.assertEqual(counts(self.batch(*QUICK, '--lambda', '5', '--format', 'npz', '--force')),
                         (2, 0, 0))

    def test_a_mistake_in_a_strata_toml_ends_it_before_it_begins(self):
        self.put('x.off')
        self.put('a/y.off')
        self.put('a/strata.toml', '# mine\nresolutoin = 3\n')
        text = self.batch(*QUICK, status=2)
        self.assertIn('a/strata.toml, line 2', text)
        self.assertEqual(outputs(self.out), {})

    def test_prune_removes_the_outputs_of_models_that_are_gone(self):
        self.put('a/x.off')
        self.put('y.off')
        self.batch(*QUICK)
        (self.out / 'a/mine.txt').write_text('not of the batch')
        (self.repo / 'a/x.off').unlink()
        self.batch(*QUICK)
        self.assertIn('a/x.off.drc', outputs(self.out), 'only when it is asked for')
        self.assertIn('pruned     1', self.batch(*QUICK, '--prune', '--include', 'z*'))
        self.assertEqual(set(outputs(self.out)), {'a/mine.txt', 'y.off.drc'})
        self.assertEqual(set(manifest(self.out)), {'y.off'}, 'left out, but not gone')

    def test_a_model_that_fails_now_keeps_no_output_of_before(self):
        self.put('x.off')
        self.batch(*QUICK)
        self.put('x.off', CUBE[:-9])
        self.batch(*QUICK, status=1)
        self.assertEqual(outputs(self.out), {})
        self.assert_as_manifest_says()

    def test_shares_together_do_what_one_does(self):
        self.put_cubes(40)
        whole = self.path / 'whole'
        self.batch(*QUICK, out=whole)
        running = [self.start(*QUICK, '--share', f'{i}/3') for i in range(3)]
        for each in running:
            _, text = each.communicate(timeout=PATIENCE)
            self.assertEqual(each.returncode, 0, text)
        self.assertEqual(outputs(self.out), outputs(whole))
        lines = {}
        for i in range(3):
            part = manifest(self.out, f'manifest-{i}-of-3.jsonl')
            self.assertFalse(set(part) & set(lines), 'a model is in two shares')
            self.assertGreater(len(part), 0)
            lines.update(part)
        self.assertEqual(unmeasured(lines), unmeasured(manifest(whole)))
        said = json.loads(self.report(self.out, '--json'))
        self.assertEqual((said['models'], said['sampled']), (40, 40))
        self.assertEqual(counts(self.batch(*QUICK)), (0, 40, 0), 'known from the shares')
        self.assertEqual(unmeasured(manifest(self.out)), unmeasured(manifest(whole)))


class KeepsOthersOut(BatchTest):
    def test_a_second_batch_is_refused_and_ctrl_c_ends_the_first(self):
        self.make_mesh('large.ply', 300_000)
        self.put('a/small.off')
        self.put('strata.toml', 'resolution = 700\nlambda = 30\n')
        self.put('a/strata.toml', 'resolution = 8\n')
        first = self.start('--jobs', '1')
        try:
            wait_until(lambda: manifest(self.out) if (self.out / 'manifest.jsonl').exists()
                       else {}, 'the first model')
            text = self.batch(*QUICK, status=9)
            self.assertIn(f'process {first.pid}', text)
            workers = children(first.pid)
            first.send_signal(signal.SIGINT)
            first.communicate(timeout=PATIENCE)
        finally:
            first.kill()
        self.assertEqual(first.returncode, 130)
        wait_until(lambda: not any(map(is_alive, workers)), 'the workers to end')
        self.assert_nothing_half()
        self.assertEqual(len(manifest(self.out)), 1, 'what was finished is kept')

    def test_outputs_do_not_mix_with_models(self):
        self.put('x.off')
        self.batch(*QUICK, status=2, out=self.repo)
        self.assertEqual(counts(self.batch(*QUICK, '--format', 'ply', out=self.repo / 'out')),
                         (1, 0, 0))
        self.assertEqual(counts(self.batch(*QUICK, '--format', 'ply', out=self.repo / 'out')),
                         (0, 1, 0), 'an output is no model')

    def test_progress_is_lines_where_there_is_no_terminal(self):
        self.put_cubes(3)
        text = self.batch(*QUICK)
        self.assertNotIn('\r', text)
        self.assertEqual(self.batch(*QUICK, '--quiet', '--force'), '')


class Reports(BatchTest):
    def test_a_page_with_pictures_that_needs_nothing_else(self):
        self.put('cube.off')
        self.put('<script>alert(1)</script>.off', cube(7))
        self.put('bad.off', 'OFF\n1')
        self.batch('--resolution', '24', status=1)
        text = self.report(self.out)
        self.assertIn('models     3: 2 sampled, 1 failed', text)
        self.assertIn('corrupt-input', text)
        page = (self.out / 'report.html').read_text()
        self.assertEqual(page.count('data:image/png;base64,'), 2)
        self.assertNotIn('<script>alert', page)
        self.assertNotIn('http', page.replace('http-equiv', ''))
        self.assertEqual(page.count('<svg'), 2)
        other = self.path / 'other.html'
        self.report(self.out, '--html', other)
        self.assertEqual(other.read_text(), page)
        said = json.loads(self.report(self.out, '--json'))
        self.assertEqual(said['reasons'], {'corrupt-input': 1})
        self.assertEqual(said['failures'][0]['path'], 'bad.off')

    def test_a_folder_without_a_manifest_is_an_error(self):
        done = subprocess.run(command('report', self.repo), capture_output=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 3)


if __name__ == '__main__':
    batch_harness.main()
