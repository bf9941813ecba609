"""Brings FoundationPose's poses from the camera to the world: python3 to_world.py OB_IN_CAM CAMERA.txt OUT_DIR

OB_IN_CAM holds NNNNN.txt, 4 x 4 in rows, object to camera. CAMERA.txt is the camera's pose in the world, 4 x 4 in rows, camera
(x right, y down, z forward) to world (z up, z = 0 on the table), metres: from a board on the table, or hand-eye calibration.
"""

import sys
from pathlib import Path


def read(path):
    numbers = [float(v) for v in path.read_text(encoding="utf-8").split()]
    if len(numbers) != 16:
        sys.exit(f"{path}: {len(numbers)} numbers, a pose has 16")
    return [numbers[i : i + 4] for i in (0, 4, 8, 12)]


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def main():
    folder, camera, out = Path(sys.argv[1]), read(Path(sys.argv[2])), Path(sys.argv[3])
    files = sorted(folder.glob("*.txt"))
    if not files:
        sys.exit(f"{folder}: there is no NNNNN.txt in it")
    out.mkdir(parents=True)
    for file in files:
        lines = [" ".join(f"{v:.7f}" for v in line) for line in product(camera, read(file))]
        (out / file.name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{len(files)} poses in {out}")


main()
