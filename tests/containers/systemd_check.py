#!/usr/bin/env python3
"""packaging/strata.service under a systemd of its own: starts, serves and stops with everything that it forbids itself."""
import os
import subprocess
import unittest

from containers import SOURCE, podman, samples_of_command, wait_until

NAME = f'strata-check-systemd-{os.getpid()}'


def inside(*command, check=True):
    return podman('exec', NAME, *command, check=check)


class Unit(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.addClassCleanup(podman, 'rm', '-f', '-t', '0', NAME, check=False)
        podman('run', '-d', '--name', NAME, '--systemd=always', '--privileged', 'localhost/strata-check-systemd')
        wait_until(lambda: inside('systemctl', 'is-system-running', check=False) in ('running', 'degraded'),
                   'systemd to be up')

    def test_1_installing_started_nothing(self):
        self.assertEqual(inside('systemctl', 'is-active', 'strata', check=False), 'inactive')
        self.assertEqual(inside('systemctl', 'is-enabled', 'strata', check=False), 'disabled')

    def test_2_start_returns_when_it_answers(self):
        inside('systemctl', 'start', 'strata')
        inside('strata', 'health')

    def test_3_jobs_run_in_its_sandbox_and_are_kept(self):
        url = 'http://127.0.0.1:8080/v1'
        mesh = (SOURCE / 'models' / 'spot.obj').read_bytes()

        def curl(*options, body=None):
            return subprocess.run(['podman', 'exec', '-i', NAME, 'curl', '-sS', '--fail-with-body', *options], input=body,
                                  capture_output=True, check=True).stdout
        expected = samples_of_command('--format', 'ply', '--resolution', '64')
        query = 'resolution=64&format=ply'
        self.assertEqual(curl('--data-binary', '@-', f'{url}/samples?{query}', body=mesh), expected)
        curl('-T', '-', f'{url}/models/spot.obj', body=mesh)
        inside('systemctl', 'restart', 'strata')
        self.assertEqual(curl(f'{url}/samples?model=spot.obj&{query}'), expected)

    def test_4_it_has_no_rights(self):
        pid = inside('systemctl', 'show', '-p', 'MainPID', '--value', 'strata')
        status = inside('cat', f'/proc/{pid}/status')
        for line in ('CapBnd:\t0000000000000000', 'CapEff:\t0000000000000000', 'NoNewPrivs:\t1', 'Seccomp:\t2'):
            self.assertIn(line, status)

    def test_5_a_crash_is_followed_by_a_start(self):
        pid = inside('systemctl', 'show', '-p', 'MainPID', '--value', 'strata')
        inside('systemctl', 'kill', '--signal=KILL', 'strata')
        wait_until(lambda: inside('systemctl', 'show', '-p', 'MainPID', '--value', 'strata') not in (pid, '0')
                   and inside('systemctl', 'is-active', 'strata', check=False) == 'active', 'the restart')
        inside('strata', 'health')

    def test_6_stop_is_clean_and_purge_leaves_nothing(self):
        inside('systemctl', 'stop', 'strata')
        self.assertEqual(inside('systemctl', 'show', '-p', 'Result', '-p', 'ExecMainStatus', 'strata'),
                         'Result=success\nExecMainStatus=0')
        inside('systemctl', 'start', 'strata')
        inside('dpkg', '--purge', 'strata')
        for path in ('/var/lib/strata', '/var/lib/private/strata', '/var/cache/strata', '/var/cache/private/strata',
                     '/etc/strata', '/usr/lib/systemd/system/strata.service'):
            self.assertNotEqual(subprocess.run(['podman', 'exec', NAME, 'ls', '-d', path], capture_output=True).returncode,
                                0, path)
        self.assertEqual(inside('sh', '-c', 'cat /proc/[0-9]*/comm | grep -c strata || true'), '0')


if __name__ == '__main__':
    unittest.main(verbosity=2)
