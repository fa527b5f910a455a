"""The other programs that the table compares with, from Debian packages. None is needed."""
import functools
import pathlib
import subprocess
import sys

from measure import Command

HERE = pathlib.Path(__file__).resolve().parent
OPEN3D_ABSENT = 'Open3D absent: apt-get install --no-install-recommends python3-open3d'
CGAL_ABSENT = 'CGAL absent: apt-get install --no-install-recommends libcgal-dev g++'


@functools.cache
def has_open3d():
    return subprocess.run([sys.executable, '-c', 'import open3d'],
                          capture_output=True).returncode == 0


def open3d(mode, mesh, points, *edge):
    script = HERE / 'peers/open3d_sample.py'
    return Command([sys.executable, script, mode, mesh, points, *edge], json_stdout=True)


@functools.cache
def cgal_program(folder):
    """The path of cgal_sample, compiled now; None where that fails."""
    program = folder / 'cgal_sample'
    compiled = subprocess.run(
        ['g++', '-std=c++17', '-O2', '-DNDEBUG', HERE / 'peers/cgal_sample.cc', '-o', program,
         '-lgmp', '-lmpfr'], capture_output=True) if has_compiler() else None
    return program if compiled and compiled.returncode == 0 else None


def has_compiler():
    try:
        return subprocess.run(['g++', '--version'], capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


def all_quick(mesh, points, edge, folder, cgal):
    """(name -> Command, what is absent): uniform samples, alone and thinned to one a cell."""
    commands, absent = {}, []
    if has_open3d():
        commands['Open3D uniform'] = open3d('uniform', mesh, points)
        commands['Open3D uniform + voxel down-sampling'] = open3d('voxel', mesh, points, edge)
    else:
        absent.append(OPEN3D_ABSENT)
    if not cgal:
        return commands, absent
    program = cgal_program(folder)
    if program:
        commands['CGAL random'] = Command([program, 'random', mesh, points], json_stdout=True)
        commands['CGAL random + grid'] = Command([program, 'grid', mesh, points, edge],
                                                 json_stdout=True)
    else:
        absent.append(CGAL_ABSENT)
    return commands, absent
