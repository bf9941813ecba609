"""Loads assets that `drex asset` wrote into MuJoCo and lets them rest for two seconds.

    pip install mujoco
    python tests/peers/mujoco_rest.py DIR/asset/object.xml ...

Prints one line per asset: mass, largest displacement (mm), largest turn (degrees), deepest penetration after settling (mm).
Exits with 1 if one does not load.
"""

import sys

import mujoco
import numpy as np

SECONDS = 2.0


def rest(path):
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.qpos.copy()
    moved = turned = deepest = 0.0
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
        moved = max(moved, np.linalg.norm(data.qpos[:3] - start[:3]))
        turned = max(turned, 2 * np.degrees(np.arccos(min(1.0, abs(data.qpos[3:7] @ start[3:7])))))
        if data.time > 0.5 * SECONDS and data.ncon:
            deepest = max(deepest, -data.contact.dist.min())
    print(f"{path}: {1e3 * model.body_mass.sum():.1f} g, moved {1e3 * moved:.2f} mm, turned {turned:.2f} deg, "
          f"penetration {1e3 * deepest:.3f} mm")


failed = 0
for path in sys.argv[1:]:
    try:
        rest(path)
    except ValueError as error:
        print(f"{path}: does not load: {error}")
        failed = 1
sys.exit(failed)
