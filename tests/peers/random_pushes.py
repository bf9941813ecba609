"""Pushes of random objects by MuJoCo, in the layout of the published set of simulated pushes.

    drex-bench objects --seed N --count K [--mass solid|hollow|off-centre] --out OBJECTS
    python tests/peers/random_pushes.py PUSH_MUJOCO OBJECTS --seed N --out DIR [--jobs J]

PUSH_MUJOCO holds the set's own generate.py, which draws forces, fingers and noise; OBJECTS is a folder as drex-bench writes it. Pushes of
an object depend on the seed and on the number in its name. MuJoCo moves the mass, centre of mass and inertia of object.json, or the
object is refused. A kind of push that cannot move an object sanely is left out, and that is printed.

An object that is not uniform has a parameters.toml beside its mesh: the [parameters] of a push.toml that state its centre of mass and
inertia, both against those of the uniform solid that the mesh bounds. Products of inertia are no parameters: the largest one that is
left unsaid stands there as a comment. Nothing that a push of a uniform object is imported from tells where its centre is.

Needs mujoco and numpy; five to twenty-five seconds an object on one core.
"""

import argparse
import csv
import importlib.util
import json
import shutil
import tempfile
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import mujoco
import numpy as np

SCENARIOS = ("lift_force", "slide_force", "tilt_force", "overhang_press", "finger_fast", "finger_tilt")
# Highest push as a share of the height: below the shoulder of a bottle.
HIGHEST = {"bottle": 0.6}
LIE_ON = 1
TABLES = ("summary.csv", "sensitivity.csv")
# Largest difference between what is stated and what MuJoCo compiled, relative to size and inertia.
TOLERANCE = 1e-6


def load(folder):
    spec = importlib.util.spec_from_file_location("generate", folder / "generate.py")
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    generate.SCENARIOS = SCENARIOS
    return generate


def geom(solid):
    """A solid of object.json as the generator takes it."""
    pose = solid["object_from_shape"]
    if pose["quat_wxyz"] != [1, 0, 0, 0]:
        raise SystemExit(f"a solid is turned by {pose['quat_wxyz']}; the generator stands all of them upright")
    shape = solid["shape"]
    if shape not in ("box", "cylinder"):
        raise SystemExit(f"a solid is a {shape}; the generator knows boxes and cylinders")
    size = solid["half_m"] if shape == "box" else [solid["radius_m"], solid["half_length_m"]]
    return dict(t=shape, s=tuple(size), p=tuple(pose["translation_m"]), rx=0.0)


def state(generate, thing):
    """Lets MuJoCo and the generator take centre and inertia as they are stated, not from the solids."""
    center, inertia = np.array(thing["center_of_mass_m"]), np.array(thing["inertia_kg_m2"])
    geoms_xml, obj = generate.geoms_xml, generate.Obj

    def with_inertial(geoms, mass):
        i = inertia * (mass / thing["mass_kg"])
        tensor = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        numbers = [" ".join("%.17g" % x for x in v) for v in (center, tensor)]
        inertial = '<inertial pos="%s" mass="%.17g" fullinertia="%s"/>' % (numbers[0], mass, numbers[1])
        return inertial + "\n      " + geoms_xml(geoms, mass)

    class Stated(obj):
        def __init__(self, *entry):
            super().__init__(*entry)
            self.com = center

    generate.geoms_xml, generate.Obj = with_inertial, Stated


def skip_what_does_not_move(generate):
    """Lets the other kinds of push go on where one finds no sane draw."""
    build = generate.build

    def build_or_skip(*arguments):
        try:
            return build(*arguments)
        except SystemExit as refusal:
            print(f"left out: {refusal}", flush=True)
            return None

    generate.build = build_or_skip


def check(generate, thing, geoms):
    """Refuses an object whose mass, centre or inertia MuJoCo compiles to something else."""
    xml = generate.scene_xml(thing["name"], geoms, thing["mass_kg"], thing["friction"], (0, 0, 1), generate.STAND)
    model = mujoco.MjModel.from_xml_string(xml)
    body = model.body("object").id
    axes = generate.quat_rot(model.body_iquat[body])
    inertia = np.array(thing["inertia_kg_m2"])
    size = 2 * max(np.abs(g["p"]).max() + max(g["s"]) for g in geoms)
    off = dict(
        mass=abs(model.body_mass[body] / thing["mass_kg"] - 1),
        centre=np.linalg.norm(model.body_ipos[body] - thing["center_of_mass_m"]) / size,
        inertia=np.linalg.norm(axes * model.body_inertia[body] @ axes.T - inertia) / np.linalg.norm(inertia),
    )
    for what, error in off.items():
        if not error < TOLERANCE:
            raise SystemExit(f"{thing['name']}: MuJoCo's {what} is off by {error:.1e} of what object.json states")
    return off


def uniform(vertices, faces):
    """Centre and inertia per mass about it of the uniform solid that a closed mesh bounds."""
    a, b, c = (vertices[[f[i] for f in faces]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    s = a + b + c
    center = (volume / 4) @ s / volume.sum()
    second = sum(np.einsum("i,ij,ik->jk", volume / 20, v, v) for v in (s, a, b, c)) / volume.sum()
    second -= np.outer(center, center)
    return center, np.trace(second) * np.eye(3) - second


def parameters(generate, thing, geoms):
    """The text of parameters.toml."""
    # As write_set makes the mesh that is weighed.
    center, unit = uniform(*generate.mesh_of(geoms, 0.005))
    stated = np.array(thing["inertia_kg_m2"]) / thing["mass_kg"]
    root = np.sqrt(np.diag(stated) / np.diag(unit))
    unsaid = np.abs(stated - unit * np.outer(root, root)) / np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    lines = [
        "# Centre of mass (m) and inertia per mass (factors) against those of the uniform solid that object.obj bounds.",
        f"# Products of inertia are off by up to {unsaid.max():.2g} of the root of the product of their moments.",
        "[parameters]",
    ]
    offset = np.array(thing["center_of_mass_m"]) - center
    lines += [f"center_{axis} = {x:.9f}" for axis, x in zip("xyz", offset.round(9) + 0.0)]
    lines += [f"inertia_{axis} = {x * x:.6f}" for axis, x in zip("xyz", root)]
    return "\n".join(lines) + "\n"


def push(push_mujoco, seed, out, folder):
    """Simulates all pushes of one object; the rows of its tables."""
    try:
        thing = json.loads((folder / "object.json").read_text())
        name, solids, distribution = thing["name"], thing["solids"], thing["mass_distribution"]["class"]
    except (ValueError, KeyError, TypeError) as error:
        raise SystemExit(f"{folder / 'object.json'} is not as drex-bench objects writes it: {error!r}")
    generate = load(push_mujoco)
    geoms = [geom(s) for s in solids]
    is_uniform = distribution == "solid"
    if not is_uniform:
        state(generate, thing)
    check(generate, thing, geoms)
    skip_what_does_not_move(generate)
    entry = (
        name, geoms, thing["mass_kg"], thing["first_guess_kg"], thing["friction"], LIE_ON, HIGHEST.get(thing["kind"], 0.95),
    )
    number = int(name.removeprefix(thing["kind"]))
    # Beside its place, so that objects made side by side do not write one table, and half an object is none.
    with tempfile.TemporaryDirectory(dir=out, prefix=f".{name}.") as work:
        generate.write_set([entry], 1000 * seed + number, work)
        made = Path(work) / name
        if not is_uniform:
            (made / "parameters.toml").write_text(parameters(generate, thing, geoms))
        shutil.rmtree(out / name, ignore_errors=True)
        made.rename(out / name)
        return [list(csv.reader((Path(work) / table).open(newline=""))) for table in TABLES]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("push_mujoco", type=Path)
    parser.add_argument("objects", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    folders = sorted(f.parent for f in arguments.objects.glob("*/object.json"))
    if not folders:
        raise SystemExit(f"{arguments.objects} has no NAME/object.json; make some with drex-bench objects")
    if not (arguments.push_mujoco / "generate.py").is_file():
        raise SystemExit(f"{arguments.push_mujoco} has no generate.py: name the folder of the published set of simulated pushes")
    arguments.out.mkdir(parents=True, exist_ok=True)
    work = partial(push, arguments.push_mujoco, arguments.seed, arguments.out)
    if arguments.jobs > 1:
        with get_context("spawn").Pool(arguments.jobs) as pool:
            rows = pool.map(work, folders, chunksize=1)
    else:
        rows = list(map(work, folders))
    for table, parts in zip(TABLES, zip(*rows)):
        with (arguments.out / table).open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(parts[0][:1] + [row for part in parts for row in part[1:]])


if __name__ == "__main__":
    main()
