"""Depth fusion next to Open3D's ScalableTSDFVolume: the same depth maps in memory, turn by turn, on one core.

    pip install open3d==0.19.0 numpy scipy
    cargo build --release -p drex-mesh --example fuse_views
    python tests/peers/open3d_fusion.py FOLDER [--shapes mug,box] [--noise-mm 0,1] [--rounds 5] [--truncation-voxels 4]

FOLDER holds NAME.obj and views.json (40 cameras per shape). Open3D 0.20.0 gives an empty volume, so 0.19.0 it is. Ours writes the
depth maps, with the noise, to a temporary folder for the peer. Timed on both sides: from depth maps in memory to the mesh, ours with
its two passes, probing and cleaning. The ratio is that of the medians, the peer's alternating with ours on the same core.
"""

import argparse
import json
import os
import pathlib
import subprocess
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "target/release/examples/fuse_views"
SAMPLES = 100_000
TAUS = [0.5e-3, 1e-3, 2e-3]


def main():
    arguments = parse()
    # One core for both, chosen before Open3D starts its threads.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    os.environ.update(OMP_NUM_THREADS="1", RAYON_NUM_THREADS="1")
    views = json.loads((arguments.folder / "views.json").read_text())
    with tempfile.TemporaryDirectory() as folder:
        for shape in arguments.shapes.split(","):
            for noise in arguments.noise_mm.split(","):
                compare(arguments, views, shape, noise, pathlib.Path(folder))


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--shapes", default="mug,bottle,bracket,box")
    parser.add_argument("--noise-mm", default="0,1")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--voxel-mm", type=float, default=1.5)
    parser.add_argument("--truncation-voxels", type=float, default=4.0)
    return parser.parse_args()


def compare(arguments, views, shape, noise, folder):
    import numpy as np
    import open3d as o3d

    command = [EXAMPLE, arguments.folder, "--shapes", shape, "--noise-mm", noise, "--voxel-mm", str(arguments.voxel_mm)]
    command += ["--rounds", str(arguments.rounds), "--step", "--write-views", folder]
    ours = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    # The first turn also casts the views and writes them.
    ours_s, ours_cpu = [take_turn(ours)], -cpu_seconds(ours.pid)
    frames = read_frames(np, o3d, views, shape, folder / f"{shape}_{noise}mm")
    theirs_s, theirs_cpu = [], -time.process_time()
    for i in range(arguments.rounds):
        if i > 0:
            ours_s.append(take_turn(ours))
        start = time.perf_counter()
        mesh = fuse(o3d, frames, arguments.voxel_mm * 1e-3, arguments.truncation_voxels)
        theirs_s.append(time.perf_counter() - start)
    ours_cpu = (ours_cpu + cpu_seconds(ours.pid)) / max(arguments.rounds - 1, 1)
    theirs_cpu = (theirs_cpu + time.process_time()) / arguments.rounds
    result = json.loads(ours.stdout.readline())
    ours.wait()
    truth = o3d.io.read_triangle_mesh(str(arguments.folder / f"{shape}.obj"))
    peer = score(np, o3d, mesh, truth)
    keys = ["f_05", "f_1", "f_2", "chamfer_mm", "volume_error_pct", "closed", "components", "faces"]
    print(f"{shape}, noise {noise} mm", flush=True)
    for name, values, seconds, cpu in [("drex", result, ours_s, ours_cpu), ("open3d", peer, theirs_s, theirs_cpu)]:
        row = "  ".join(f"{k} {values[k]:.4g}" if isinstance(values[k], float) else f"{k} {values[k]}" for k in keys)
        print(f"  {name:7s}{row}  median {np.median(seconds):.3f} s  least {min(seconds):.3f} s  CPU {cpu:.3f} s", flush=True)
    wall = np.median(ours_s) / np.median(theirs_s)
    print(f"  ratio of medians {wall:.2f}, of CPU {ours_cpu / theirs_cpu:.2f}", flush=True)


def take_turn(ours):
    ours.stdin.write("\n")
    ours.stdin.flush()
    return json.loads(ours.stdout.readline())["round_s"]


def cpu_seconds(pid):
    """Of all threads of a process, in ticks of 10 ms."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def read_frames(np, o3d, views, shape, folder):
    """Depth images and camera-from-world poses."""
    size = (views["height"], views["width"])
    frames = []
    for i, pose in enumerate(views["shapes"][shape]["world_from_camera"]):
        depth = np.fromfile(folder / f"{i:03d}.f32", dtype=np.float32).reshape(size)
        color = o3d.geometry.Image(np.zeros((*size, 3), np.uint8))
        image = o3d.geometry.RGBDImage.create_from_color_and_depth(
            color, o3d.geometry.Image(depth), depth_scale=1.0, depth_trunc=10.0, convert_rgb_to_intensity=False
        )
        frames.append((image, np.linalg.inv(np.array(pose))))
    # Open3D's pixel centres are whole numbers, ours halves.
    k = views["K"]
    lens = o3d.camera.PinholeCameraIntrinsic(
        size[1], size[0], k[0][0], k[1][1], k[0][2] - 0.5, k[1][2] - 0.5
    )
    return [(image, lens, pose) for image, pose in frames]


def fuse(o3d, frames, voxel, truncation_voxels):
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        voxel_length=voxel,
        sdf_trunc=truncation_voxels * voxel,
        color_type=o3d.pipelines.integration.TSDFVolumeColorType.NoColor,
    )
    for image, lens, pose in frames:
        volume.integrate(image, lens, pose)
    return volume.extract_triangle_mesh()


def score(np, o3d, mesh, truth):
    """The same scores as ours, with Open3D's own distances."""

    def distances(points_of, to):
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(to))
        points = np.asarray(points_of.sample_points_uniformly(SAMPLES).points, dtype=np.float32)
        return scene.compute_distance(o3d.core.Tensor(points)).numpy()

    accuracy, completeness = distances(mesh, truth), distances(truth, mesh)
    f = []
    for tau in TAUS:
        p, r = (accuracy < tau).mean(), (completeness < tau).mean()
        f.append(float(2 * p * r / (p + r)))
    labels, counts, _ = mesh.cluster_connected_triangles()
    largest = o3d.geometry.TriangleMesh(mesh)
    largest.remove_triangles_by_mask(np.asarray(labels) != int(np.argmax(counts)))
    return {
        "f_05": f[0],
        "f_1": f[1],
        "f_2": f[2],
        "chamfer_mm": float(500.0 * (accuracy.mean() + completeness.mean())),
        "volume_error_pct": 100.0 * (signed_volume(np, largest) / signed_volume(np, truth) - 1.0),
        "closed": mesh.is_edge_manifold(allow_boundary_edges=False),
        "components": len(counts),
        "faces": len(mesh.triangles),
    }


def signed_volume(np, mesh):
    a, b, c = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


if __name__ == "__main__":
    main()
