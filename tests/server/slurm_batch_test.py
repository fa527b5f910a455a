#!/usr/bin/env python3
"""docker/slurm/strata-batch.sbatch on a Slurm of two nodes, one of which is lost in the middle. Outputs and
manifests are those of one undisturbed process, and what a share had finished is not done again.

Ends with status 77, and says why, where no Slurm can be started."""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

from slurm_cluster import running, wait_for, why_not

SHARES, MODELS = 3, 18
# Strong enough a preference for the centre of the cell that a model takes a second or two.
OPTIONS = '--resolution 300 --lambda 20 --pictures 0'


def lines(path):
    """The whole lines of a manifest so far: path -> line."""
    text = path.read_text() if path.exists() else ''
    return {line['path']: line for line in map(json.loads, text.split('\n')[:-1])}


def unmeasured(found):
    return {path: {key: value for key, value in line.items() if key != 'measured'}
            for path, line in found.items()}


def outputs(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob('*.drc')}


class Job:
    def __init__(self, cluster, folder, options):
        self.cluster, self.out, self.repo = cluster, folder / 'out', folder / 'repo'
        self.script = pathlib.Path(options.source) / 'docker/slurm/strata-batch.sbatch'
        self.variables = {'STRATA': options.strata, 'STRATA_REPO': str(self.repo),
                          'STRATA_OUT': str(self.out), 'STRATA_BATCH_OPTIONS': OPTIONS}

    def submit(self):
        self.array = self.cluster.run('sbatch', '--parsable', '--export=ALL',
                                      f'--array=0-{SHARES - 1}', self.script,
                                      **self.variables).strip()

    def manifest(self, share):
        return self.out / f'manifest-{share}-of-{SHARES}.jsonl'

    def task(self, share):
        return self.cluster.job(f'{self.array}_{share}')

    def wait_until_completed(self, share):
        def ended():
            fields = self.task(share)
            if fields['JobState'] == 'PENDING' and fields['Reason'] == 'BeginTime':
                # Slurm lets a task that was put back wait for two minutes.
                self.cluster.run('scontrol', 'update', f'JobId={fields["JobId"]}', 'StartTime=now')
            return fields['JobState'] in ('COMPLETED', 'FAILED', 'CANCELLED') and fields['JobState']
        found = wait_for(f'end of share {share}', ended, 400)
        if found != 'COMPLETED':
            raise AssertionError(f'share {share}: {found}')


def lose_a_node(job):
    """Its share, the node, and what the share had finished by then."""
    def begun():
        for share in range(SHARES):
            done = len(lines(job.manifest(share)))
            if 1 <= done and job.task(share)['JobState'] == 'RUNNING':
                return share
        return None
    share = wait_for('a share in its middle', lambda: (begun() is not None) and [begun()], 200,
                     0.02)[0]
    node = job.task(share)['NodeList']
    job.cluster.run('scontrol', 'update', f'NodeName={node}', 'State=DOWN', 'Reason=test')
    before = lines(job.manifest(share))
    print(f'share {share}: {node} lost after {len(before)} models', flush=True)
    return share, before


def check(job, expected):
    job.submit()
    share, before = lose_a_node(job)
    for each in range(SHARES):
        job.wait_until_completed(each)
    if int(job.task(share)['Restarts']) == 0:
        raise AssertionError('the share of the lost node did not start again')
    after = lines(job.manifest(share))
    redone = [path for path, line in before.items() if after[path] != line]
    if redone:
        raise AssertionError(f'done again though they were finished: {redone}')
    found = {}
    for each in range(SHARES):
        found.update(lines(job.manifest(each)))
    if unmeasured(found) != unmeasured(lines(expected / 'manifest.jsonl')):
        raise AssertionError('the manifests differ from that of one process')
    if outputs(job.out) != outputs(expected):
        raise AssertionError('the outputs differ from those of one process')
    print(f'{len(found)} models, equal to those of one process', flush=True)


def main():
    parser = argparse.ArgumentParser()
    for name in ('source', 'strata', 'make-mesh'):
        parser.add_argument(f'--{name}', required=True)
    options = parser.parse_args()
    reason = why_not()
    if reason:
        print(f'skipped: {reason}')
        return 77
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / 'repo').mkdir()
        for i in range(MODELS):
            subprocess.run([options.make_mesh, 'sphere', '--triangles', str(40_000 + 997 * i), '-o',
                            folder / f'repo/{i}.ply'], check=True, timeout=300)
        expected = folder / 'expected'
        subprocess.run([options.strata, 'batch', folder / 'repo', '-o', expected, *OPTIONS.split(),
                        '--quiet'], check=True, timeout=600)
        with running(folder) as cluster:
            check(Job(cluster, folder, options), expected)
    return 0


if __name__ == '__main__':
    sys.exit(main())
