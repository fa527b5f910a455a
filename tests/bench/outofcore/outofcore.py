"""Prints the table of jobs larger than memory: what was promised, and what came out.

A benchmark, not a test: it ends with status 0 whatever the figures are. It makes its own inputs with
the program make_mesh. Every job runs in a control group limited to its budget and 128 MiB where this
user may make one. See docs/benchmarks.md.
"""
import argparse
import datetime
import hashlib
import json
import os
import pathlib
import platform
import shutil
import statistics
import subprocess
import sys
from dataclasses import dataclass, field

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parent.parent.parent
sys.path.insert(0, str(HERE.parent))

import rows as table  # noqa: E402
from measure import busy_seconds, own_seconds  # noqa: E402

import cage  # noqa: E402

MEBI = 1 << 20
UNITS = {'K': 1 << 10, 'M': MEBI, 'G': 1 << 30, 'T': 1 << 40}
OVER_BUDGET = 64 * MEBI  # The promise: what a process may take beside --memory.
CAGE_ROOM = 128 * MEBI


def size_of(text):
    return int(text[:-1]) * UNITS[text[-1]] if text[-1] in UNITS else int(text)


@dataclass
class Job:
    """One line of the table: repeated runs of one command."""
    what: str
    budget: str
    costs: list = field(default_factory=list)
    report: dict = field(default_factory=dict)
    peak: int = 0
    digest: str = ''
    wanted: list = field(default_factory=list)  # (text, whether met or None)
    failure: str = ''

    def median(self, name):
        return statistics.median(getattr(cost, name) for cost in self.costs)


class Bench:
    def __init__(self, options):
        self.options, self.folder = options, options.folder
        self.strata = options.build / 'server/strata'
        self.make_mesh = options.build / 'tests/support/make_mesh'
        for program in (self.strata, self.make_mesh):
            if not program.exists():
                sys.exit(f'no {program}: build the preset "release"')
        self.cage = cage.Cage()
        self.scratch = self.folder / 'scratch'
        self.scratch.mkdir(exist_ok=True)
        self.jobs = []

    # --- Inputs ---

    def mesh(self, name, *arguments):
        path = self.folder / name
        if not path.exists():
            part = path.with_suffix('.part')
            subprocess.run([self.make_mesh, *map(str, arguments), '-o', part], check=True,
                           stdout=subprocess.DEVNULL)
            part.rename(path)
        return path

    def sphere(self, triangles, *shuffles):
        words = [word for name in shuffles for word in (f'--{name}', 7)]
        name = '-'.join([f'sphere{triangles}', *shuffles]) + '.ply'
        return self.mesh(name, 'sphere', '-n', triangles, *words)

    def triangle(self):
        path = self.folder / 'triangle.obj'
        path.write_text('v 0 0 0\nv 1 0.3 0.1\nv 0.2 1 0.4\nf 1 2 3\n')
        return path

    # --- Runs ---

    def sample(self, what, mesh, budget, *options, output='out.ply', repeats=None, keep=False):
        """Adds a Job. The output is removed, unless it is to be looked at."""
        job = Job(what, budget)
        self.jobs.append(job)
        print(f'{what}, --memory {budget} …', file=sys.stderr, flush=True)
        path, report = self.folder / output, self.folder / 'summary.json'
        argv = [self.strata, 'sample', mesh, '-o', path, '--quiet', '--summary', report,
                '--memory', budget, '--scratch', self.scratch, *options]
        limit = size_of(budget) + CAGE_ROOM
        try:
            for _ in range(repeats or self.options.repeats):
                remove(path)
                job.costs.append(cage.run(argv, self.folder, self.cage, limit))
                job.report = json.loads(report.read_text())
                job.peak = max(job.peak, job.report['peak_memory_bytes'])
            job.digest = digest_of(path)
            over = (job.peak - size_of(budget)) / MEBI
            job.wanted.append((f'peak at most {OVER_BUDGET // MEBI} MiB over: {over:+.0f}',
                               job.peak <= size_of(budget) + OVER_BUDGET))
        except (cage.Failed, OSError) as error:
            job.failure = str(error)
        if not keep:
            remove(path)
        if list(self.scratch.iterdir()):
            job.wanted.append(('nothing left in the scratch directory', False))
        return job

    def same_bytes(self, jobs):
        for job in jobs[1:]:
            if not job.failure:
                job.wanted.append((f'bytes of {jobs[0].budget}',
                                   job.digest == jobs[0].digest if jobs[0].digest else None))

    def at_most(self, job, other, factor, what='wall'):
        if job.failure or other.failure:
            return
        ratio = job.median(what) / other.median(what)
        job.wanted.append((f'{what} at most {factor:g} x of "{other.what}" {other.budget}: '
                           f'{ratio:.2f}', ratio <= factor))

    def check_distances(self, job, path):
        if job.failure:
            return
        ran = subprocess.run([sys.executable, HERE / 'distances.py', path],
                             capture_output=True, text=True)
        if ran.returncode != 0:
            job.wanted.append(('distance: ' + ran.stderr.strip().splitlines()[-1], None))
            return
        found = json.loads(ran.stdout)
        good = found['too_close'] == 0 and found['points'] == samples_of(job)
        job.wanted.append((f'no two of {found["points"]:,} samples too close: nearest '
                           f'{found["smallest"]:.6f} of it', good))


def remove(path):
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def digest_of(path):
    """Of a file, or of the names and bytes of a folder."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob('*')) if path.is_dir() else [path]:
        digest.update(str(file.relative_to(path)).encode())
        if file.is_file():
            with open(file, 'rb') as stream:
                while chunk := stream.read(MEBI):
                    digest.update(chunk)
    return digest.hexdigest()


def samples_of(job):
    return job.report['samples']['after_rejection']


# --- Groups --------------------------------------------------------------------------------------


def triangles(bench):
    """A mesh larger than the budget, against memory in plenty."""
    o = bench.options
    mesh = bench.sphere(o.triangles)
    words = ('--resolution', o.resolution)
    what = f'{o.triangles / 1e6:g} M triangles, resolution {o.resolution}'
    plenty = bench.sample(what, mesh, '8G', *words)
    tight = bench.sample(what, mesh, o.memory, *words)
    bench.same_bytes([plenty, tight])
    bench.at_most(tight, plenty, 1.5)
    bench.at_most(tight, plenty, 1.5, 'cpu')


def shuffled(bench):
    """Vertices, and triangles too, in random order."""
    o = bench.options
    words = ('--resolution', o.resolution)
    jobs = [bench.sample(f'{o.shuffled / 1e6:g} M triangles, {name}',
                         bench.sphere(o.shuffled, *shuffles), o.memory, *words)
            for name, shuffles in [('coherent', ()), ('vertices shuffled', ('shuffle',)),
                                   ('both shuffled', ('shuffle', 'shuffle-faces'))]]
    for job in jobs[1:]:
        bench.at_most(job, jobs[0], 6)
    bench.same_bytes(jobs)


def cells(bench):
    """Far more cells than the budget holds, from a small mesh; and the rule checked on all."""
    o = bench.options
    mesh = bench.sphere(200000)
    words = ('--resolution', o.cells_resolution)
    what = f'200 k triangles, resolution {o.cells_resolution}'
    tiles = bench.sample(what + ', tiles', mesh, o.cells_memory, *words, '--tile-samples', 1000000,
                         output='out.drc', repeats=1, keep=True)
    manifest = bench.folder / 'out.drc/tileset.json'
    if manifest.exists():
        tileset = json.loads(manifest.read_text())
        counts = [tile['count'] for tile in tileset['tiles']]
        tiles.wanted.append((f'{len(counts)} tiles hold {sum(counts):,} samples',
                             sum(counts) == samples_of(tiles)))
    remove(bench.folder / 'out.drc')
    ply = bench.sample(what + ', PLY', mesh, o.cells_memory, *words, repeats=1, keep=True)
    bench.check_distances(ply, bench.folder / 'out.ply')
    remove(bench.folder / 'out.ply')


def one_triangle(bench):
    o = bench.options
    bench.sample(f'one triangle, resolution {o.triangle_resolution}', bench.triangle(), '256M',
                 '--resolution', o.triangle_resolution, repeats=1)


def peaks(bench):
    """The table of peak memory against budget."""
    o = bench.options
    mesh = bench.sphere(o.triangles)
    jobs = [bench.sample(f'peak: {o.triangles / 1e6:g} M triangles, resolution '
                         f'{o.peak_resolution}', mesh, budget, '--resolution', o.peak_resolution,
                         repeats=1)
            for budget in ('128M', '256M', '512M', '1G', '4G')]
    bench.same_bytes(jobs)


GROUPS = {'triangles': triangles, 'shuffled': shuffled, 'cells': cells, 'triangle': one_triangle,
          'peaks': peaks}


# --- The table -----------------------------------------------------------------------------------


def giga(value):
    return f'{value / 1e9:.2f}'


def row_of(job):
    cells_text = f'{job.report["cells"]:,}' if job.report else ''
    if job.failure:
        return [job.what, job.budget, cells_text] + [''] * 5 + [job.failure, 'NO']
    wanted = '; '.join(text for text, _ in job.wanted)
    met = [met for _, met in job.wanted if met is not None]
    return [job.what, job.budget, cells_text, f'{job.median("wall"):.1f}',
            f'{job.median("cpu"):.1f}', f'{job.peak / MEBI:.0f}',
            f'{giga(job.median("read"))} ({giga(job.median("disk_read"))})',
            f'{giga(job.median("written"))} ({giga(job.median("disk_written"))})',
            wanted, 'yes' if all(met) else 'NO']


def markdown(jobs):
    return table.markdown_table(
        ['job', '--memory', 'cells', 'wall s', 'CPU s', 'peak MiB', 'GB read (from disk)',
         'GB written (to disk)', 'wanted', 'met'], [row_of(job) for job in jobs])


def parse_arguments():
    parser = argparse.ArgumentParser(prog='tests/bench/outofcore/run.sh', description=__doc__)
    parser.add_argument('build', nargs='?', type=pathlib.Path, default=SOURCE / 'build/release',
                        help='folder of a release build (default: build/release)')
    parser.add_argument('--full', action='store_true',
                        help='200 M triangles, 10^8 cells, one triangle over 10^8 cells: an hour, '
                             'and 30 GB of disk')
    parser.add_argument('--triangles', type=int, help='of the large mesh (default 20 M)')
    parser.add_argument('--resolution', type=int, help='for it (default 512)')
    parser.add_argument('--memory', help='budget for it (default 128M)')
    parser.add_argument('--shuffled', type=int, help='triangles of the shuffled one (default 10 M)')
    parser.add_argument('--cells-resolution', type=int, help='of many cells (default 1500)')
    parser.add_argument('--cells-memory', help='budget for them (default 256M)')
    parser.add_argument('--triangle-resolution', type=int, help='of one triangle (default 4000)')
    parser.add_argument('--peak-resolution', type=int, help='of the peaks (default 700)')
    parser.add_argument('--repeats', type=int, default=1, help='runs of each job (default 1)')
    parser.add_argument('--only', nargs='+', choices=GROUPS, default=list(GROUPS), metavar='GROUP',
                        help='some of: ' + ', '.join(GROUPS))
    parser.add_argument('--folder', type=pathlib.Path,
                        default=pathlib.Path(os.environ.get('TMPDIR', '/tmp')) / 'strata-outofcore',
                        help='where inputs are made, and kept for the next run')
    options = parser.parse_args()
    moderate = {'triangles': 20_000_000, 'resolution': 512, 'memory': '128M',
                'shuffled': 10_000_000, 'cells_resolution': 1500, 'cells_memory': '256M',
                'triangle_resolution': 4000, 'peak_resolution': 700}
    full = {'triangles': 200_000_000, 'resolution': 1024, 'memory': '256M',
            'shuffled': 100_000_000, 'cells_resolution': 4700, 'cells_memory': '512M',
            'triangle_resolution': 12000, 'peak_resolution': 2048}
    for name, value in (full if options.full else moderate).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    options.folder, options.build = options.folder.resolve(), options.build.resolve()
    return options


def processor():
    for line in open('/proc/cpuinfo'):
        if line.startswith('model name'):
            return line.split(':', 1)[1].strip()
    return platform.machine()


def main():
    options = parse_arguments()
    options.folder.mkdir(parents=True, exist_ok=True)
    bench = Bench(options)
    load, busy, own = os.getloadavg(), busy_seconds(), own_seconds()
    start = datetime.datetime.now(datetime.timezone.utc)
    try:
        for name in options.only:
            GROUPS[name](bench)
    finally:
        bench.cage.close()
    now = datetime.datetime.now(datetime.timezone.utc)
    others = (busy_seconds() - busy) - (own_seconds() - own)
    share = 100 * max(0, others) / ((now - start).total_seconds() * os.cpu_count())
    print(markdown(bench.jobs))
    caged = ('every job in a control group of its budget and 128 MiB' if bench.cage.folder else
             f'without a control group ({bench.cage.reason})')
    print(f'{processor()}, {os.cpu_count()} cores, {platform.freedesktop_os_release()["PRETTY_NAME"]}; '
          f'{caged}; load average {load[0]:.2f} before, {os.getloadavg()[0]:.2f} after; others used '
          f'{share:.0f} % of the machine; {now.isoformat(timespec="seconds")}.')


if __name__ == '__main__':
    main()
