"""Writes odd.json from odd.xml: poses, Jacobians, mass matrix and bias force by MuJoCo (4.0.0 when last run).

    pip install mujoco numpy && python make_golden.py
"""

import json
import pathlib

import mujoco
import numpy as np

folder = pathlib.Path(__file__).parent
model = mujoco.MjModel.from_xml_path(str(folder / "odd.xml"))
data = mujoco.MjData(model)
rng = np.random.default_rng(7)
joints = [model.joint(j).name for j in range(model.njnt)]
last = model.nbody - 1
cases = []
for _ in range(3):
    data.qpos[:] = rng.uniform(-1, 1, model.nq)
    data.qvel[:] = rng.uniform(-2, 2, model.nv)
    mujoco.mj_forward(model, data)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, linear, angular, last)
    cases.append({
        "q_rad": dict(zip(joints, data.qpos.tolist())),
        "qvel": dict(zip(joints, data.qvel.tolist())),
        "bodies": {
            model.body(b).name: {"pos_m": data.xpos[b].tolist(), "quat_wxyz": data.xquat[b].tolist()}
            for b in range(1, model.nbody)
        },
        "jacobian_body": model.body(last).name,
        "jac_pos_rows": linear.tolist(),
        "jac_rot_rows": angular.tolist(),
        "mass_matrix": mass_matrix.tolist(),
        "bias_force": data.qfrc_bias.tolist(),
        "dof_joint": joints,
    })
golden = {"model": "odd.xml", "engine": f"MuJoCo {mujoco.__version__}", "gravity": model.opt.gravity.tolist(), "cases": cases}
(folder / "odd.json").write_text(json.dumps(golden))
