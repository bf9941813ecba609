"""Draws an asset in MuJoCo, standing on its table.

    MUJOCO_GL=egl python tests/peers/mujoco_picture.py DIR/asset/object.xml object.png [--azimuth 135] [--elevation -20]

Needs mujoco and pillow, and OpenGL as MUJOCO_GL names it.
"""

import argparse

import mujoco
from PIL import Image


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("out")
    parser.add_argument("--azimuth", type=float, default=135.0)
    parser.add_argument("--elevation", type=float, default=-20.0)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480))
    arguments = parser.parse_args()
    width, height = arguments.size

    model = mujoco.MjModel.from_xml_path(arguments.model)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.headlight.ambient[:] = 0.5
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    visual = model.geom("visual")
    camera = mujoco.MjvCamera()
    camera.lookat[:] = data.geom("visual").xpos
    camera.distance = 2.2 * model.geom_rbound[visual.id]
    camera.azimuth, camera.elevation = arguments.azimuth, arguments.elevation
    options = mujoco.MjvOption()
    options.geomgroup[:] = [1, 1, 1, 0, 0, 0]
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera, options)
        Image.fromarray(renderer.render()).save(arguments.out)


if __name__ == "__main__":
    main()
