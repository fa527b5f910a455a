#!/bin/sh
# Samples one large mesh on a Slurm cluster: a job array scans its shares, and a job that depends on
# all of them merges what they found. The result has the bytes that a single `strata sample` writes.
#
#   STRATA_MESH=/shared/city.ply STRATA_SHARES=64 STRATA_OUTPUT=/shared/city.drc \
#   STRATA_SCAN_OPTIONS="--voxel-size 0.05" docker/slurm/submit.sh
#
# must be set
#   STRATA_MESH           the mesh; every node must see it under this path
#   STRATA_OUTPUT         the result: .drc, .ply, .xyz or .npz
# may be set
#   STRATA_SHARES         how many shares, 1 or more (default 16); Slurm allows 1001 tasks in an
#                         array unless MaxArraySize in slurm.conf says otherwise
#   STRATA_PARTS          a folder that every node sees, for what the shares found (default:
#                         STRATA_OUTPUT with .parts added); it stays, and may be removed afterwards
#   STRATA_SCAN_OPTIONS   options of `strata scan`: --resolution, --voxel-size, --height, --lattice,
#                         --lambda, --seed, --integrator, --attributes …
#   STRATA_MERGE_OPTIONS  options of `strata merge`: --min-distance, --attributes, --format …
#   STRATA_SCRATCH        a folder for scratch space that outlives a task, best one that every node
#                         sees: a task that starts again then goes on where it was killed (default:
#                         the node's own temporary folder, and no going on)
#   STRATA_REGIONS        how many tasks share the merge, where the result is a folder of tiles (.drc);
#                         0, the default: one, with any result
#   STRATA_RETRIES        how often a task that was killed or could not read or write is put back
#                         into the queue (default 3)
#   STRATA                the command (default: strata, as found on the nodes)
#   SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_TIMELIMIT and so on: sbatch reads them itself
# Paths and options are separated by blanks where there are several: none may contain one.
#
# Prints the numbers of the two jobs: array, then merge.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
: "${STRATA_MESH:?is not set: the mesh to sample}"
: "${STRATA_OUTPUT:?is not set: where the result goes}"
STRATA_SHARES=${STRATA_SHARES:-16}
STRATA_PARTS=${STRATA_PARTS:-$STRATA_OUTPUT.parts}
STRATA_REGIONS=${STRATA_REGIONS:-0}
export STRATA_MESH STRATA_OUTPUT STRATA_SHARES STRATA_PARTS STRATA_REGIONS
mkdir -p "$STRATA_PARTS"

# --export=ALL hands the STRATA_ variables on. --parsable prints "number" or "number;cluster".
array=$(sbatch --parsable --export=ALL --array="0-$((STRATA_SHARES - 1))" \
  "$here/strata-array.sbatch")
array=${array%%;*}
# afterok: only once every task of the array has ended with status 0. If one cannot, the merge is
# cancelled instead of waiting for ever.
set -- --parsable --export=ALL --dependency="afterok:$array" --kill-on-invalid-dep=yes
[ "$STRATA_REGIONS" -eq 0 ] || set -- "$@" --array="0-$((STRATA_REGIONS - 1))"
merge=$(sbatch "$@" "$here/strata-merge.sbatch")
echo "$array ${merge%%;*}"
