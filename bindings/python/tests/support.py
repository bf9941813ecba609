"""What the tests share: where the data is, and simple solids."""

import json
import os
import pathlib
import shutil
import tempfile
import threading
import time
import unittest

import numpy as np

DATA = pathlib.Path(os.environ.get("DREX_DATA") or pathlib.Path(__file__).resolve().parents[3] / "data").resolve()
TIN_PUSH = DATA / "tin" / "push" / "tilt"
TIN_MESH = DATA / "tin" / "scan" / "tin.obj"
CLIP = DATA / "demo" / "demos" / "clip_0.json"


#: The command line, where it is there to compare with.
PROGRAM = os.environ.get("DREX_PROGRAM")


class Case(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)


def small_twin(folder, epochs=5, demonstrations=6):
    """A copy of the tin's twin, whose network learns for a few epochs from a few grasps."""
    shutil.copytree(DATA / "tin", folder)
    grasps = folder / "demos" / "grasps.json"
    record = json.loads(grasps.read_text())
    record["grasps"] = record["grasps"][:demonstrations]
    grasps.write_text(json.dumps(record))
    with open(folder / "twin.toml", "a") as manifest:
        manifest.write(f"\n[train]\nepochs = {epochs}\n")
    return folder


def twins(folder, count, broken=(), epochs=5):
    """A folder of so many twins of different masses and seeds, weighed on a scale, so that a stage takes a moment; some have no friction."""
    for number in range(count):
        manifest = small_twin(folder / f"row{number % 2}" / f"tin-{number}", epochs, demonstrations=2) / "twin.toml"
        text = manifest.read_text().replace('identify = ["push/tilt"]\nprior_kg = 0.5', f"weighed_kg = 0.2{number:02}")
        text = text.replace("seed = 1", f"seed = {number}")
        manifest.write_text(text.replace("friction = 0.5", "friction = -1") if number in broken else text)
    return folder


def files(folder):
    """The bytes of the files below a folder that are the same in each run."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name not in {"timings.json", "runs.csv", "journal.jsonl"}]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def runs_beside(case, call):
    """Asserts that another thread runs on while `call` does."""
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.002)

    thread = threading.Thread(target=tick)
    thread.start()
    begin = time.monotonic()
    call()
    end = time.monotonic()
    done.set()
    thread.join()
    during = [t for t in ticks if begin < t < end]
    case.assertGreater(len(during), min(5, (end - begin) / 0.2))


def box(x, y, z):
    """Vertices (8, 3) and faces (12, 3) of a box about the origin with these sides."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
    quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
    faces = [t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])]
    return corners * [x, y, z], np.array(faces)


def rotation(pose):
    """Matrix of a row x, y, z, qw, qx, qy, qz."""
    w, x, y, z = pose[3:]
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])
