#!/usr/bin/env python3
"""Runs the README's shell snippets, in order, in one scratch folder that holds models/."""
import argparse
import os
import pathlib
import subprocess
import sys
import tempfile

from marked_blocks import marked_blocks


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--source', required=True)
    parser.add_argument('--strata', required=True)
    options = parser.parse_args()
    shell = {name: text for name, text in marked_blocks(options.source).items()
             if name.startswith('shell ')}
    if not shell:
        return 'README.md marks no shell snippet'
    first = [pathlib.Path(program).parent for program in (options.strata, sys.executable)]
    path = os.pathsep.join([*map(str, first), os.environ['PATH']])
    with tempfile.TemporaryDirectory() as folder:
        os.symlink(pathlib.Path(options.source) / 'models', pathlib.Path(folder) / 'models')
        for name, text in shell.items():
            print(f'--- {name}\n{text}', flush=True)
            status = subprocess.run(['bash', '-euo', 'pipefail', '-c', text], cwd=folder,
                                    env={**os.environ, 'PATH': path}).returncode
            if status:
                return f'{name}: exit status {status}'
    return 0


if __name__ == '__main__':
    sys.exit(main())
