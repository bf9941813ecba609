"""Depth by stereo next to pyarchinit-photogrammetry-core (PatchMatch in Rust; GPL, by pip only): the same photos with their exact cameras.

    pip install pyarchinit-photogrammetry-core==0.5.0 numpy pillow scipy
    cargo build --release -p drex-mvs --example depth
    DREX_SHARED=... python tests/peers/stereo_depth.py [--sets orbit60] [--every 10] [--first N] [--sources 6] [--preset fast] [--threads 2] [--gpu]

The sets are those of DREX_SHARED/data/sfm with cameras and solids in truth/. Depth is compared with that of rays cast at the solids, along the
optical axis, in pixels whose ray meets what stands more than 2 mm above the table. Both look within the same box. Ours estimates all photos of the
set, for it wants each map confirmed by others, and every 10th is judged; the peer's kernel runs on these with its defaults, on the photo cut to the
box with 12 pixels round it, each with its nearest photos from 5 degrees on, between the least and the largest depth of the box. Its own cost is its
only filter, so the error where both have a depth is printed too. Core-seconds a photo are user and system time: ours with reading
and straightening the photos, theirs of the kernel alone.
"""

import argparse
import json
import os
import pathlib
import resource
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "target/release/examples/depth"
SHARED = pathlib.Path(os.environ.get("DREX_SHARED", ROOT.parent / "shared"))
MARGIN_M = 0.01
MARGIN_PX = 12
LEAST_ANGLE_DEG = 5.0
ABOVE_TABLE_M = 0.002


def main():
    arguments = parse()
    os.environ["RAYON_NUM_THREADS"] = str(arguments.threads)
    for name in arguments.sets.split(","):
        compare(name, arguments)


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", default="orbit60")
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("--first", type=int, help="only so many photos of the set")
    parser.add_argument("--sources", type=int, default=6, help="photos that the peer matches each with")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--gpu", action="store_true", help="next to drex on the GPU instead of the peer; build the example with --features wgpu")
    return parser.parse_args()


def compare(name, arguments):
    import numpy as np

    folder = SHARED / "data/sfm" / name
    lens, views = read_truth(np, folder / "truth")
    views = {view: views[view] for view in sorted(views)[: arguments.first]}
    solids = json.loads((folder / "truth/object.json").read_text())
    box = box_of(np, solids)
    judged = sorted(views)[:: arguments.every]
    exact = {view: Exact(np, lens, views[view], box, solids) for view in judged}
    with tempfile.TemporaryDirectory() as work:
        corners = [str(v) for v in box.ravel()]

        model = pathlib.Path(work) / "model"
        shutil.copytree(folder / "truth", model)
        lines = (line + "\n\n" for line in (model / "images.txt").read_text().splitlines() if line.split()[-1:] and line.split()[-1] in views)
        (model / "images.txt").write_text("".join(lines))

        def run(*more):
            before = used()
            command = [EXAMPLE, folder, model, work, arguments.preset, *corners, *more]
            subprocess.run(command, check=True, capture_output=True)
            maps = {view: read_ours(np, pathlib.Path(work), view, exact[view]) for view in judged}
            return maps, (used() - before) / len(views)

        ours, ours_s = run()
        if arguments.gpu:
            theirs, theirs_s = run("gpu")
    if not arguments.gpu:
        theirs, theirs_s = estimate(np, arguments, folder, lens, views, exact)
        theirs_s /= len(judged)
    peer = "drex, GPU" if arguments.gpu else "ppg_core"
    both = {view: (ours[view] > 0) & (theirs[view] > 0) for view in judged}
    print(f"{name}: every {arguments.every}th of {len(views)} photos, {len(judged)} judged", flush=True)
    rows = [("drex", ours, None, ours_s), (peer, theirs, None, theirs_s), ("drex, both", ours, both, None), (f"{peer}, both", theirs, both, None)]
    found = [row(np, label, maps, exact, within, seconds) for label, maps, within, seconds in rows]
    ratios = f"{found[0] / found[1]:.2f} in the median error ({found[2] / found[3]:.2f} where both have a depth)"
    print(f"  drex / {peer}: ratio {ratios}, {ours_s / theirs_s:.3f} in core-seconds", flush=True)


def used():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def row(np, label, maps, exact, within, seconds):
    errors, covered, of = [], 0, 0
    for view, depth in maps.items():
        truth = exact[view].depth
        has = (truth > 0) & (depth > 0) & (True if within is None else within[view])
        errors.append(1e3 * np.abs(depth - truth)[has])
        covered, of = covered + has.sum(), of + (truth > 0).sum()
    errors = np.concatenate(errors)
    median, most = np.quantile(errors, [0.5, 0.9])
    values = f"covers {covered / of:.3f}  error median {median:.3f}, 90 % {most:.2f} mm"
    values += f"  below 0.5 mm {(errors < 0.5).mean():.3f}, 1 mm {(errors < 1.0).mean():.3f}"
    values += f"; of all the object {(errors < 0.5).sum() / of:.3f}, {(errors < 1.0).sum() / of:.3f}"
    print(f"  {label:15} {values}" + (f"  {seconds:.1f} core-s a photo" if seconds else ""), flush=True)
    return median


def read_truth(np, folder):
    """The one lens (width, height, fx, fy, cx, cy, k1, k2, p1, p2), and camera-from-world rotation and translation of each photo."""
    lines = [line.split() for line in (folder / "cameras.txt").read_text().splitlines() if line and line[0] != "#"]
    lens = [float(v) for v in lines[0][2:]]
    views = {}
    for line in (folder / "images.txt").read_text().splitlines():
        fields = line.split()
        if len(fields) < 10 or fields[0] == "#":
            continue
        w, x, y, z = (float(v) for v in fields[1:5])
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])
        views[fields[9]] = (rotation, np.array([float(v) for v in fields[5:8]]))
    return lens, views


def box_of(np, solids):
    """Lower and upper corner of what stands on the table, with a margin."""
    lo, hi = np.full(3, np.inf), np.full(3, -np.inf)
    for part in solids["parts"]:
        reach = np.abs(np.array(part["world_from_part"])) @ np.array(part["half_m"])
        lo, hi = np.minimum(lo, part["centre_m"] - reach), np.maximum(hi, part["centre_m"] + reach)
    lo, hi = lo - MARGIN_M, hi + MARGIN_M
    lo[2] = solids.get("floor_m", 0.0)
    return np.array([lo, hi])


class Exact:
    """The part of a photo, as a pinhole camera sees it, that can show the box, and its exact depth: 0 beside the object."""

    def __init__(self, np, lens, view, box, solids):
        width, height, self.fx, self.fy, cx, cy = lens[:6]
        rotation, translation = view
        self.middle = box.mean(axis=0)
        corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in range(2) for j in range(2) for k in range(2)])
        seen = corners @ rotation.T + translation
        self.range = (seen[:, 2].min(), seen[:, 2].max())
        u, v = self.fx * seen[:, 0] / seen[:, 2] + cx, self.fy * seen[:, 1] / seen[:, 2] + cy
        self.left, self.top = max(int(u.min()) - MARGIN_PX, 0), max(int(v.min()) - MARGIN_PX, 0)
        self.width = min(int(u.max()) + MARGIN_PX, int(width)) - self.left
        self.height = min(int(v.max()) + MARGIN_PX, int(height)) - self.top
        # The centre of the first pixel is (0.5, 0.5).
        self.cx, self.cy = cx - self.left, cy - self.top
        y, x = np.mgrid[: self.height, : self.width] + 0.5
        rays = np.stack([(x - self.cx) / self.fx, (y - self.cy) / self.fy, np.ones(x.shape)], -1).reshape(-1, 3) @ rotation
        centre = -rotation.T @ translation
        depth = np.full(len(rays), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for part in solids["parts"]:
                depth = np.minimum(depth, cast(np, centre, rays, part))
        depth[~np.isfinite(depth)] = 0.0
        above = centre[2] + depth * rays[:, 2] > solids.get("floor_m", 0.0) + ABOVE_TABLE_M
        self.depth = np.where(above, depth, 0.0).reshape(self.height, self.width)


def cast(np, centre, rays, part):
    """How many rays long the way to a solid is; infinite where it is missed."""
    world_from_part, half = np.array(part["world_from_part"]), np.array(part["half_m"])
    q, r = (centre - part["centre_m"]) @ world_from_part / half, rays @ world_from_part / half
    if part["kind"] == "box":
        near, far = slab(np, q, r)
        return np.where((near < far) & (near > 0), near, np.inf)
    # A ball of radius 1, or a cylinder of radius 1 between z = -1 and 1.
    k = 2 if part["kind"] == "cylinder" else 3
    a, b, c = (r[:, :k] ** 2).sum(1), r[:, :k] @ q[:k], (q[:k] ** 2).sum() - 1
    root = np.sqrt(b * b - a * c)
    near, far = (-b - root) / a, (-b + root) / a
    if k == 2:
        bottom, top = slab(np, q[2:], r[:, 2:])
        near, far = np.maximum(near, bottom), np.minimum(far, top)
    return np.where((near < far) & (near > 0), near, np.inf)


def slab(np, q, r):
    """Where rays enter and leave the cube from -1 to 1."""
    first, second = (-1 - q) / r, (1 - q) / r
    return np.minimum(first, second).max(1), np.maximum(first, second).min(1)


def read_ours(np, folder, view, exact):
    """Our depth map, which has a frame of its own, in that of the exact depth."""
    for line in (folder / "cameras.txt").read_text().splitlines():
        fields = line.split()
        if fields[0] == view:
            break
    else:
        sys.exit(f"no depth map of {view}")
    fx, _, cx, cy = (float(v) for v in fields[1:5])
    left, top = exact.cx - cx, exact.cy - cy
    # The lenses are the same and frames begin at whole pixels: then pixels are too.
    if abs(fx - exact.fx) > 1e-6 or max(abs(left - round(left)), abs(top - round(top))) > 1e-3:
        sys.exit(f"{view}: our map's camera is not that of the photo")
    left, top = round(left), round(top)
    depth = np.load(folder / f"{view}.npy")
    out = np.zeros((exact.height, exact.width))
    x0, x1 = max(left, 0), min(left + depth.shape[1], exact.width)
    y0, y1 = max(top, 0), min(top + depth.shape[0], exact.height)
    out[y0:y1, x0:x1] = depth[y0 - top : y1 - top, x0 - left : x1 - left]
    return out


def estimate(np, arguments, folder, lens, views, exact):
    """The peer's depth maps and its core-seconds."""
    import ppg_core

    photos = {}

    def photo(view):
        if view not in photos:
            photos[view] = straightened(np, folder / "images" / view, lens)
        return photos[view]

    maps, seconds = {}, 0.0
    _, _, fx, fy, cx, cy = lens[:6]
    for view, truth in exact.items():
        rotation, translation = views[view]
        sources = []
        for other in nearest(np, view, views, truth.middle)[: arguments.sources]:
            turn = views[other][0] @ rotation.T
            sources.append((photo(other), (fx, fy, cx - 0.5, cy - 0.5), turn, views[other][1] - turn @ translation))
        cut = photo(view)[truth.top : truth.top + truth.height, truth.left : truth.left + truth.width]
        # Its pixel centres are whole numbers.
        own = (fx, fy, truth.cx - 0.5, truth.cy - 0.5)
        before = time.process_time()
        maps[view] = ppg_core.patchmatch_depth(np.ascontiguousarray(cut), own, sources, truth.range)[0]
        seconds += time.process_time() - before
    return maps, seconds


def nearest(np, view, views, middle):
    """The other photos, by their angle at the object."""
    centres = {name: -rotation.T @ translation for name, (rotation, translation) in views.items()}
    toward = {name: (centre - middle) / np.linalg.norm(centre - middle) for name, centre in centres.items()}
    angle = {name: np.degrees(np.arccos(np.clip(to @ toward[view], -1, 1))) for name, to in toward.items()}
    return sorted((name for name in views if angle[name] >= LEAST_ANGLE_DEG), key=angle.get)


def straightened(np, path, lens):
    """A photo in grey from 0 to 1 as a pinhole camera with the same focal lengths and principal point sees it."""
    from PIL import Image
    from scipy.ndimage import map_coordinates

    width, height, fx, fy, cx, cy, k1, k2, p1, p2 = lens
    y, x = np.mgrid[: int(height), : int(width)] + 0.5
    x, y = (x - cx) / fx, (y - cy) / fy
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    bent = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    grey = np.asarray(Image.open(path).convert("L"), np.float32) / 255
    at = [bent[1] * fy + cy - 0.5, bent[0] * fx + cx - 0.5]
    return np.clip(map_coordinates(grey, at, order=3, mode="nearest"), 0, 1).astype(np.float32)


if __name__ == "__main__":
    main()
