#!/usr/bin/env python3
"""10,000 small models: none is lost, and memory does not grow with them."""
import os
import time

import batch_harness
from batch_harness import BatchTest, QUICK, children, manifest, resident_bytes

MODELS = int(os.environ.get('STRATA_BATCH_MODELS', '10000'))
MIB = 1 << 20


class Many(BatchTest):
    def test_memory_is_flat_over_all_models(self):
        self.put_cubes(MODELS)
        started = time.monotonic()
        running = self.start(*QUICK, '--progress-interval', '1', '--memory', '1G')
        seen = []  # (share of the models that are done, bytes of the batch, of its largest worker)
        path = self.out / 'manifest.jsonl'
        lines, offset = 0, 0
        while running.poll() is None:
            if path.exists():
                with path.open('rb') as file:
                    file.seek(offset)
                    block = file.read()
                offset += len(block)
                lines += block.count(b'\n')
            workers = [resident_bytes(each) for each in children(running.pid)]
            seen.append((lines / MODELS, resident_bytes(running.pid), max(workers, default=0)))
            batch_harness.select.select([running.stderr], [], [], 0.05)
            batch_harness.select.select([], [], [], 0.05)
        _, text = running.communicate()
        seconds = time.monotonic() - started
        self.assertEqual(running.returncode, 0, text[-2000:])
        self.assertEqual(len(manifest(self.out)), MODELS)
        self.assert_nothing_half()
        for name, at in (('the batch', 1), ('a worker', 2)):
            early = max((each[at] for each in seen if each[0] < 0.25), default=0)
            most = max(each[at] for each in seen)
            print(f'{name}: {early / MIB:.1f} MiB over the first quarter, {most / MIB:.1f} at most',
                  flush=True)
            self.assertLess(most, early + 24 * MIB, f'memory of {name} grows')
        whole = max(each[1] + 2 * each[2] for each in seen)
        self.assertLess(whole, 1024 * MIB, 'more than --memory')
        print(f'{MODELS / seconds:.0f} models a second', flush=True)


if __name__ == '__main__':
    batch_harness.main()
