"""Prints the table of speed: what was promised, as ratios measured in one run, and what came out.

A benchmark, not a test: it ends with status 0 whatever the figures are. Peers that are not
installed are named as absent. See docs/benchmarks.md.
"""
import argparse
import datetime
import json
import os
import pathlib
import platform
import subprocess
import sys

import peers
import rows as table
from measure import Command, CommandFailed, run_rounds

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parent.parent
BUNNY, DRAGON, DRAGONS = 'bunny.ply', 'dragon.ply', 'dragons24.ply'
MEGA = 1e6


class Bench:
    """What the groups share: the program under test, inputs, the folder to work in."""

    def __init__(self, options):
        self.strata = find_strata(options.build)
        self.folder = options.folder
        self.scans = options.data / 'scans'
        self.repeats = options.repeats
        self.peer_repeats = min(options.repeats, options.peer_repeats)
        self.peers = options.peers
        self.costs = {}

    def input(self, name):
        """The path of an input, made if it is missing."""
        if not (self.folder / name).exists():
            subprocess.run([sys.executable, HERE / 'make_inputs.py', self.scans, self.folder, name],
                           check=True)
        return self.folder / name

    def info(self, name):
        return Command([self.strata, 'info', self.input(name)])

    def sample(self, name, *options, threads=0, output=None):
        report = self.folder / 'summary.json'
        return Command([self.strata, 'sample', self.input(name), '-o',
                        output or self.folder / 'out.drc', '--format', 'drc', '--quiet',
                        '--summary', report, '--threads', threads, *options], report)

    def sample_unwritten(self, *arguments, threads):
        """Without a wait for the disk: wall and CPU time differ only by who else computes."""
        return self.sample(*arguments, threads=threads, output='/dev/null')

    def rounds(self, group, commands, repeats=None, warm_up=True):
        rounds = run_rounds(commands, repeats or self.repeats, self.folder, warm_up)
        for name, costs in rounds.costs.items():
            self.costs[f'{group}: {name}'] = {
                'command': ' '.join(str(word) for word in commands[name].argv),
                'others_percent': rounds.others_percent, 'load': rounds.load,
                'runs': [vars(cost) for cost in costs]}
        return rounds


def find_strata(build):
    folders = [build] if build else [SOURCE / 'build/release', SOURCE / 'build']
    for folder in folders:
        if (folder / 'server/strata').exists():
            return (folder / 'server/strata').resolve()
    sys.exit(f'no server/strata in {" or ".join(map(str, folders))}: build the preset "release"')


def stage_seconds(cost, *names):
    """Wall seconds of the named stages of a `strata sample`."""
    return sum(cost.report['stages'][name]['seconds'] for name in names)


def sampling_seconds(cost):
    return stage_seconds(cost, 'lattice', 'scan')


def after_reading_seconds(cost):
    return stage_seconds(cost, 'lattice', 'scan', 'reject')


def sampling_cpu(cost):
    """CPU seconds of the same, for one thread: wall seconds by the share of a core that the process
    got. On an idle machine the two are equal."""
    return after_reading_seconds(cost) * min(1, cost.cpu / cost.wall)


def samples_of(cost):
    return cost.report['samples']['after_rejection']


# --- Groups: each measures some commands in turn and returns rows ---------------------------------


def start_up(bench):
    rounds = bench.rounds('start-up', {'version': Command([bench.strata, '--version'])},
                          5 * bench.repeats)
    milliseconds = rounds.each('version', lambda c: 1e3 * c.wall)
    return [table.Row('`strata --version`, wall', milliseconds, 'ms', at_most=30)]


def one_dragon(bench):
    rounds = bench.rounds('dragon', {
        'info': bench.info(DRAGON),
        'height 5': bench.sample(DRAGON, '--height', 5),
        'height 7': bench.sample(DRAGON, '--height', 7)})
    return [table.Row(f'dragon, `--{name}`: CPU over `strata info`', rounds.ratio(name, 'info'),
                      'x', at_most=4, aim=2, note=f'{samples_of(rounds.costs[name][0]):,} samples')
            for name in ('height 5', 'height 7')]


def many_dragons(bench):
    options = ('--resolution', 512)
    rounds = bench.rounds('24 dragons', {
        'info': bench.info(DRAGONS),
        'threads 1': bench.sample(DRAGONS, *options, threads=1),
        'threads 2': bench.sample(DRAGONS, *options, threads=2)})
    note = f'{samples_of(rounds.costs["threads 1"][0]):,} samples; {{}} thread(s)'
    result = [table.Row('24 dragons, `--resolution 512`: CPU over `strata info`',
                        rounds.ratio(f'threads {n}', 'info'), 'x', at_most=4, aim=2,
                        note=note.format(n)) for n in (2, 1)]
    read = rounds.each('info', lambda c: c.wall)
    note = f'the scan reads the faces too; all of `info` takes {min(read):.2f} s'
    return result + [threads_row('24 dragons, 512', rounds, note)]


def threads_row(what, rounds, note=''):
    others = f'others used {rounds.others_percent:.0f} % of the machine'
    return table.Row(f'{what}: two threads against one, wall after opening',
                     rounds.ratio('threads 1', 'threads 2', after_reading_seconds), 'x',
                     at_least=1.7, note='; '.join(filter(None, [others, note])))


def fine_bunny(bench):
    uniform, spaced = ('--resolution', 512, '--min-distance', 0), ('--resolution', 512)
    rounds = bench.rounds('bunny 512', {
        'm 0': bench.sample_unwritten(BUNNY, *uniform, threads=1),
        'threads 1': bench.sample_unwritten(BUNNY, *spaced, threads=1),
        'threads 2': bench.sample_unwritten(BUNNY, *spaced, threads=2)})

    def rate(seconds):
        return rounds.each('m 0', lambda c: samples_of(c) / seconds(c) / MEGA)

    by_wall = table.spread_text(rate(after_reading_seconds), 'M/s')
    note = f'{samples_of(rounds.costs["m 0"][0]):,} samples, one thread; by wall {by_wall}'
    share = rounds.each('threads 1', lambda c: stage_seconds(c, 'reject') / sampling_seconds(c))
    return [table.Row('bunny 512, m 0: samples per CPU second of lattice, scan and gathering',
                      rate(sampling_cpu), 'M/s', at_least=1.5, aim=3,
                      note=note),
            table.Row('the same per CPU second of the whole process', rate(lambda c: c.cpu), 'M/s',
                      note='with reading and Draco'),
            table.Row('bunny 512, m 0.5: rejection over sampling, one thread', share, 'x',
                      at_most=0.5),
            threads_row('bunny 512, m 0.5', rounds)]


def one_triangle(bench):
    options = ('--resolution', 2400, '--min-distance', 0)
    rounds = bench.rounds('one triangle', {
        f'threads {n}': bench.sample_unwritten('triangle.stl', *options, threads=n)
        for n in (1, 2)}, bench.peer_repeats)
    cells = rounds.costs['threads 1'][0].report['cells']
    return [threads_row('one triangle', rounds, f'{cells:,} cells')]


# Input, what it is, wanted MB/s. Text may be parsed in parallel, so wall time counts there.
READING = [(DRAGONS, 'binary PLY', 1000), ('dragons8.stl', 'binary STL', 1000),
           ('dragons4.obj', 'OBJ', 150), ('dragons4-ascii.ply', 'ascii PLY', 150)]


def reading(bench):
    commands = {what: bench.info(name) for name, what, _ in READING}
    rounds = bench.rounds('reading', commands)
    result = []
    for name, what, wanted in READING:
        size = (bench.folder / name).stat().st_size / MEGA
        wall = table.spread_text(rounds.each(what, lambda c, s=size: s / c.wall), 'MB/s')
        result.append(table.Row(f'`strata info`, {what}, {size:.0f} MB: per CPU second',
                                rounds.each(what, lambda c, s=size: s / c.cpu), 'MB/s',
                                at_least=wanted, note=f'by wall {wall}'))
    return result


def poisson_disk(bench):
    mine = {'strata': bench.sample(BUNNY, '--resolution', 170, '--min-distance', 0.5)}
    name = 'bunny 170, m 0.5: CPU of Open3D\'s Poisson disk (100k) over ours'
    if not (bench.peers and peers.has_open3d()):
        return [table.Row(name, [], 'x', at_least=100, note=peers.OPEN3D_ABSENT)]
    other = peers.open3d('poisson', bench.input(BUNNY), 100000)
    rounds = bench.rounds('Poisson disk', {**mine, 'Open3D': other}, bench.peer_repeats,
                          warm_up=False)
    counts = '{:,} against {:,} samples'.format(rounds.costs['Open3D'][0].report['points'],
                                               samples_of(rounds.costs['strata'][0]))
    alone = [o.report['sample_cpu'] / s.cpu
             for o, s in zip(rounds.costs['Open3D'], rounds.costs['strata'])]
    return [table.Row(name, rounds.ratio('Open3D', 'strata'), 'x', at_least=100, note=counts),
            table.Row('the same, Open3D without its import and reading', alone, 'x',
                      note='our whole process all the same')]


def context(bench):
    """Quicker ways to worse samples, beside ours on the same files; nothing is promised here."""
    if not bench.peers:
        return []
    result = []
    for name, what, options in [(BUNNY, 'bunny', ('--resolution', 170)),
                                (DRAGONS, '24 dragons', ('--resolution', 512))]:
        result += context_of(bench, name, what, options)
    return result


def context_of(bench, name, what, options):
    mine = bench.sample(name, *options)
    first = run_rounds({'strata': mine}, 1, bench.folder).costs['strata'][0]
    edge = first.report['lattice']['edge']
    # A mesh of 20.9 M triangles takes CGAL's halfedges gigabytes: there it sits out.
    others, absent = peers.all_quick(bench.input(name), 1000000, edge, bench.folder,
                                     cgal=name == BUNNY)
    rounds = bench.rounds(f'context {what}', {'strata': mine, **others}, bench.peer_repeats,
                          warm_up=False)
    ours = f'{samples_of(first):,}'
    result = [table.Row(f'{what}: CPU of {peer} over ours', rounds.ratio(peer, 'strata'), 'x',
                        note=f'{rounds.costs[peer][0].report["points"]:,} against {ours} samples')
              for peer in others]
    return result + [table.Row(f'{what}: {reason}', [], 'x', note='absent') for reason in absent]


GROUPS = {'start-up': start_up, 'dragon': one_dragon, 'dragons': many_dragons,
          'bunny': fine_bunny, 'triangle': one_triangle, 'reading': reading,
          'poisson': poisson_disk, 'context': context}


def machine():
    model = [line.split(':', 1)[1].strip() for line in open('/proc/cpuinfo')
             if line.startswith('model name')]
    return {'processor': model[0] if model else platform.machine(), 'cores': os.cpu_count(),
            'system': platform.freedesktop_os_release()['PRETTY_NAME'], 'load': os.getloadavg()}


def parse_arguments():
    parser = argparse.ArgumentParser(prog='tests/bench/run.sh', description=__doc__)
    parser.add_argument('build', nargs='?', type=pathlib.Path,
                        help='folder of a release build (default: build/release, then build)')
    parser.add_argument('--repeats', type=int, default=7, help='rounds a group (default 7)')
    parser.add_argument('--peer-repeats', type=int, default=3,
                        help='rounds with slow peers (default 3)')
    parser.add_argument('--only', nargs='+', choices=GROUPS, default=list(GROUPS), metavar='GROUP',
                        help='some of: ' + ', '.join(GROUPS))
    parser.add_argument('--no-peers', dest='peers', action='store_false')
    parser.add_argument('--data', type=pathlib.Path,
                        default=os.environ.get('STRATA_TEST_DATA', SOURCE / '../shared/data'),
                        help='folder with scans/ (default: $STRATA_TEST_DATA, or ../shared/data)')
    parser.add_argument('--folder', type=pathlib.Path,
                        default=pathlib.Path(os.environ.get('TMPDIR', '/tmp')) / 'strata-bench',
                        help='where inputs are made, 1 GB, and kept for the next run')
    parser.add_argument('--json', type=pathlib.Path, help='also write every figure here')
    options = parser.parse_args()
    options.data, options.folder = pathlib.Path(options.data).resolve(), options.folder.resolve()
    return options


def run_group(bench, name):
    """The rows of a group; what fails becomes a row that says so."""
    try:
        return GROUPS[name](bench)
    except (CommandFailed, subprocess.CalledProcessError, OSError) as error:
        return [table.Row(name, [], '', note=f'failed: {error}')]


def main():
    options = parse_arguments()
    options.folder.mkdir(parents=True, exist_ok=True)
    bench = Bench(options)
    about = machine()
    found = []
    for name in options.only:
        print(f'measuring {name} …', file=sys.stderr, flush=True)
        found += run_group(bench, name)
    about['load_after'] = os.getloadavg()
    about['time'] = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec='seconds')
    print(table.markdown(found))
    print(table.costs_markdown(bench.costs))
    print(table.footer(about))
    path = options.json or options.folder / 'bench.json'
    path.write_text(json.dumps({'machine': about, 'rows': [row.to_json() for row in found],
                                'costs': bench.costs}, indent=1, default=str) + '\n')
    print(f'every figure: {path}')


if __name__ == '__main__':
    main()
