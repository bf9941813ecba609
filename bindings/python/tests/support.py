"""What the tests share: where the data is, and simple solids."""

import os
import pathlib
import tempfile
import threading
import time
import unittest

import numpy as np

DATA = pathlib.Path(os.environ.get("DREX_DATA") or pathlib.Path(__file__).resolve().parents[3] / "data").resolve()
TIN_PUSH = DATA / "tin" / "push" / "tilt"
TIN_MESH = DATA / "tin" / "scan" / "tin.obj"
CLIP = DATA / "demo" / "demos" / "clip_0.json"


class Case(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)


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
