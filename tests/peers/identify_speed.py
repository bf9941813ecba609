"""Time of one identification next to a finite-difference Gauss-Newton over MuJoCo, on the same push, on one core.

    pip install mujoco numpy
    DREX_SHARED=... python tests/peers/identify_speed.py [--data DIR] [PUSH ...]

Pushes are folders OBJECT/SCENARIO of simulated pushes (scene.xml, meta.json, csv files). The peer simulates the folder's own
scene, in the very simulator that made the data, from the wrong mass that the scene holds: what it lacks is not the model. It
fits the logarithm of the mass to the noisy poses (geodesic residuals over 2 mm and 1 degree) and, where there is a fingertip, to its
encoder (0.1 mm), by Levenberg-Marquardt with central differences and steps of at most 1: once from that mass, where it stalls if the
object does not move with it, and once from the best of as many masses as ours scans. Ours does all that `drex identify` does: scan,
fit of clock, bias and errors of the force, interval, contact variants. The true mass is read here alone.
"""

import argparse
import csv
import json
import os
import pathlib
import subprocess
import time

import mujoco
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
PUSHES = ["brick/lift_force", "brick/tilt_force", "letter_t/slide_force", "brick/finger_tilt", "letter_t/finger_fast"]
POSITION_M, ROTATION, ENCODER_M = 2e-3, np.radians(1.0), 1e-4
# A known force turns with the object; the simulator is told every so many steps.
STEPS_PER_FORCE = 4
SPAN, ITERATIONS, SMALL = 0.01, 25, 1e-3
SCAN_KG, SCAN_POINTS = (0.005, 5.0), 28


def table(path):
    with open(path, newline="") as f:
        return np.array([[float(x) for x in row] for row in list(csv.reader(f))[1:]])


class Peer:
    """A push in MuJoCo whose object has any mass."""

    def __init__(self, folder):
        self.meta = json.loads((folder / "meta.json").read_text())
        self.model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
        self.data = mujoco.MjData(self.model)
        self.body = self.model.body("object").id
        self.mass, self.inertia = self.model.body_mass[self.body], self.model.body_inertia[self.body].copy()
        self.track = table(folder / "pose_noisy.csv")
        self.finger = self.meta.get("finger")
        drive = table(folder / ("action.csv" if self.finger else "force_noisy.csv"))
        self.drive_times, self.drive = drive[:, 0], drive[:, 1:4]
        self.encoder = table(folder / "proprio.csv") if self.finger else np.zeros((0, 4))
        dt = self.model.opt.timestep
        self.frames = np.round(self.track[:, 0] / dt).astype(int)
        self.readings = np.round(self.encoder[:, 0] / dt).astype(int)
        ticks = np.round(self.drive_times / dt).astype(int)
        last = max(self.frames.max(), self.readings.max(initial=0))
        more = [] if self.finger else range(0, last, STEPS_PER_FORCE)
        self.events = sorted({*self.frames, *self.readings, *ticks[ticks <= last], *more, 0})
        self.rollouts = 0

    def set_mass(self, kg):
        self.model.body_mass[self.body] = kg
        self.model.body_inertia[self.body] = self.inertia * kg / self.mass
        mujoco.mj_setConst(self.model, self.data)

    def run(self, kg):
        """Poses at the frames and tip positions at the readings."""
        self.set_mass(kg)
        self.rollouts += 1
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        poses, tips = {}, {}
        at = 0
        frames, readings = set(self.frames), set(self.readings)
        for k, step in enumerate(self.events):
            if step > at:
                mujoco.mj_step(model, data, nstep=step - at)
                at = step
            if step in frames:
                poses[step] = data.qpos[:7].copy()
            if step in readings:
                tips[step] = data.qpos[7:10] + self.finger["home"]
            if k + 1 < len(self.events):
                self.push(step * model.opt.timestep)
        return np.array([poses[f] for f in self.frames]), np.array([tips[r] for r in self.readings]).reshape(-1, 3)

    def push(self, t):
        u = self.drive[max(np.searchsorted(self.drive_times, t + 1e-9, side="right") - 1, 0)]
        if self.finger:
            self.data.ctrl[:] = u - self.finger["home"]
            return
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.data.qpos[3:7])
        arm = rotation.reshape(3, 3) @ (self.meta["force_point_body"] - self.model.body_ipos[self.body])
        self.data.xfrc_applied[self.body] = [*u, *np.cross(arm, u)]

    def residuals(self, log_mass):
        poses, tips = self.run(np.exp(log_mass))
        out = [(self.track[:, 1:4] - poses[:, :3]).ravel() / POSITION_M]
        out += [turn(a, b) / ROTATION for a, b in zip(poses[:, 3:], self.track[:, 4:])]
        return np.concatenate([*out, (self.encoder[:, 1:4] - tips).ravel() / ENCODER_M])

    def fit(self, scan):
        """Logarithm of the mass, its standard deviation, iterations."""
        grid = np.linspace(*np.log(SCAN_KG), SCAN_POINTS) if scan else [np.log(self.mass)]
        scanned = [(x, self.residuals(x)) for x in grid]
        x, r = min(scanned, key=lambda s: cauchy(s[1]))
        damping = 1e-3
        slope = None
        for iteration in range(1, ITERATIONS + 1):
            slope = (self.residuals(x + SPAN) - self.residuals(x - SPAN)) / (2 * SPAN)
            improved = False
            for _ in range(6):
                step = np.clip(-(slope @ r) / (slope @ slope * (1 + damping) + 1e-12), -1, 1)
                there = self.residuals(x + step)
                if there @ there < r @ r:
                    x, r, damping, improved = x + step, there, damping * 0.2, True
                    break
                damping = max(damping * 8, 0.05)
            if not improved or abs(step) < SMALL:
                break
        return x, 1 / np.sqrt(slope @ slope + 1e-12), iteration


def cauchy(r):
    """A cost that far off masses do not dominate by one sensor alone."""
    return np.log1p(r * r).sum()


def turn(a, b):
    """Rotation vector from quaternion a to b."""
    d, back = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(back, a)
    mujoco.mju_mulQuat(d, back, b)
    d *= 1 if d[0] >= 0 else -1
    size = np.linalg.norm(d[1:])
    return d[1:] * (2 * np.arctan2(size, d[0]) / size if size > 1e-12 else 2)


def build():
    command = ["cargo", "build", "--release", "--quiet", "-p", "drex-sysid", "--example", "identify"]
    subprocess.run(command, check=True, cwd=ROOT)
    target = os.environ.get("CARGO_TARGET_DIR", ROOT / "target")
    return str(pathlib.Path(target) / "release" / "examples" / "identify")


def ours(binary, folder):
    environment = {**os.environ, "RAYON_NUM_THREADS": "1"}
    run = subprocess.run([binary, "--mujoco", str(folder)], check=True, capture_output=True, text=True, env=environment)
    return json.loads(run.stdout)


def compare(binary, folder):
    truth = json.loads((folder / "truth.json").read_text())["mass"]
    peer = Peer(folder)
    print(f"{folder.parent.name}/{folder.name}: true mass {1e3 * truth:.1f} g, first guess {1e3 * peer.mass:.0f} g")
    answer = ours(binary, folder)
    mine, count, mass = answer["seconds"], max(answer["simulations"], 1), answer["mass_kg"]
    result = f"{answer['verdict']:47}"
    if mass is not None:
        lo, hi = (1e3 * x for x in answer["ci95_kg"])
        result = f"{1e3 * mass:7.1f} g ({100 * (mass / truth - 1):+6.1f} %), {lo:.1f} to {hi:.1f} g"
    print(f"  drex             {result:47} {mine:6.2f} s, {count:3} simulations of {1e3 * mine / count:5.1f} ms")
    for name, scan in [("from the guess", False), ("after a scan", True)]:
        peer.rollouts = 0
        begin = time.perf_counter()
        x, sd, iterations = peer.fit(scan)
        theirs = time.perf_counter() - begin
        error = np.exp(x) / truth - 1
        result = f"{1e3 * np.exp(x):7.1f} g ({100 * error:+6.1f} %), sd {100 * min(sd, 10):.2f} %"
        print(f"  {name:16} {result:47} {theirs:6.2f} s, {peer.rollouts:3} simulations of {1e3 * theirs / peer.rollouts:5.1f} ms, "
              f"{iterations} iterations: {theirs / mine:.1f} of our time, {theirs / peer.rollouts / (mine / count):.1f} per simulation")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pushes", nargs="*", default=PUSHES, metavar="PUSH", help="OBJECT/SCENARIO")
    parser.add_argument("--data", type=pathlib.Path, help="folder of objects; DREX_SHARED/data/push_mujoco if left out")
    args = parser.parse_args()
    if args.data is None and "DREX_SHARED" not in os.environ:
        parser.error("give --data or set DREX_SHARED")
    data = args.data or pathlib.Path(os.environ["DREX_SHARED"]) / "data" / "push_mujoco"
    binary = build()
    if hasattr(os, "sched_setaffinity"):
        # One core for this process and those it starts.
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(f"MuJoCo {mujoco.__version__} (Python wheel), one core")
    for push in args.pushes:
        compare(binary, data / push)


main()
