"""Quadric decimation of drex-mesh beside that of Open3D, at the same number of faces.

What: each mesh is reduced to the same number of faces by both; the distance to the input is measured the same way for both
(all vertices and 50,000 points by area of each mesh, exact point-to-triangle distances, both ways), and whether the result
is still closed.

    pip install open3d==0.19.0
    cargo build --release -p drex-mesh --example decimate
    python tests/peers/decimate.py FACES MESH.obj [MESH.obj ...]

Prints one line per mesh and tool: faces, worst and mean distance in mm, spread of the edge lengths, open edges,
processor seconds (those of drex-mesh include reading, repair, counting crossings and measuring the distance).
"""

import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np
import open3d as o3d


def load(path):
    mesh = o3d.io.read_triangle_mesh(path)
    mesh.remove_duplicated_vertices()
    mesh.remove_degenerate_triangles()
    return mesh


def one_way(a, b):
    """Distances from vertices and area samples of a to the surface of b."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(b))
    o3d.utility.random.seed(1)
    sampled = np.asarray(a.sample_points_uniformly(50_000).points)
    distance = lambda p: scene.compute_distance(o3d.core.Tensor(np.asarray(p, dtype=np.float32))).numpy()
    return distance(a.vertices).max(), distance(sampled)


def open_edges(mesh):
    f = np.asarray(mesh.triangles)
    edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts != 2).sum())


def edge_spread(mesh):
    """Standard deviation of the edge lengths relative to their mean."""
    v, f = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    lengths = np.concatenate([np.linalg.norm(v[f[:, k]] - v[f[:, (k + 1) % 3]], axis=1) for k in range(3)])
    return lengths.std() / lengths.mean()


def line(name, tool, before, after, seconds):
    worst_there, there = one_way(before, after)
    worst_back, back = one_way(after, before)
    worst = max(worst_there, worst_back, there.max(), back.max())
    mean = 0.5 * (there.mean() + back.mean())
    print(
        f"{name:12} {tool:10} {len(after.triangles):7} faces  worst {1e3 * worst:7.3f} mm  mean {1e3 * mean:.4f} mm  "
        f"edges +-{100 * edge_spread(after):3.0f} %  {open_edges(after):5} open edges  {seconds:6.2f} s"
    )


def main():
    faces, paths = int(sys.argv[1]), sys.argv[2:]
    ours = os.environ.get("DREX_DECIMATE", "target/release/examples/decimate")
    for path in paths:
        name, before = os.path.splitext(os.path.basename(path))[0], load(path)
        with tempfile.TemporaryDirectory() as folder:
            out = os.path.join(folder, "out.obj")
            used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run([ours, path, out, str(faces)], check=True, stdout=subprocess.DEVNULL)
            used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used
            line(name, "drex-mesh", before, load(out), used)
        start = time.process_time()
        peer = before.simplify_quadric_decimation(faces)
        line(name, "Open3D", before, peer, time.process_time() - start)


if __name__ == "__main__":
    main()
