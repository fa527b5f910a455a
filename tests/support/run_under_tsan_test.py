#!/usr/bin/env python3
"""That a race of any process fails its test, however the process ends, and nothing else does.
usage: run_under_tsan_test.py PLANTED_RACE"""
import pathlib
import subprocess
import sys
import unittest

RUN = pathlib.Path(__file__).resolve().with_name('run_under_tsan.py')
PLANTED = sys.argv.pop()


def run(*arguments):
    """(exit status, output) of a test whose process is a child of its own, as a service is, and
    which does not care how that ends."""
    test = ('import subprocess, sys\n'
            f'subprocess.run([{PLANTED!r}, *sys.argv[2:]])\nsys.exit(int(sys.argv[1]))')
    done = subprocess.run([RUN, sys.executable, '-c', test, *arguments], capture_output=True,
                          text=True, timeout=300)
    return done.returncode, done.stdout


class RunUnderTsan(unittest.TestCase):

    def test_a_race_fails_the_test_even_when_its_process_is_killed(self):
        for end in ('exit', 'kill'):
            status, output = run('0', 'race', end)
            self.assertEqual(status, 1, output)
            self.assertIn('WARNING: ThreadSanitizer: data race', output)
            self.assertIn('planted_race.cc', output, 'what was reported has no symbols')

    def test_without_a_race_the_status_is_the_test_s_own(self):
        for wanted in (0, 3, 77):
            status, output = run(str(wanted), 'lock', 'exit')
            self.assertEqual((status, output), (wanted, 'ThreadSanitizer: 0 reports of 0 processes\n'))


if __name__ == '__main__':
    unittest.main(verbosity=2)
