"""A PostgreSQL of the test's own: a temporary folder, a Unix socket and a port of loopback."""
import os
import pathlib
import pwd
import shutil
import subprocess
import sys
import tempfile

sys.path.append(str(pathlib.Path(__file__).resolve().parents[2] / 'support'))
from free_port import free_port  # noqa: E402

SKIPPED = 77
PASSWORD = 'se%cret:w/rd'  # Of the user strata, over TCP; looked for in logs and messages.


def binaries():
    """The folder of initdb and pg_ctl, or None."""
    found = sorted(pathlib.Path('/usr/lib/postgresql').glob('*/bin/initdb'),
                   key=lambda path: int(path.parent.parent.name))
    return found[-1].parent if found else None


def skip_without_postgres():
    if binaries() is None:
        print('skipped: PostgreSQL is not installed (scripts/setup.sh postgres)')
        sys.exit(SKIPPED)
    if os.getuid() == 0 and not shutil.which('setpriv'):
        print('skipped: PostgreSQL does not run as root, and setpriv is missing')
        sys.exit(SKIPPED)


class Cluster:
    """Started with its making; `stop` ends it and removes its folder. Not synced to disk, which no
    test here needs: none cuts the power."""

    def __init__(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix='strata-pg-'))
        self.port = free_port()
        self.user = 'postgres' if os.getuid() == 0 else None
        if self.user:
            owner = pwd.getpwnam(self.user)
            os.chown(self.folder, owner.pw_uid, owner.pw_gid)
        os.chmod(self.folder, 0o755)
        self.data = self.folder / 'data'
        password = self.folder / 'password'
        password.write_text(PASSWORD + '\n')
        os.chmod(password, 0o644)
        self._run('initdb', '-D', self.data, '-U', 'strata', '--auth-local=trust',
                  '--auth-host=scram-sha-256', f'--pwfile={password}', '--no-sync', '-E', 'UTF8',
                  '--locale=C.UTF-8')
        self.start()

    def _run(self, program, *arguments, check=True):
        command = [str(binaries() / program), *map(str, arguments)]
        if self.user:
            command = ['setpriv', f'--reuid={self.user}', f'--regid={self.user}', '--init-groups',
                       *command]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, timeout=300,
                              env={**os.environ, 'PGCTLTIMEOUT': '240'})
        if check and done.returncode:
            raise AssertionError(f'{program}: {done.stdout}{done.stderr}')
        return done

    def start(self):
        settings = (f'-c port={self.port} -c listen_addresses=127.0.0.1 -c fsync=off '
                    f'-c unix_socket_directories={self.folder} -c max_connections=200 '
                    '-c shared_buffers=32MB')
        self._run('pg_ctl', '-D', self.data, '-l', self.folder / 'log', '-w', '-o', settings, 'start')

    def stop_server(self, mode='fast'):
        self._run('pg_ctl', '-D', self.data, '-w', '-m', mode, 'stop')

    def stop(self):
        self._run('pg_ctl', '-D', self.data, '-w', '-m', 'immediate', 'stop', check=False)
        shutil.rmtree(self.folder, ignore_errors=True)

    def url(self, database='postgres'):
        """By the socket, without a password."""
        return f'postgresql://strata@/{database}?host={self.folder}&port={self.port}'

    def tcp_url(self, database='postgres', port=None):
        return f'postgresql://strata@127.0.0.1:{port or self.port}/{database}'

    def sql(self, text, database='postgres'):
        """Rows as lists of texts."""
        done = subprocess.run(
            ['psql', '-X', '-q', '-A', '-t', '-F', '\t', '-v', 'ON_ERROR_STOP=1', '-h',
             str(self.folder), '-p', str(self.port), '-U', 'strata', '-d', database, '-c', text],
            capture_output=True, text=True, timeout=120)
        if done.returncode:
            raise AssertionError(f'psql: {text}: {done.stderr}')
        return [line.split('\t') for line in done.stdout.splitlines()]
