"""Writes what HaMeR would have written of a bundled clip: python3 make_hamer.py CLIP.json OUT.npz OUT_POSES.csv

CLIP.json is drex-hand-demo/1 with poses of the object. OUT.npz holds HaMeR's arrays, one row a frame: pred_keypoints_3d (n x 21 x 3,
m, about the hand's own origin), pred_cam_t_full (n x 3, m, hand to camera), right, frame and fps. OUT_POSES.csv holds the object in
the same camera. Only for the tutorial: with HaMeR you have such a file.
"""

import json
import struct
import sys
import zipfile


def npy(shape, numbers):
    """An array of float32 in NumPy's format, version 1."""
    head = repr({"descr": "<f4", "fortran_order": False, "shape": tuple(shape)})
    head += " " * (-(len(head) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + struct.pack(f"<{len(numbers)}f", *numbers)


def quaternion(r):
    """w, x, y, z of a rotation matrix, by its largest entry."""
    t = r[0][0] + r[1][1] + r[2][2]
    four = [1 + t, 1 + 2 * r[0][0] - t, 1 + 2 * r[1][1] - t, 1 + 2 * r[2][2] - t]
    k = four.index(max(four))
    s = 2 * max(four) ** 0.5
    d = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    if k == 0:
        return [s / 4] + [v / s for v in d]
    a = k - 1
    return [d[a] / s] + [s / 4 if b == a else (r[a][b] + r[b][a]) / s for b in range(3)]


def main():
    clip = json.load(open(sys.argv[1], encoding="utf-8"))
    frames = clip["frames"]
    points, shifts = [], []
    for frame in frames:
        hand = frame["keypoints"]
        # HaMeR's points are about the hand; where that is in the camera is a vector of its own.
        root = hand[0]
        shifts += root
        points += [p[i] - root[i] for p in hand for i in range(3)]
    n = len(frames)
    fps = (n - 1) / (frames[-1]["t"] - frames[0]["t"])
    arrays = {
        "pred_keypoints_3d": npy((n, 21, 3), points),
        "pred_cam_t_full": npy((n, 3), shifts),
        "right": npy((n,), [1.0] * n),
        "frame": npy((n,), list(range(n))),
        "fps": npy((), [fps]),
    }
    with zipfile.ZipFile(sys.argv[2], "w") as out:
        for name, data in arrays.items():
            out.writestr(f"{name}.npy", data)
    with open(sys.argv[3], "w", encoding="utf-8") as out:
        out.write("t,x,y,z,qw,qx,qy,qz\n")
        for frame in frames:
            rows = frame["object_pose_3x4"]
            numbers = [frame["t"]] + [row[3] for row in rows] + quaternion(rows)
            out.write(",".join(f"{v:.6f}" for v in numbers) + "\n")


main()
