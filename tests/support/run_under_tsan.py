#!/usr/bin/env python3
"""Runs a test whose programs are built for ThreadSanitizer. It fails when any process of it reports
something. Exit statuses would not do: a service that the test kills has none, and of a worker that
ends with one its service only says that a job failed. So the processes write their reports to a
folder, which is looked at in the end.
usage: run_under_tsan.py [--grpc] COMMAND...

gRPC's library is not built for ThreadSanitizer, which takes its threads' work for races. So it stays
off; with --grpc it is on, and what libraries that are not built for it read and write themselves is
not looked at (docs/adr/0027)."""
import os
import pathlib
import subprocess
import sys
import tempfile

SUPPRESSIONS = pathlib.Path(__file__).resolve().with_name('tsan.supp')


def environment(folder, grpc):
    # What stands later goes before what stands earlier. Each run shows all that it has met.
    options = [os.environ.get('TSAN_OPTIONS', ''), 'halt_on_error=0', 'atexit_sleep_ms=0',
               f'log_path={folder}/report', f'suppressions={SUPPRESSIONS}']
    if grpc:
        options.append('ignore_noninstrumented_modules=1')
    return {**os.environ, 'TSAN_OPTIONS': ' '.join(options),
            'STRATA_TEST_GRPC': 'on' if grpc else 'off'}


def main():
    grpc = sys.argv[1] == '--grpc'
    command = sys.argv[2 if grpc else 1:]
    with tempfile.TemporaryDirectory(prefix='strata-tsan-') as folder:
        os.chmod(folder, 0o1777)  # Processes of another user are among those of a test.
        status = subprocess.run(command, env=environment(folder, grpc)).returncode
        reports = [path.read_text(errors='replace')
                   for path in sorted(pathlib.Path(folder).glob('report.*'))]
    for report in reports:
        print(report)
    warnings = sum(report.count('WARNING: ThreadSanitizer') for report in reports)
    print(f'ThreadSanitizer: {warnings} reports of {len(reports)} processes')
    return 1 if reports else status


if __name__ == '__main__':
    sys.exit(main())
