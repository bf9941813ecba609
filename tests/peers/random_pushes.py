"""Pushes of random objects by MuJoCo, in the layout of the published set of simulated pushes.

    python tests/peers/random_pushes.py PUSH_MUJOCO --seed N --objects COUNT --out DIR

PUSH_MUJOCO holds the set's own generate.py, which draws forces, fingers and noise; the objects are drawn here: boxes, cylinders, letters
L, T and U, bottles, solid, of 20 g to 1.5 kg. An object that a kind of push cannot move sanely is left without it, and that is
printed. Needs mujoco and numpy; about 40 seconds an object on one core.
"""

import argparse
import importlib.util
import math
from pathlib import Path

import numpy as np

SCENARIOS = ("lift_force", "slide_force", "tilt_force", "overhang_press", "finger_fast", "finger_tilt")
KINDS = ("box", "cyl", "L", "T", "U", "bottle")
DENSITIES_KG_M3 = (120.0, 3000.0)
MASSES_KG = (0.02, 1.5)


def solids(generate, kind, draw):
    """Primitives of one object, metres, standing on its base, and the highest push as a share of its height."""
    box, cyl = generate.box, generate.cyl
    if kind == "box":
        return [box(draw(0.025, 0.06), draw(0.04, 0.11), draw(0.05, 0.14))], 0.95
    if kind == "cyl":
        return [cyl(draw(0.018, 0.042), draw(0.06, 0.14))], 0.95
    if kind == "bottle":
        radius, body, neck_radius = draw(0.022, 0.04), draw(0.07, 0.12), draw(0.012, 0.018)
        neck, cap = draw(0.02, 0.035), draw(0.012, 0.025)
        low = -0.5 * (body + neck + cap)
        return [
            cyl(radius, body, z=low + 0.5 * body),
            cyl(neck_radius, neck, z=low + body + 0.5 * neck),
            cyl(0.6 * neck_radius, cap, z=low + body + neck + 0.5 * cap),
        ], 0.6
    thick, bar = draw(0.022, 0.045), draw(0.016, 0.028)
    wide, high = draw(0.055, 0.1), draw(0.065, 0.11)
    side = 0.5 * (wide - bar)
    stem = high - bar
    if kind == "T":
        return [box(thick, wide, bar, z=0.5 * stem), box(thick, bar, stem, z=-0.5 * bar)], 0.95
    foot = box(thick, wide, bar, z=-0.5 * stem)
    stems = [-side] if kind == "L" else [-side, side]
    return [foot] + [box(thick, bar, stem, y=y, z=0.5 * bar) for y in stems], 0.95


def volume(solid):
    if solid["t"] == "box":
        return 8.0 * float(np.prod(solid["s"]))
    return math.pi * solid["s"][0] ** 2 * 2.0 * solid["s"][1]


def random_object(generate, seed, number):
    """An entry of the generator's list: name, solids, mass, first guess, friction, side to lie on, highest push."""
    random = np.random.default_rng([seed, number])
    draw = random.uniform
    kind = KINDS[random.integers(len(KINDS))]
    parts, highest = solids(generate, kind, draw)
    density = math.exp(draw(*map(math.log, DENSITIES_KG_M3)))
    mass = float(np.clip(density * sum(map(volume, parts)), *MASSES_KG))
    guess = mass * math.exp(draw(-1.0, 1.0))
    return f"{kind}{number:03d}", parts, mass, guess, round(draw(0.25, 0.6), 3), 1, highest


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("push_mujoco", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--objects", type=int, default=45)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    spec = importlib.util.spec_from_file_location("generate", arguments.push_mujoco / "generate.py")
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    generate.SCENARIOS = SCENARIOS
    for number in range(arguments.objects):
        entry = random_object(generate, arguments.seed, number)
        try:
            generate.write_set([entry], 1000 * arguments.seed + number, str(arguments.out))
        except SystemExit as refusal:
            print(f"{entry[0]}: the rest is left out: {refusal}")


if __name__ == "__main__":
    main()
