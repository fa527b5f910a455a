#!/usr/bin/env python3
"""The job array of docker/slurm on a Slurm of two nodes: tasks killed in the middle, one of them with
its whole node, and one share scanned twice. The result has a single process's bytes.

Ends with status 77, and says why, where no Slurm can be started."""
import argparse
import filecmp
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading

from slurm_cluster import running, wait_for, why_not

SHARES = 4
# Strong enough a preference for the centre of the cell that a scan takes seconds, not an instant.
SCAN = '--resolution 500 --lambda 20 --seed 7'
MERGE = '--min-distance 0.4 --attributes normal,area'


def processor_seconds(process):
    fields = pathlib.Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def running_scan(cluster, share):
    """The process that is busy scanning a share, or None."""
    for process in cluster.processes():
        try:
            words = pathlib.Path(f'/proc/{process}/cmdline').read_bytes().split(b'\0')
            if (b'scan' in words[:2] and f'{share}/{SHARES}'.encode() in words
                    and processor_seconds(process) > 0.1):
                return process
        except OSError:
            pass  # It has ended.
    return None


class Stopper:
    """Within a `with` statement: stops the first scan of each share in its middle, whenever Slurm
    starts it, so that none can end before its turn comes."""

    def __init__(self, job, shares):
        self.job, self.waiting, self.stopped = job, set(shares), {}
        self.done = threading.Event()
        self.thread = threading.Thread(target=self._watch)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.done.set()
        self.thread.join()

    def scan(self, share):
        """The stopped process of a share, whose part is not there yet."""
        process = wait_for(f'scan of share {share}', lambda: self.stopped.get(share), 120, 0.005)
        if self.job.part(share).exists():
            raise AssertionError(f'share {share} was done before it could be stopped')
        return process

    def _watch(self):
        while self.waiting and not self.done.wait(0.005):
            for share in list(self.waiting):
                process = running_scan(self.job.cluster, share)
                if process and self._stop(process):
                    self.waiting.remove(share)
                    self.stopped[share] = process

    @staticmethod
    def _stop(process):
        try:
            os.kill(process, signal.SIGSTOP)
        except ProcessLookupError:
            return False
        return True


class Job:
    """One submission: mesh and result in `folder`, on `cluster`."""

    def __init__(self, cluster, folder, mesh, options):
        self.cluster, self.mesh = cluster, mesh
        self.parts, self.output = folder / 'parts', folder / 'array.ply'
        self.variables = {
            'STRATA': options.strata, 'STRATA_MESH': str(mesh), 'STRATA_SHARES': str(SHARES),
            'STRATA_PARTS': str(self.parts), 'STRATA_OUTPUT': str(self.output),
            'STRATA_SCRATCH': str(folder / 'scratch'), 'STRATA_SCAN_OPTIONS': SCAN + ' --attributes normal,area', 'STRATA_MERGE_OPTIONS': MERGE,
        }
        (folder / 'scratch').mkdir()
        self.script = pathlib.Path(options.source) / 'docker/slurm/submit.sh'

    def submit(self):
        self.array, self.merge = self.cluster.run(self.script, **self.variables).split()
        print(f'array {self.array}, merge {self.merge}', flush=True)

    def part(self, share):
        return self.parts / f'part-{share}-of-{SHARES}.run'

    def task(self, share):
        return self.cluster.job(f'{self.array}_{share}')

    def wait_until(self, number, state, seconds=180):
        """Waits for a job's end, which must be `state`; hurries on what Slurm holds back."""
        def ended():
            fields = self.cluster.job(number)
            found = fields['JobState']
            if found == 'PENDING' and fields['Reason'] == 'BeginTime':
                # Slurm lets a task that was put back wait for two minutes.
                self.cluster.run('scontrol', 'update', f'JobId={fields["JobId"]}', 'StartTime=now')
            return found in ('COMPLETED', 'FAILED', 'CANCELLED', 'NODE_FAIL', 'TIMEOUT') and found
        found = wait_for(f'end of job {number}', ended, seconds)
        if found != state:
            raise AssertionError(f'job {number}: {found}, expected {state}')


def interrupt(job, stopper):
    """Ends three of the four scans in the middle, each in another way."""
    cluster = job.cluster
    # The process dies, as for want of memory: the script puts the task back into the queue.
    os.kill(stopper.scan(0), signal.SIGKILL)
    print('share 0: its process killed', flush=True)
    # Somebody, or a more urgent job, sends the task back.
    process = stopper.scan(1)
    cluster.run('scontrol', 'requeue', job.task(1)['JobId'])
    print('share 1: requeued', flush=True)
    wait_for('the end of the requeued scan', lambda: not os.path.exists(f'/proc/{process}'), 60)
    # A whole node is lost, with all that runs on it.
    process = stopper.scan(2)
    node = wait_for('node of share 2', lambda: job.task(2).get('NodeList'), 30)
    cluster.run('scontrol', 'update', f'NodeName={node}', 'State=DOWN', 'Reason=test')
    wait_for('the end of the lost scan', lambda: not os.path.exists(f'/proc/{process}'), 60)
    print(f'share 2: {node} lost', flush=True)  # Its daemon soon reports it back.


def check_array(job, expected):
    with Stopper(job, range(3)) as stopper:
        job.submit()
        interrupt(job, stopper)
    for share in range(SHARES):
        job.wait_until(f'{job.array}_{share}', 'COMPLETED')
    restarts = [int(job.task(share)['Restarts']) for share in range(SHARES)]
    print(f'restarts by share: {restarts}', flush=True)
    if not all(restarts[:3]):
        raise AssertionError('a task that was interrupted did not start again')
    job.wait_until(job.merge, 'COMPLETED')
    if not filecmp.cmp(job.output, expected, shallow=False):
        raise AssertionError('the merged result differs from that of one process')
    print(f'{job.output.stat().st_size} bytes, equal to those of one process', flush=True)


def check_share_twice(job, expected):
    """A task that has ended well runs again, and its part is also given under a second name."""
    again = job.parts / 'again.run'
    again.write_bytes(job.part(3).read_bytes())
    before = job.part(3).stat().st_ino
    job.cluster.run('scontrol', 'requeue', job.task(3)['JobId'])
    wait_for('share 3 to start again', lambda: job.task(3)['JobState'] != 'COMPLETED', 60, 0.02)
    job.wait_until(f'{job.array}_3', 'COMPLETED')
    if job.part(3).stat().st_ino == before:
        raise AssertionError('share 3 was not scanned again')
    parts = [again] + [job.part(share) for share in range(SHARES)]
    twice = job.output.with_name('twice.ply')
    subprocess.run([job.variables['STRATA'], 'merge', *parts, *MERGE.split(), '-o', twice,
                    '--quiet'], check=True, timeout=300)
    if not filecmp.cmp(twice, expected, shallow=False):
        raise AssertionError('a share given twice changed the result')
    print('share 3 twice: the same bytes', flush=True)


def check_regions(job):
    """The merge as an array: each task writes its region of one folder."""
    tiles = ['--tile-samples', '20000']
    parts = [job.part(share) for share in range(SHARES)]
    one, shared = job.output.with_name('one.drc'), job.output.with_name('shared.drc')
    subprocess.run([job.variables['STRATA'], 'merge', *parts, *MERGE.split(), *tiles, '-o', one,
                    '--quiet'], check=True, timeout=300)
    variables = dict(job.variables, STRATA_REGIONS='3', STRATA_OUTPUT=str(shared),
                     STRATA_MERGE_OPTIONS=' '.join([MERGE, *tiles]))
    number = job.cluster.run('sbatch', '--parsable', '--export=ALL', '--array=0-2',
                             job.script.with_name('strata-merge.sbatch'), **variables).strip()
    for region in range(3):
        job.wait_until(f'{number}_{region}', 'COMPLETED')
    subprocess.run(['diff', '-r', one, shared], check=True, timeout=60)
    if shared.with_name('shared.drc.regions').exists():
        raise AssertionError('the finished folder left its regions behind')
    print(f'{len(list(shared.glob("tiles/*")))} tiles by 3 tasks: the same bytes', flush=True)


def check_failure(job):
    """An error that would come back ends the array, and the merge with it."""
    job.variables['STRATA_MESH'] = str(job.mesh.with_name('absent.ply'))
    job.variables['STRATA_PARTS'] = str(job.parts.with_name('parts-of-nothing'))
    job.output.unlink()
    job.submit()
    job.wait_until(f'{job.array}_0', 'FAILED')
    job.wait_until(job.merge, 'CANCELLED')
    if job.output.exists():
        raise AssertionError('a result appeared without its parts')
    print('a mesh that does not exist: merge cancelled', flush=True)


def main():
    parser = argparse.ArgumentParser()
    for name in ('source', 'strata', 'make-mesh'):
        parser.add_argument(f'--{name}', required=True)
    parser.add_argument('--triangles', type=int, default=2_000_000)
    options = parser.parse_args()
    reason = why_not()
    if reason:
        print(f'skipped: {reason}')
        return 77
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        mesh, expected = folder / 'sphere.ply', folder / 'one.ply'
        subprocess.run([options.make_mesh, 'sphere', '--triangles', str(options.triangles), '-o',
                        mesh], check=True, timeout=300)
        subprocess.run([options.strata, 'sample', mesh, *SCAN.split(), *MERGE.split(), '-o',
                        expected, '--quiet'], check=True, timeout=300)
        with running(folder) as cluster:
            job = Job(cluster, folder, mesh, options)
            check_array(job, expected)
            check_share_twice(job, expected)
            check_regions(job)
            check_failure(job)
    return 0


if __name__ == '__main__':
    sys.exit(main())
