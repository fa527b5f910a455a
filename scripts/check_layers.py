#!/usr/bin/env python3
"""Holds the direction of the layers: server -> io -> core, server -> proto.

Reads every #include line under core/, io/, proto/ and server/ and fails with file and line when a
layer reaches up, or when a library shows outside its place. `--self-test` plants a violation of
every rule in a scratch tree and expects each to be found.
"""
import pathlib
import re
import sys
import tempfile

INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')
SUFFIXES = {'.h', '.cc', '.in', '.proto'}

# Layer -> the layers whose headers it may include.
LAYERS = {
    'core': {'core'},
    'io': {'core', 'io'},
    'proto': {'proto'},
    'server': {'core', 'io', 'proto', 'server'},
}
# Library, by how its headers begin -> the layers that may include it.
LIBRARIES = {
    'tl/': {'core', 'io', 'server'},
    'tbb/': {'core', 'io', 'server'},
    'oneapi/': {'core', 'io'},
    'hwy/': {'core'},
    'Random123/': {'core'},
    'openvdb/': {'core', 'server'},
    'draco/': {'io'},
    'expat.h': {'io'},
    'assimp/': {'server'},
    'fast_float/': {'io'},
    'meshoptimizer.h': {'io'},
    'openssl/': {'io', 'server'},
    'prometheus/': {'server'},
    'toml++/': {'server'},
    'png.h': {'io'},
    'jpeglib.h': {'io'},
    'jerror.h': {'io'},
    'webp/': {'io'},
    'zlib.h': {'io'},
    'zstd.h': {'core', 'io'},
    'curl/': {'server'},
    'pugixml.hpp': {'server'},
    'libpq-fe.h': {'server'},
    'sqlite3.h': {'server'},
    'utf8cpp/': {'server'},
    'CLI/': {'server'},
    'nlohmann/': {'io', 'server'},
    'spdlog/': {'server'},
    'grpc/': {'server'},
    'grpcpp/': {'server'},
    'google/protobuf/': {'server', 'proto'},
    'boost/': {'server'},
}
ONLY_IN_SOURCES = {'curl/', 'draco/', 'openvdb/', 'pugixml.hpp'}  # Never in a header, where it would spread.
ONE_FILE = {'openvdb/'}  # In one source file of each layer.
# In this folder alone.
ONE_FOLDER = {
    'sqlite3.h': 'server/store', 'libpq-fe.h': 'server/store', 'curl/': 'server/remote',
    'pugixml.hpp': 'server/remote'}
# In a layer that may use it, in this folder alone: the program that writes vdb (ADR 25).
FOLDER_IN_LAYER = {('server', 'openvdb/'): 'server/vdb', ('server', 'tbb/'): 'server/vdb'}
# The stores serve every transport, so they know none, and no wire format.
STORE = 'server/store'
STORE_MAY_INCLUDE = ('core/', 'io/', 'server/store/')
STORE_MAY_NOT_USE = ('CLI/', 'nlohmann/', 'spdlog/', 'grpc/', 'grpcpp/', 'google/', 'boost/')
STANDARD = re.compile(r'^[a-z0-9_]+$')
POSIX = re.compile(r'^((sys|net|netinet|arpa|linux)/)?[a-z0-9_]+\.h$')
MAY_USE_POSIX = {'io', 'server'}
# Beyond those layers: what keeps runs on disk (ADR 9), and what gives freed memory back.
POSIX_FILES = {'scratch.cc', 'memory_account.cc'}


def includes(root):
    """Yields (layer, path, line number, quoted, target) of every #include line."""
    for layer in LAYERS:
        for path in sorted((root / layer).rglob('*')):
            if path.suffix not in SUFFIXES or not path.is_file():
                continue
            for number, line in enumerate(path.read_text(errors='replace').splitlines(), 1):
                match = INCLUDE.match(line)
                if match:
                    yield layer, path, number, match[1] == '"', match[2]


def fault(layer, path, target, quoted):
    """What is wrong with one include, or None."""
    if quoted:
        # What protoc makes of proto/strata/v1/x.proto is "strata/v1/x.pb.h".
        top = 'proto' if target.startswith('strata/') else target.split('/')[0]
        if top in LAYERS[layer]:
            return None
        return f'{layer}/ may include only {", ".join(sorted(LAYERS[layer]))}'
    for prefix, layers in LIBRARIES.items():
        if target.startswith(prefix):
            if layer not in layers:
                return f'{prefix} belongs to {", ".join(sorted(layers))}'
            if prefix in ONLY_IN_SOURCES and path.suffix != '.cc':
                return f'{prefix} may stand in .cc files only'
            return None
    may_use_posix = layer in MAY_USE_POSIX or path.name in POSIX_FILES
    if STANDARD.match(target) or (may_use_posix and POSIX.match(target)):
        return None
    return f'{layer}/ has no leave to use it; see LIBRARIES in scripts/check_layers.py'


def folder_fault(folder, target, quoted):
    """What the folder of a file has against one include, or None."""
    for prefix, place in ONE_FOLDER.items():
        if target.startswith(prefix) and folder != place:
            return f'{prefix} belongs to {place}/'
    for (layer, prefix), place in FOLDER_IN_LAYER.items():
        if folder.split('/')[0] == layer and target.startswith(prefix) and folder != place:
            return f'{prefix} belongs to {place}/ in {layer}/'
    if folder != STORE:
        return None
    if quoted and not target.startswith(STORE_MAY_INCLUDE):
        return f'{STORE}/ may include only {", ".join(STORE_MAY_INCLUDE)}'
    if not quoted and target.startswith(STORE_MAY_NOT_USE):
        return f'{STORE}/ knows no transport and no wire format'
    return None


def violations(root):
    found, users = [], {}
    for layer, path, number, quoted, target in includes(root):
        place = f'{path.relative_to(root)}:{number}: {target}'
        folder = str(path.parent.relative_to(root))
        problem = fault(layer, path, target, quoted) or folder_fault(folder, target, quoted)
        if problem:
            found.append(f'{place}: {problem}')
        for prefix in ONE_FILE:
            if target.startswith(prefix):
                users.setdefault((prefix, layer), {}).setdefault(path, place)
    for (prefix, _), places in users.items():
        found += [f'{place}: {prefix} may stand in one file of a layer only'
                  for place in list(places.values())[1:]]
    return found


def self_test():
    clean = {
        'core/a.h': '#include <vector>\n#include "core/b.h"\n#include <tl/expected.hpp>\n',
        'core/b.cc': '#include <openvdb/openvdb.h>\n#include <tbb/task_arena.h>\n',
        'core/scratch.cc': '#include <unistd.h>\n',
        'io/a.cc': '#include <fcntl.h>\n#include <draco/a.h>\n#include "core/a.h"\n',
        'server/vdb/a.cc': '#include <openvdb/openvdb.h>\n#include <tbb/global_control.h>\n',
        'server/a.cc': '#include <CLI/App.hpp>\n#include "io/a.h"\n#include <sys/stat.h>\n'
                       '#include "strata/v1/a.pb.h"\n',
    }
    planted = {
        'core/up.h': '#include "io/open_mesh.h"\n',
        'core/posix.cc': '#include <unistd.h>\n',
        'core/json.cc': '  #  include <nlohmann/json.hpp>\n',
        'core/header.h': '#include <openvdb/tree/Tree.h>\n',
        'core/second.cc': '#include <openvdb/openvdb.h>\n',
        'io/up.cc': '#include "server/main.h"\n',
        'io/wire.cc': '#include "strata/v1/options.pb.h"\n',
        'io/log.cc': '#include <spdlog/spdlog.h>\n',
        'io/draco.h': '#include <draco/core/status.h>\n',
        'io/unknown.cc': '#include <assimp/Importer.hpp>\n',
        'io/tests.cc': '#include "tests/support/helper.h"\n',
        'server/mesh.cc': '#include <draco/mesh/mesh.h>\n',
        'proto/up.h': '#include "server/a.h"\n',
        'server/grid.cc': '#include <openvdb/openvdb.h>\n',
        'server/threads.cc': '#include <tbb/parallel_for.h>\n',
        'server/vdb/b.cc': '#include <openvdb/points/PointDataGrid.h>\n',
        'server/rows.cc': '#include <sqlite3.h>\n',
        'server/lines.cc': '#include <libpq-fe.h>\n',
        'server/fetch.cc': '#include <curl/curl.h>\n',
        'server/store/up.cc': '#include "server/exit_codes.h"\n',
        'server/store/wire.h': '#include <nlohmann/json.hpp>\n',
    }

    def run(files):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            for name, text in files.items():
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                (root / name).write_text(text)
            return violations(root)

    failures = [f'clean tree refused: {line}' for line in run(clean)]
    for name, text in planted.items():
        if not any(line.startswith(name) for line in run({**clean, name: text})):
            failures.append(f'not found: {name}: {text.strip()}')
    print('\n'.join(failures) or f'The check finds all {len(planted)} planted violations.')
    return bool(failures)


def main():
    if sys.argv[1:] == ['--self-test']:
        return self_test()
    root = pathlib.Path(__file__).resolve().parent.parent
    found = violations(root)
    print('\n'.join(found) or 'The layers hold.')
    return bool(found)


if __name__ == '__main__':
    sys.exit(main())
