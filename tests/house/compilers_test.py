#!/usr/bin/env python3
"""Two builds of the command, one per compiler, must write the same bytes."""
import argparse
import pathlib
import subprocess
import sys
import tempfile

SKIPPED = 77
CASES = {
    'default.drc': [],
    'default.ply': ['--attributes', 'normal,triangle,barycentric,cell,area'],
    'default.xyz': ['--seed', '7'],
    'default.npz': ['--height', '6'],
    'uniform.ply': ['--lambda', '0', '--min-distance', '0'],
    'steep.ply': ['--lambda', '60', '--resolution', '40'],
    'dense.ply': ['--voxel-size', '0.005', '--min-distance', '0.9'],
    'subdivide.ply': ['--integrator', 'subdivide', '--height', '6'],
}


def main():
    parser = argparse.ArgumentParser()
    for name in ('source', 'strata', 'other'):
        parser.add_argument(f'--{name}', required=True)
    options = parser.parse_args()
    if not pathlib.Path(options.other).is_file():
        print('Skipped: STRATA_OTHER_BINARY names no second build (scripts/test.sh makes one).')
        return SKIPPED
    model = pathlib.Path(options.source) / 'models' / 'spot.obj'
    differing = []
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in CASES.items():
            written = []
            for binary in (options.strata, options.other):
                output = pathlib.Path(folder) / name
                subprocess.run([binary, 'sample', model, '-o', output, '--quiet', *arguments],
                               check=True)
                written.append(output.read_bytes())
            if written[0] != written[1]:
                differing.append(name)
            print(f'{name}: {len(written[0])} bytes', 'DIFFER' if name in differing else 'equal')
    return bool(differing)


if __name__ == '__main__':
    sys.exit(main())
