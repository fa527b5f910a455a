#!/usr/bin/env python3
"""A repository of meshes from everywhere, whole and broken: every file is sampled or fails with its
reason. It lies in the folder that STRATA_TEST_DATA names, else beside the sources; skipped without."""
import os
import pathlib
import shutil
import sys
import unittest

import batch_harness
from batch_harness import BatchTest, manifest, outputs, unmeasured

OPTIONS = ('--all', '--resolution', '16', '--pictures', '8')


def data():
    named = os.environ.get('STRATA_TEST_DATA')
    beside = pathlib.Path(batch_harness.OPTIONS.source).parent / 'shared/data'
    return pathlib.Path(named) if named else beside


class Data(BatchTest):
    def setUp(self):
        super().setUp()
        self.repo.rmdir()
        shutil.copytree(data(), self.repo, symlinks=True)
        self.files = {str(path.relative_to(self.repo)) for path in self.repo.rglob('*')
                      if path.is_file() and not path.name.startswith('.')}

    def test_every_file_is_sampled_or_fails_with_its_reason_once(self):
        self.batch(*OPTIONS, status=1)
        lines = manifest(self.out)
        self.assertEqual(set(lines), self.files)
        for path, line in lines.items():
            if line['status'] == 'failed':
                self.assertNotIn(line['error']['type'], ('crashed', 'killed', 'internal'), path)
                self.assertTrue(line['error']['message'], path)
        self.assert_as_manifest_says()
        sampled = sum(line['status'] == 'sampled' for line in lines.values())
        print(f'{len(lines)} files, {sampled} sampled', flush=True)
        self.assertGreater(sampled, 100)

        before = (self.out / 'manifest.jsonl').read_bytes()
        text = self.batch(*OPTIONS, status=1)
        self.assertIn(f' 0 sampled, {sampled} unchanged', text)
        self.assertEqual((self.out / 'manifest.jsonl').read_bytes(), before)

        touched = self.repo / 'scans/spot.obj'
        touched.write_bytes(touched.read_bytes() + b'# touched\n')
        text = self.batch(*OPTIONS, status=1)
        self.assertIn(f' 1 sampled, {sampled - 1} unchanged', text)
        changed = {path for path, line in unmeasured(manifest(self.out)).items()
                   if line != unmeasured(lines)[path]}
        self.assertEqual(changed, {'scans/spot.obj'})
        again = self.path / 'again'
        self.batch(*OPTIONS, '--jobs', '1', status=1, out=again)
        self.assertEqual(outputs(again), outputs(self.out))
        self.assertEqual(unmeasured(manifest(again)), unmeasured(manifest(self.out)))


if __name__ == '__main__':
    arguments = dict(zip(sys.argv, sys.argv[1:]))
    batch_harness.OPTIONS = type('Options', (), {'source': arguments.get('--source', '.')})
    if not data().is_dir():
        print(f'skipped: no {data()}')
        sys.exit(77)
    batch_harness.main()
