"""Samples a mesh with Open3D: `open3d_sample.py poisson|uniform|voxel MESH POINTS [EDGE]`.

Prints one line of JSON: points, and the CPU seconds of importing, reading and sampling.
"""
import json
import sys
import time

start = time.process_time()
import open3d  # noqa: E402  The import is what is timed.

imported = time.process_time()
mode, path, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
mesh = open3d.io.read_triangle_mesh(path)
read = time.process_time()
if mode == 'poisson':
    cloud = mesh.sample_points_poisson_disk(count)  # init_factor 5, its default.
else:
    cloud = mesh.sample_points_uniformly(count)
    if mode == 'voxel':
        cloud = cloud.voxel_down_sample(float(sys.argv[4]))
done = time.process_time()
print(json.dumps({'points': len(cloud.points), 'import_cpu': imported - start,
                  'read_cpu': read - imported, 'sample_cpu': done - read}))
