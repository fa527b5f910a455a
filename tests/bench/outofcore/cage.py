"""Runs a process in a control group of limited memory, and says what it cost."""
import os
import pathlib
import shutil
import signal
import time
from dataclasses import dataclass

ROOT = pathlib.Path('/sys/fs/cgroup')


class Failed(Exception):
    """A command ended with another status than 0; the message says which and its last words."""


@dataclass
class Cost:
    """Of one process and its threads. Seconds; bytes. `read` and `written` count what it asked the
    system for, scratch space included; the others what went to or came from the disk meanwhile."""
    wall: float
    cpu: float
    read: int
    written: int
    disk_read: int
    disk_written: int


def own_groups():
    """(folder, file of the limit) of this process's memory groups, version 2 first."""
    for line in pathlib.Path('/proc/self/cgroup').read_text().splitlines():
        _, controllers, group = line.split(':', 2)
        if controllers == '':
            yield ROOT / group.lstrip('/'), 'memory.max'
        elif 'memory' in controllers.split(','):
            yield ROOT / 'memory' / group.lstrip('/'), 'memory.limit_in_bytes'


class Cage:
    """A group below this process's own. `reason` says why there is none, if so."""

    def __init__(self):
        self.folder, self.reason = None, 'no control group for memory'
        for parent, limit in own_groups():
            folder = parent / f'strata-bench-{os.getpid()}'
            try:
                folder.mkdir()
            except OSError as error:
                self.reason = f'{folder}: {error.strerror}'
                continue
            if (folder / limit).exists():
                self.folder, self.limit, self.reason = folder, limit, ''
                return
            folder.rmdir()
            self.reason = f'{folder}: no {limit}'

    def set(self, limit_bytes):
        (self.folder / self.limit).write_text(str(limit_bytes))

    def close(self):
        if self.folder:
            self.folder.rmdir()


def figures(text):
    return {key: int(value) for key, value in (line.split(': ') for line in text.splitlines())}


def run(argv, folder, cage=None, limit_bytes=None):
    """Runs `argv` to its end, in `cage` with `limit_bytes` if both are given; returns its Cost."""
    argv = [str(word) for word in argv]
    if cage and cage.folder and limit_bytes:
        cage.set(limit_bytes)
        enter = 'echo $$ > "$0" && exec "$@"'
        argv = ['/bin/sh', '-c', enter, str(cage.folder / 'cgroup.procs'), *argv]
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    errors = folder / 'stderr'
    actions = [(os.POSIX_SPAWN_OPEN, 0, '/dev/null', os.O_RDONLY, 0),
               (os.POSIX_SPAWN_OPEN, 1, '/dev/null', os.O_WRONLY, 0),
               (os.POSIX_SPAWN_OPEN, 2, str(errors), flags, 0o600)]
    start = time.perf_counter()
    pid = os.posix_spawn(shutil.which(argv[0]) or argv[0], argv, os.environ, file_actions=actions)
    try:
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    except BaseException:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise
    wall = time.perf_counter() - start
    # The kernel still knows the figures of a process that nobody has waited for.
    io = figures(pathlib.Path(f'/proc/{pid}/io').read_text())
    _, status, usage = os.wait4(pid, 0)
    if status != 0:
        words = errors.read_text(errors='replace').strip().splitlines() or ['no message']
        raise Failed(f'exit status {os.waitstatus_to_exitcode(status)}: {words[-1]}')
    return Cost(wall, usage.ru_utime + usage.ru_stime, io['rchar'], io['wchar'],
                io['read_bytes'], io['write_bytes'])
