#!/usr/bin/env python3
"""packaging/strata.service, as systemd-analyze sees it; no systemd has to run."""
import argparse
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

ARGUMENTS = None
SKIPPED = 77
MOST_EXPOSURE = 1.1  # Of 10. docs/deployment.md says it, too.


def text():
    return (pathlib.Path(ARGUMENTS.source) / 'packaging' / 'strata.service').read_text()


def analyze(*command):
    """systemd-analyze on the unit, its program replaced by the one that was built."""
    with tempfile.TemporaryDirectory() as folder:
        unit = pathlib.Path(folder) / 'strata.service'
        unit.write_text(text().replace('/usr/bin/strata', ARGUMENTS.strata))
        return subprocess.run(['systemd-analyze', *command, unit], capture_output=True, text=True,
                              timeout=60)


class Unit(unittest.TestCase):

    def test_systemd_understands_every_line(self):
        done = analyze('verify', '--man=no')
        self.assertEqual((done.returncode, done.stdout + done.stderr), (0, ''))

    def test_the_exposure_is_no_more_than_the_documents_say(self):
        done = analyze('security', '--offline=true', f'--threshold={round(MOST_EXPOSURE * 10)}')
        self.assertEqual(done.returncode, 0, done.stdout)
        found = re.search(r'exposure level for \S+: (\S+)', done.stdout)
        self.assertEqual(float(found[1]), MOST_EXPOSURE, 'docs/deployment.md says another figure')
        document = (pathlib.Path(ARGUMENTS.source) / 'docs' / 'deployment.md').read_text()
        self.assertIn(f'exposure {MOST_EXPOSURE}', document)

    def test_systemd_waits_longer_than_the_service_drains(self):
        stop = int(re.search(r'^TimeoutStopSec=(\d+)$', text(), re.MULTILINE)[1])
        said = subprocess.run([ARGUMENTS.strata, 'serve', '--help'], capture_output=True, text=True,
                              check=True).stdout
        drain = int(re.search(r'--drain-timeout.*?Default (\d+)\.', said, re.DOTALL)[1])
        self.assertGreater(stop, drain)

    def test_the_configuration_beside_it_is_one_that_the_service_takes(self):
        config = (pathlib.Path(ARGUMENTS.source) / 'packaging' / 'strata.toml').read_text()
        with tempfile.TemporaryDirectory() as folder:
            # A port that is no number: everything before it has been read by then.
            path = pathlib.Path(folder) / 'strata.toml'
            path.write_text(config.replace('127.0.0.1:8080', '127.0.0.1:none'))
            done = subprocess.run([ARGUMENTS.strata, 'serve', '--config', path],
                                  capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 2)
        self.assertIn(": http: found '127.0.0.1:none'", done.stderr)


def main():
    global ARGUMENTS
    parser = argparse.ArgumentParser()
    parser.add_argument('--strata', required=True)
    parser.add_argument('--source', required=True)
    ARGUMENTS = parser.parse_args()
    if not shutil.which('systemd-analyze'):
        print('Skipped: systemd-analyze is not here.')
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1], verbosity=2)


if __name__ == '__main__':
    main()
