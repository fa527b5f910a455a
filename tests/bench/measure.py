"""Runs processes and says what they cost.

NumPy stays out of this process on purpose: the kernel counts the peak memory of a parent as its
children's, until they replace themselves, so a small parent keeps their figures honest.
"""
import json
import os
import pathlib
import resource
import statistics
import time
from dataclasses import dataclass, field


class CommandFailed(Exception):
    """A command ended with another status than 0; the message says which and its last words."""


@dataclass
class Command:
    """What to run. `report` is a JSON file it writes, or None; stdout JSON when `json_stdout`."""
    argv: list
    report: pathlib.Path | None = None
    json_stdout: bool = False


@dataclass
class Cost:
    """Of one process and all its threads. Seconds; bytes."""
    user: float
    system: float
    wall: float
    peak_bytes: int
    report: dict = field(default_factory=dict)

    @property
    def cpu(self):
        return self.user + self.system


def run_once(command, scratch):
    """Runs `command` to its end and returns its Cost. `scratch` is a folder for its output."""
    out_path, err_path = scratch / 'stdout', scratch / 'stderr'
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    actions = [(os.POSIX_SPAWN_OPEN, 0, '/dev/null', os.O_RDONLY, 0),
               (os.POSIX_SPAWN_OPEN, 1, str(out_path), flags, 0o600),
               (os.POSIX_SPAWN_OPEN, 2, str(err_path), flags, 0o600)]
    argv = [str(word) for word in command.argv]
    start = time.perf_counter()
    pid = os.posix_spawn(argv[0], argv, os.environ, file_actions=actions)
    _, status, usage = os.wait4(pid, 0)
    wall = time.perf_counter() - start
    if status != 0:
        words = err_path.read_text(errors='replace').strip().splitlines() or ['no message']
        code = os.waitstatus_to_exitcode(status)
        raise CommandFailed(f'{" ".join(argv)}: exit status {code}: {words[-1]}')
    report = {}
    if command.json_stdout:
        report = json.loads(out_path.read_text().strip().splitlines()[-1])
    elif command.report:
        report = json.loads(command.report.read_text())
    return Cost(usage.ru_utime, usage.ru_stime, wall, usage.ru_maxrss * 1024, report)


def busy_seconds():
    """CPU seconds this machine has worked since it started, time stolen by its host included."""
    words = open('/proc/stat').readline().split()[1:]
    user, nice, system, _idle, _iowait, irq, softirq, steal = map(int, words[:8])
    return (user + nice + system + irq + softirq + steal) / os.sysconf('SC_CLK_TCK')


def own_seconds():
    own = resource.getrusage(resource.RUSAGE_SELF)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


@dataclass
class Rounds:
    """Costs by command name, one entry a round, and how much of the machine others used."""
    costs: dict
    others_percent: float
    load: float

    def ratio(self, name, to, what=lambda cost: cost.cpu):
        """Round by round, `what` of `name` over `what` of `to`."""
        return [what(a) / what(b) for a, b in zip(self.costs[name], self.costs[to])]

    def each(self, name, what):
        return [what(cost) for cost in self.costs[name]]


def run_rounds(commands, repeats, scratch, warm_up=True):
    """Runs all of `commands` (name -> Command) in turn, `repeats` times: A B A B, so that a busy
    minute of the machine hits all alike. One more round before warms the page cache."""
    if warm_up:
        for command in commands.values():
            run_once(command, scratch)
    costs = {name: [] for name in commands}
    busy, own, start = busy_seconds(), own_seconds(), time.perf_counter()
    for _ in range(repeats):
        for name, command in commands.items():
            costs[name].append(run_once(command, scratch))
    capacity = (time.perf_counter() - start) * os.cpu_count()
    others = (busy_seconds() - busy) - (own_seconds() - own)
    return Rounds(costs, max(0.0, 100 * others / capacity), os.getloadavg()[0])


def spread(values):
    """Median, smallest, largest."""
    return statistics.median(values), min(values), max(values)
