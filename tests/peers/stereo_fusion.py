"""Depth maps of stereo fused by Open3D's ScalableTSDFVolume and by ours: the same maps, turn by turn, on one core, judged by exact solids.

    pip install open3d==0.19.0 numpy pillow scipy trimesh
    cargo build --release -p drex-mesh --example fuse_maps
    drex asset PHOTOS --out DIR --scale 0.1 --preset fast
    DREX_SHARED=... python tests/peers/stereo_fusion.py DIR OBJECT.json [--rounds 5] [--truncation-voxels 4]

DIR holds depth/ and mesh/scan.json of `drex asset` on photos alone (whose cameras are in DIR/sfm), OBJECT.json the solids that the photos
show. Maps, masks, poses, voxels, table and box are those of scan.json for both; fusion is compared with fusion: the mesh in DIR/mesh, which is
moved to where photos agree and made simpler afterwards, is a row of its own. Ours gets confidences, and the whole photos, for silhouettes carve beside the
maps; the peer has neither and gets the maps without what is outside them, and its mesh is judged above the table and within the box.
Timed on both sides: from depth maps in memory to the mesh, ours with both passes and its cleaning. The scale of the scan is free, so
distances are those after a similarity. The ratio is that of the medians.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

sys.dont_write_bytecode = True  # of the script beside this one; the repository stays clean
from open3d_fusion import cpu_seconds, fuse, take_turn

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "target/release/examples/fuse_maps"
SHARED = pathlib.Path(os.environ.get("DREX_SHARED", ROOT.parent / "shared"))
# Of stereo's maps, as `drex asset` fuses them (crates/drex-twin/src/scan.rs).
EMPTY_VOTES, LEAST_VIEWS_SHARE, USUAL_CONFIDENCE = 1.5, 0.5, 0.45


def main():
    arguments = parse()
    # One core for both, chosen before Open3D starts its threads.
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    os.environ.update(OMP_NUM_THREADS="1", RAYON_NUM_THREADS="1")
    import numpy as np
    import open3d as o3d

    maps = read_maps(np, arguments.scan)
    with tempfile.TemporaryDirectory() as work:
        work = pathlib.Path(work)
        write_maps(work, maps)
        command = [EXAMPLE, work, work / "ours.ply", "--rounds", str(arguments.rounds), "--step"]
        ours = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        frames = [frame(np, o3d, view) for view in maps["views"]]
        # The first turn also reads the maps.
        ours_s, ours_cpu = [take_turn(ours)], -cpu_seconds(ours.pid)
        theirs_s, theirs_cpu = [], -time.process_time()
        for i in range(arguments.rounds):
            if i > 0:
                ours_s.append(take_turn(ours))
            start = time.perf_counter()
            mesh = fuse(o3d, frames, maps["voxel_m"], arguments.truncation_voxels)
            theirs_s.append(time.perf_counter() - start)
        ours_cpu = (ours_cpu + cpu_seconds(ours.pid)) / max(arguments.rounds - 1, 1)
        theirs_cpu = (theirs_cpu + time.process_time()) / arguments.rounds
        report = json.loads(ours.stdout.readline())["report"]
        ours.wait()
        os.sched_setaffinity(0, allowed)
        peer = cut(np, mesh, maps)
        o3d.io.write_triangle_mesh(str(work / "peer.ply"), peer)
        used = report["voxel_m"]
        print(f"{arguments.scan.name}: {len(frames)} depth maps, voxels of {1e3 * maps['voxel_m']:.2f} mm of the scan (ours took {1e3 * used:.2f})", flush=True)
        rows = [
            ("drex fusion", work / "ours.ply", ours_s, ours_cpu),
            ("open3d", work / "peer.ply", theirs_s, theirs_cpu),
            ("drex asset (refined)", arguments.scan / "mesh/visual.obj", None, None),
        ]
        found = [row(arguments, *r) for r in rows]
    wall = np.median(ours_s) / np.median(theirs_s)
    ours, theirs = found[0], found[1]
    ratios = [f"of accuracy in the median {ratio(ours, theirs, 'accuracy_mm', 'median')}", f"rms {ratio(ours, theirs, 'accuracy_mm', 'rms')}"]
    ratios.append(f"of completeness at 95 % {ratio(ours, theirs, 'completeness_mm', 'p95')}")
    print(f"  drex fusion / open3d: ratio {', '.join(ratios)}; of medians of time {wall:.2f}, of CPU {ours_cpu / theirs_cpu:.2f}")
    print(f"  a millimetre of the scan is {ours['scale']:.3f} mm of the object")


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scan", type=pathlib.Path)
    parser.add_argument("truth", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--truncation-voxels", type=float, default=4.0)
    return parser.parse_args()


def read_maps(np, scan):
    """Depth in metres, silhouettes and poses in the frame of the mesh, as whole photos."""
    from PIL import Image

    record = json.loads((scan / "mesh/scan.json").read_text())
    given, evidence = record["scan"], record["evidence"]
    similarity = np.array(given["mesh_from_scan"])
    scale = given["metres_per_unit"]
    photo = json.loads((scan / "sfm/transforms.json").read_text())
    own = {pathlib.Path(f["file_path"]).stem: f for f in photo["frames"]}
    views = []
    for f in json.loads((scan / "depth/transforms.json").read_text())["frames"]:
        name = pathlib.Path(f["file_path"]).stem
        depth = np.load(scan / "depth" / f["depth_file_path"]).astype(np.float32) * np.float32(scale)
        picture = np.asarray(Image.open(scan / "depth" / f["file_path"]))
        mask = picture[:, :, 3] >= 128 if picture.shape[2] == 4 else None
        confidence = scan / "depth" / f["confidence_file_path"]
        trust = np.asarray(Image.open(confidence)).astype(np.float32) / np.float32(255 * USUAL_CONFIDENCE)
        lens = {key: own[name].get(key, photo.get(key)) for key in ["w", "h", "cx", "cy"]}
        left, top = round(lens["cx"] - f["cx"]), round(lens["cy"] - f["cy"])
        pose = np.array(f["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])
        pose = similarity @ pose
        pose[:3, :3] /= scale
        views.append(dict(depth=depth, trust=trust, mask=mask, lens=f, corner=(left, top), size=(int(lens["w"]), int(lens["h"])), pose=pose))
    if not all(v["mask"] is not None for v in views):
        for view in views:
            view["mask"] = None
    support = evidence["support"]
    return dict(
        views=views,
        voxel_m=record["fusion"]["voxel_m"],
        region_m=given.get("region_m"),
        support=support and {key: support[key] for key in ["point_m", "up"]},
    )


def write_maps(work, maps):
    """For ours: each map where it lies in its photo, nothing of the object beside it."""
    import numpy as np

    views = []
    for i, view in enumerate(maps["views"]):
        (left, top), (h, w), f = view["corner"], view["depth"].shape, view["lens"]
        width, height = max(view["size"][0], left + w), max(view["size"][1], top + h)
        left, top, width, height = (left, top, width, height) if min(left, top) >= 0 else (0, 0, w, h)
        for key, name in [("depth", "f32"), ("trust", "trust.f32")]:
            whole = np.zeros((height, width), np.float32)
            whole[top : top + h, left : left + w] = view[key]
            whole.tofile(work / f"{i:03d}.{name}")
        if view["mask"] is not None:
            mask = np.zeros((height, width), np.uint8)
            mask[top : top + h, left : left + w] = view["mask"]
            mask.tofile(work / f"{i:03d}.u8")
        lens = dict(width=width, height=height, fx=f["fl_x"], fy=f["fl_y"], cx=f["cx"] + left, cy=f["cy"] + top)
        views.append(dict(lens, world_from_camera=view["pose"].tolist()))
    given = {key: maps[key] for key in ["voxel_m", "region_m", "support"]}
    given |= dict(empty_votes=EMPTY_VOTES, least_views_share=LEAST_VIEWS_SHARE, views=views)
    (work / "maps.json").write_text(json.dumps(given))


def frame(np, o3d, view):
    """The same map for the peer, whose pixel centres are whole numbers: image, intrinsics, camera-from-world pose."""
    depth, f = view["depth"], view["lens"]
    if view["mask"] is not None:
        depth = np.where(view["mask"], depth, np.float32(0.0))
    color = o3d.geometry.Image(np.zeros((*depth.shape, 3), np.uint8))
    image = o3d.geometry.RGBDImage.create_from_color_and_depth(
        color, o3d.geometry.Image(np.ascontiguousarray(depth)), depth_scale=1.0, depth_trunc=10.0, convert_rgb_to_intensity=False
    )
    height, width = depth.shape
    lens = o3d.camera.PinholeCameraIntrinsic(width, height, f["fl_x"], f["fl_y"], f["cx"] - 0.5, f["cy"] - 0.5)
    return image, lens, np.linalg.inv(view["pose"])


def cut(np, mesh, maps):
    """What of a mesh is within the box and above the table."""
    points = np.asarray(mesh.vertices)
    keep = np.ones(len(points), bool)
    if maps["region_m"]:
        lo, hi = np.array(maps["region_m"])
        keep &= ((points >= lo) & (points <= hi)).all(axis=1)
    if maps["support"]:
        keep &= (points - np.array(maps["support"]["point_m"])) @ np.array(maps["support"]["up"]) > 0.0
    mesh.remove_vertices_by_mask(~keep)
    return mesh


def row(arguments, name, mesh, seconds, cpu):
    judge = [sys.executable, SHARED / "tools/compare_surface.py", mesh, arguments.truth, "--json"]
    found = json.loads(subprocess.run([str(c) for c in judge], capture_output=True, text=True, check=True).stdout)
    accuracy, completeness = found["accuracy_mm"], found["completeness_mm"]
    values = f"accuracy median {accuracy['median']:.2f} rms {accuracy['rms']:.2f} mm  completeness 95 % {completeness['p95']:.2f} mm"
    # An open mesh has no volume.
    volume = f"{found['volume_ratio']:.3f}" if found["watertight"] else "-"
    values += f"  F 1 mm {found['fscore_1mm']:.3f}  volume {volume}  closed {'yes' if found['watertight'] else 'no'}  faces {found['faces']}"
    if seconds:
        values += f"  median {sorted(seconds)[len(seconds) // 2]:.2f} s  CPU {cpu:.2f} s"
    print(f"  {name:20} {values}", flush=True)
    return found


def ratio(ours, theirs, what, key):
    return f"{ours[what][key] / theirs[what][key]:.2f}"


if __name__ == "__main__":
    main()
