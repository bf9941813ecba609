"""Convex pieces of meshes next to CoACD, V-HACD 4 and parry's V-HACD, all measured by the same program.

    pip install coacd vhacdx trimesh scipy
    cargo build --release -p drex-mesh --example convex_parts
    OMP_NUM_THREADS=1 RAYON_NUM_THREADS=1 python tests/peers/convex_parts.py [--pieces N] [--skip coacd] MESH ...

Prints one line per mesh and method: pieces, most corners of a piece, distance from the surface of the union to the mesh (mean, 99th
percentile, largest, mm), share of the solid in no piece, volume of the union over the solid's, CPU seconds. The peers run with their
defaults (CoACD: threshold 0.05) and at most N pieces; their hulls are written as OBJ files, which the example then scores.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile
import time

import numpy as np
import trimesh

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "target" / "release" / "examples" / "convex_parts"
COLUMNS = ["pieces", "most_corners", "mean_mm", "p99_mm", "max_mm", "uncovered_share", "volume_ratio", "cpu_s"]


def example(*arguments):
    done = subprocess.run([EXAMPLE, *map(str, arguments)], capture_output=True, text=True)
    return json.loads(done.stdout) if done.returncode == 0 else None


def coacd_hulls(mesh, pieces):
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), max_convex_hull=pieces)
    return [trimesh.Trimesh(v, f) for v, f in parts]


def vhacd_hulls(mesh, pieces):
    import vhacdx

    # Each triangle with its number of corners in front.
    faces = np.insert(mesh.faces, 0, 3, axis=1).astype(np.uint32).ravel()
    parts = vhacdx.compute_vhacd(mesh.vertices, faces, maxConvexHulls=pieces)
    return [trimesh.convex.convex_hull(v) for v, _ in parts]


def peer(path, hulls, pieces):
    mesh = trimesh.load(path, force="mesh")
    start = time.process_time()
    found = hulls(mesh, pieces)
    seconds = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        for k, hull in enumerate(found):
            hull.export(pathlib.Path(folder) / f"piece_{k:03}.obj", digits=12)
        score = example(path, "--score", folder)
    return score and {**score, "cpu_s": round(seconds, 2)}


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("mesh", nargs="+")
parser.add_argument("--pieces", type=int, default=32)
parser.add_argument("--skip", action="append", default=[], choices=["coacd", "vhacd", "parry"])
arguments = parser.parse_args()
methods = {
    "drex": lambda path: example(path, "--pieces", arguments.pieces),
    "parry": lambda path: example(path, "--pieces", arguments.pieces, "--vhacd"),
    "vhacd": lambda path: peer(path, vhacd_hulls, arguments.pieces),
    "coacd": lambda path: peer(path, coacd_hulls, arguments.pieces),
}
print("| mesh | method |", " | ".join(COLUMNS), "|")
print("|---" * (len(COLUMNS) + 2) + "|")
for path in arguments.mesh:
    for name, method in methods.items():
        if name not in arguments.skip:
            score = method(path)
            cells = [str(score[c]) for c in COLUMNS] if score else ["failed"] + [""] * (len(COLUMNS) - 1)
            print(f"| {pathlib.Path(path).name} | {name} |", " | ".join(cells), "|", flush=True)
