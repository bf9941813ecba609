"""Says where MuJoCo puts the bodies of a model when its joints are moved.

    pip install mujoco
    python tests/peers/mujoco_kinematics.py MODEL.xml [JOINT=VALUE ...]

One line per body: name, position x y z (m), quaternion w x y z. Free joints stay as the model has them.
"""

import sys

import mujoco

model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
for setting in sys.argv[2:]:
    joint, value = setting.split("=")
    data.qpos[model.joint(joint).qposadr[0]] = float(value)
mujoco.mj_kinematics(model, data)
for i in range(1, model.nbody):
    print(model.body(i).name, *data.xpos[i], *data.xquat[i])
