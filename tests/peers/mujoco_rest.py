"""Loads assets that `drex asset` wrote into MuJoCo and lets them rest for two seconds in each stable pose.

    pip install mujoco
    python tests/peers/mujoco_rest.py [--strict] DIR/asset/object.xml ...

One line per asset and stable pose (the keyframes `rest_0`, `rest_1`... of the model), and one for the pose in the model itself
(`start`): how far the object moves (mm) and turns (degrees) while it settles, in the first half second, and after that (the
drift); the deepest penetration ever and after settling (mm). An object that passes settles by less than 5 mm and
5 degrees, drifts less than 1 mm and 1 degree and never sinks in deeper than 1 mm. Exits with 1 if a model does not load, with --strict also
if an object does not pass in one of its stable poses (the model's own pose may be one it falls from).
"""

import sys

import mujoco
import numpy as np

SECONDS, SETTLED = 2.0, 0.5


def free_joint(model):
    """Where the pose of the object lies in qpos: that of the joint `object`, else of the first free joint."""
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    named = [j for j in free if model.joint(j).name == "object"]
    at = model.jnt_qposadr[(named + free)[0]]
    return slice(at, at + 7)


def change(a, b):
    """Distance in mm and angle in degrees between two poses of a free joint."""
    turn = 2 * np.arccos(min(1.0, abs(a[3:7] @ b[3:7])))
    return 1e3 * np.linalg.norm(a[:3] - b[:3]), np.degrees(turn)


def rest(model, key):
    """Simulates from keyframe `key` (the model's own pose if None)."""
    data = mujoco.MjData(model)
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_forward(model, data)
    pose = free_joint(model)
    start = data.qpos[pose].copy()
    settled = None
    deepest = deepest_after = 0.0
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
        depth = -1e3 * data.contact.dist.min() if data.ncon else 0.0
        deepest = max(deepest, depth)
        if data.time >= SETTLED:
            settled = data.qpos[pose].copy() if settled is None else settled
            deepest_after = max(deepest_after, depth)
    return {"settling": change(start, settled), "drift": change(settled, data.qpos[pose]), "deepest": deepest,
            "deepest_after": deepest_after}


def main():
    strict = "--strict" in sys.argv
    failed = 0
    for path in [a for a in sys.argv[1:] if a != "--strict"]:
        try:
            model = mujoco.MjModel.from_xml_path(path)
        except ValueError as error:
            print(f"{path}: does not load: {error}")
            failed = 1
            continue
        for key in [None, *range(model.nkey)]:
            r = rest(model, key)
            # An object that falls and then lies still does not rest in the pose that was asked for.
            stays = r["settling"][0] < 5 and r["settling"][1] < 5
            passed = stays and r["drift"][0] < 1 and r["drift"][1] < 1 and r["deepest"] < 1
            name = "start" if key is None else model.key(key).name
            print(f"{path} {name}: {1e3 * model.body_mass.sum():.1f} g, "
                  f"settles {r['settling'][0]:.3f} mm {r['settling'][1]:.3f} deg, "
                  f"drifts {r['drift'][0]:.4f} mm {r['drift'][1]:.4f} deg, penetration {r['deepest']:.3f} mm, "
                  f"after settling {r['deepest_after']:.3f} mm, "
                  f"{'rests' if passed else 'DOES NOT REST'}")
            failed |= int(strict and key is not None and not passed)
    sys.exit(failed)


main()
