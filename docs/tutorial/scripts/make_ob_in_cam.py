"""Writes what FoundationPose would have written of a bundled push: python3 make_ob_in_cam.py POSES.csv OUT_DIR

POSES.csv is t,x,y,z,qw,qx,qy,qz, the object's mesh in the world (m); OUT_DIR gets NNNNN.txt, 4 x 4, object to camera, one file a
frame. Only for the tutorial: with a tracker of your own you have such a folder.
"""

import csv
import sys
from pathlib import Path

# A camera 0.7 m from the object, looking down at it; its axes: x right, y down, z forward. World to camera, metres.
CAMERA_FROM_WORLD = [
    [0.0, 1.0, 0.0, 0.0],
    [0.5, 0.0, -0.8660254037844386, 0.1],
    [-0.8660254037844386, 0.0, -0.5, 0.7],
    [0.0, 0.0, 0.0, 1.0],
]


def matrix(x, y, z, qw, qx, qy, qz):
    return [
        [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw), x],
        [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw), y],
        [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy), z],
        [0.0, 0.0, 0.0, 1.0],
    ]


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def main():
    out = Path(sys.argv[2])
    out.mkdir(parents=True)
    with open(sys.argv[1], newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.DictReader(file)):
            pose = matrix(*(float(row[name]) for name in ("x", "y", "z", "qw", "qx", "qy", "qz")))
            lines = [" ".join(f"{v:.7f}" for v in line) for line in product(CAMERA_FROM_WORLD, pose)]
            (out / f"{number:05d}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


main()
