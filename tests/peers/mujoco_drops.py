"""Compares the probabilities of an asset's stable poses with drops in MuJoCo.

    pip install mujoco
    python tests/peers/mujoco_drops.py [--drops 300] DIR ...

DIR is what `drex asset` wrote. The object is let go in uniformly random orientations: first quasi-statically, touching the
table and with its speed damped away at every step, as the model behind the probabilities assumes; then from 20 mm above the table
with all its momentum. Per asset: the share of drops that end in a listed pose (within 6 degrees), and the total variation
distance, half of the sum of |listed - dropped| over the poses, for both kinds of drop. Among n drops into k even poses chance alone
gives about 0.4 sqrt(k / n).
"""

import argparse
import json
import pathlib

import mujoco
import numpy as np


def drop(model, data, rng, height, damping):
    """One drop; returns the direction of down in the frame of the mesh where the object ends."""
    q = rng.normal(size=4)
    data.qpos[:] = [0, 0, 0, *(q / np.linalg.norm(q))]
    data.qvel[:] = 0
    data.time = 0
    mujoco.mj_kinematics(model, data)
    lowest = np.inf
    for g in range(model.ngeom):
        if model.geom_contype[g] and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH:
            m = model.geom_dataid[g]
            start, count = model.mesh_vertadr[m], model.mesh_vertnum[m]
            z = model.mesh_vert[start:start + count] @ data.geom_xmat[g].reshape(3, 3)[2] + data.geom_xpos[g][2]
            lowest = min(lowest, z.min())
    data.qpos[2] = height - lowest
    still = 0
    while data.time < 8 and still < 100:
        mujoco.mj_step(model, data)
        data.qvel[:] *= damping
        still = still + 1 if np.linalg.norm(data.qvel[3:]) < 1e-3 and np.linalg.norm(data.qvel[:3]) < 1e-3 else 0
    return -data.xmat[model.body("object").id].reshape(3, 3)[2]


def shares(model, poses, drops, height, damping):
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    count = np.zeros(len(poses) + 1)
    normals = np.array([p["support_normal_in_mesh"] for p in poses])
    for _ in range(drops):
        cosine = normals @ drop(model, data, rng, height, damping)
        best = int(np.argmax(cosine))
        count[best if cosine[best] > np.cos(np.radians(6)) else -1] += 1
    return count / drops


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--drops", type=int, default=300)
    parser.add_argument("folder", nargs="+", type=pathlib.Path)
    args = parser.parse_args()
    for folder in args.folder:
        poses = json.loads((folder / "mesh/report.json").read_text())["stable_poses"]
        model = mujoco.MjModel.from_xml_path(str(folder / "asset/object.xml"))
        model.geom_friction[:, 0] = 1.0
        listed = np.array([p["probability"] for p in poses] + [0.0])
        text = []
        for name, height, damping in [("quasi-static", 0.0, 0.9), ("from 20 mm", 0.02, 1.0)]:
            found = shares(model, poses, args.drops, height, damping)
            text.append(f"{name}: {100 * (1 - found[-1]):.0f} % in a listed pose, distance "
                        f"{0.5 * np.abs(found - listed).sum():.3f}")
        print(f"{folder.name} ({len(poses)} poses): " + "; ".join(text), flush=True)


main()
