"""A Slurm of two nodes on this host: own folder, own ports, own daemons, loopback only."""
import contextlib
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / 'support'))
from free_port import free_port  # noqa: E402

NEEDED = ('munged', 'slurmctld', 'slurmd', 'sbatch', 'scontrol', 'sinfo', 'squeue', 'scancel')
SEARCH = os.environ.get('PATH', '') + ':/usr/sbin:/sbin'


def why_not():
    """Why no cluster can be started here, or None."""
    missing = [name for name in NEEDED if shutil.which(name, path=SEARCH) is None]
    if missing:
        return f'not installed: {", ".join(missing)}'
    if os.geteuid() != 0:
        return 'Slurm starts jobs only as root'
    return None


def wait_for(what, condition, seconds, interval=0.1):
    """Asks until the condition gives something true, which is returned."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(interval)
    raise TimeoutError(f'{what}: not within {seconds} s')


def free_ports(count):
    ports = set()
    while len(ports) < count:
        ports.add(free_port())
    return ports


CONFIGURATION = """
ClusterName=strata
SlurmctldHost=localhost(127.0.0.1)
SlurmctldPort={controller}
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
AuthType=auth/munge
AuthInfo=socket={root}/munge.socket,cred_expire=5
CredType=cred/munge
SlurmUser=root
SlurmdUser=root
SlurmctldPidFile={root}/slurmctld.pid
SlurmdPidFile={root}/slurmd-%n.pid
SlurmctldLogFile={root}/slurmctld.log
SlurmdLogFile={root}/slurmd-%n.log
SlurmdSpoolDir={root}/spool-%n
StateSaveLocation={root}/state
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=batch_sched_delay=0,sched_interval=1
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=1
MessageTimeout=20
NodeName=node1 NodeHostname=localhost NodeAddr=127.0.0.1 Port={node1} CPUs=2 RealMemory=2500
NodeName=node2 NodeHostname=localhost NodeAddr=127.0.0.1 Port={node2} CPUs=2 RealMemory=2500
PartitionName=all Nodes=node1,node2 Default=YES MaxTime=10 State=UP
"""


class Cluster:
    """Within a `with` statement the cluster runs; after it nothing of it does."""

    def __init__(self, folder):
        self.root = pathlib.Path(folder)
        self.environment = dict(os.environ, PATH=SEARCH,
                                SLURM_CONF=str(self.root / 'slurm.conf'))
        self.daemons = []

    def __enter__(self):
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        if len(self.daemons) > 1:
            subprocess.run(['scancel', '--user=root'], env=self.environment, timeout=30,
                           check=False, capture_output=True)
        for daemon in reversed(self.daemons):
            daemon.terminate()
            try:
                daemon.wait(10)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait()
        for process in self.processes():  # Steps outlive their daemon.
            try:
                os.kill(process, signal.SIGKILL)
            except ProcessLookupError:
                pass

    def processes(self):
        """Everything that was started with this cluster's configuration, except this process."""
        mark = f'SLURM_CONF={self.environment["SLURM_CONF"]}'.encode()
        found = []
        for entry in pathlib.Path('/proc').iterdir():
            if not entry.name.isdigit() or int(entry.name) == os.getpid():
                continue
            try:
                if mark in (entry / 'environ').read_bytes().split(b'\0'):
                    found.append(int(entry.name))
            except OSError:
                pass  # It has ended.
        return found

    def run(self, *command, **variables):
        """What a command printed."""
        done = subprocess.run([str(part) for part in command], timeout=60, check=False,
                              env=dict(self.environment, **variables), capture_output=True,
                              text=True, cwd=self.root)
        if done.returncode != 0:
            raise RuntimeError(f'{command}: status {done.returncode}\n{done.stdout}{done.stderr}')
        return done.stdout.strip()

    def job(self, number):
        """The fields that `scontrol show job` prints of one job or task."""
        words = self.run('scontrol', '--oneliner', 'show', 'job', number).split()
        return dict(word.split('=', 1) for word in words if '=' in word)

    def logs(self):
        """The last lines of every log, for a failure's report."""
        text = ''
        for log in sorted(self.root.glob('*-[0-9].log')) + sorted(self.root.glob('*.out')):
            lines = log.read_text(errors='replace').splitlines()[-25:]
            text += f'--- {log.name}\n' + '\n'.join(lines) + '\n'
        return text

    def _start(self):
        root = self.root
        controller, node1, node2 = free_ports(3)
        (root / 'state').mkdir()
        (root / 'slurm.conf').write_text(CONFIGURATION.format(
            root=root, controller=controller, node1=node1, node2=node2))
        key = root / 'munge.key'
        key.touch(0o600)
        key.write_bytes(os.urandom(128))
        # Debian's folder for the log is not for the tests; --force lets a folder of /tmp do.
        self._daemon('munged', '--foreground', '--force', f'--key-file={key}',
                     f'--socket={root}/munge.socket', f'--pid-file={root}/munged.pid',
                     f'--log-file={root}/munged.log', f'--seed-file={root}/munged.seed')
        wait_for('munged', (root / 'munge.socket').exists, 60)
        self._daemon('slurmctld', '-D', '-i')
        for node in ('node1', 'node2'):
            (root / f'spool-{node}').mkdir()
            self._daemon('slurmd', '-D', '-N', node)
        wait_for('two idle nodes', self._nodes_are_idle, 120)

    def _nodes_are_idle(self):
        for daemon in self.daemons:
            if daemon.poll() is not None:
                raise RuntimeError(f'{daemon.args[0]} ended with status {daemon.returncode}')
        done = subprocess.run(['sinfo', '--noheader', '--Node', '--format=%T'], check=False,
                              env=self.environment, capture_output=True, text=True, timeout=60)
        return done.stdout.split() == ['idle', 'idle']

    def _daemon(self, name, *arguments):
        with open(self.root / f'{name}-{len(self.daemons)}.log', 'wb') as log:
            self.daemons.append(subprocess.Popen(
                [name, *arguments], env=self.environment, stdin=subprocess.DEVNULL, stdout=log,
                stderr=log, cwd=self.root, start_new_session=True))


@contextlib.contextmanager
def running(folder):
    """A cluster in a folder of `folder`'s. Prints its jobs and logs if what it is for fails; fails if something
    of it is left."""
    folder.chmod(0o755)  # Munge wants its socket where everybody can reach it.
    (folder / 'slurm').mkdir()
    with Cluster(folder / 'slurm') as cluster:
        try:
            yield cluster
        except BaseException:
            print(cluster.run('scontrol', 'show', 'job'), cluster.logs(), sep='\n', flush=True)
            raise
    if cluster.processes():
        raise AssertionError(f'still running: {cluster.processes()}')
