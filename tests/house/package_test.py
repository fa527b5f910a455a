#!/usr/bin/env python3
"""Installs the build, then makes the README's example program against the installed package alone."""
import argparse
import pathlib
import subprocess
import sys
import tempfile

from marked_blocks import marked_blocks

HEADER_CHECK = """
foreach(header IN LISTS headers)
  string(MAKE_C_IDENTIFIER ${header} name)
  file(WRITE ${CMAKE_BINARY_DIR}/${name}.cc "#include \\"${header}\\"\\n")
  target_sources(points PRIVATE ${CMAKE_BINARY_DIR}/${name}.cc)
endforeach()
"""


def run(*command):
    print('+', *command, flush=True)
    subprocess.run(command, check=True)


def main():
    parser = argparse.ArgumentParser()
    for name in ('source', 'build', 'cmake', 'compiler'):
        parser.add_argument(f'--{name}', required=True)
    options = parser.parse_args()
    blocks = marked_blocks(options.source)
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        prefix, program = root / 'prefix', root / 'program'
        run(options.cmake, '--install', options.build, '--prefix', prefix)
        program.mkdir()
        include = prefix / 'include' / 'strata'
        headers = sorted(str(path.relative_to(include)) for path in include.rglob('*.h'))
        # Every installed header must stand on its own.
        (program / 'CMakeLists.txt').write_text(
            blocks['CMakeLists.txt'] + f'set(headers {" ".join(headers)})' + HEADER_CHECK)
        (program / 'points.cc').write_text(blocks['points.cc'])
        run(options.cmake, '-S', program, '-B', root / 'build', '-G', 'Ninja',
            f'-DCMAKE_PREFIX_PATH={prefix}', f'-DCMAKE_CXX_COMPILER={options.compiler}')
        run(options.cmake, '--build', root / 'build')
        model = pathlib.Path(options.source) / 'models' / 'spot.obj'
        run(root / 'build' / 'points', model, root / 'points.ply')
        run(prefix / 'bin' / 'strata', '--version')
        if not (root / 'points.ply').read_bytes().startswith(b'ply\n'):
            return 'the program wrote no PLY file'
    return 0


if __name__ == '__main__':
    sys.exit(main())
