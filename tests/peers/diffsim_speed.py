"""Speed of drex-diffsim next to MuJoCo's: simulated seconds per second of wall time, on one core, in turn.

    pip install mujoco numpy
    python tests/peers/diffsim_speed.py [--rounds 7] [--seconds 0.5]

The cases are those of `cargo run --release -p drex-mujoco --example speed`, which also writes them as MJCF. Each engine
is tried at several settings; a setting counts if its error meets the demand of the case (DEMANDS below), and of those
that count the fastest of each engine are run against each other, one after the other, as often as --rounds says. Printed
are medians, and the ratio ours / MuJoCo's as the median and the range over the rounds.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import tempfile
import time

import mujoco
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
DT = 2e-3
# Largest distance from the true path that a setting may have, in millimetres.
DEMANDS = {"box_rest": 0.2, "box_stick": 0.2, "box_slide": 1.0, "hand_hold": 0.2}
SAMPLES, SETTLED = 50, 0.5
EULER, IMPLICITFAST = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
PYRAMIDAL, ELLIPTIC = mujoco.mjtCone.mjCONE_PYRAMIDAL, mujoco.mjtCone.mjCONE_ELLIPTIC
# Name: integrator, cone, impratio, noslip iterations, time constant of contact.
SETTINGS = {
    "Euler, pyramidal, solref 0.02 (defaults)": (EULER, PYRAMIDAL, 1, 0, 0.02),
    "Euler, pyramidal, solref 0.01": (EULER, PYRAMIDAL, 1, 0, 0.01),
    "Euler, pyramidal, solref 0.004": (EULER, PYRAMIDAL, 1, 0, 0.004),
    "Euler, elliptic, solref 0.004, impratio 10, noslip 3": (EULER, ELLIPTIC, 10, 3, 0.004),
    "implicitfast, elliptic, solref 0.02": (IMPLICITFAST, ELLIPTIC, 1, 0, 0.02),
    "implicitfast, elliptic, solref 0.01": (IMPLICITFAST, ELLIPTIC, 1, 0, 0.01),
    "implicitfast, elliptic, solref 0.004": (IMPLICITFAST, ELLIPTIC, 1, 0, 0.004),
    "implicitfast, elliptic, solref 0.004, impratio 10": (IMPLICITFAST, ELLIPTIC, 10, 0, 0.004),
    "implicitfast, elliptic, solref 0.004, impratio 100": (IMPLICITFAST, ELLIPTIC, 100, 0, 0.004),
    "implicitfast, elliptic, solref 0.004, noslip 3": (IMPLICITFAST, ELLIPTIC, 1, 3, 0.004),
    "implicitfast, elliptic, solref 0.004, impratio 10, noslip 1": (IMPLICITFAST, ELLIPTIC, 10, 1, 0.004),
    "implicitfast, elliptic, solref 0.004, impratio 10, noslip 3": (IMPLICITFAST, ELLIPTIC, 10, 3, 0.004),
    "implicitfast, elliptic, solref 0.02, impratio 10, noslip 3": (IMPLICITFAST, ELLIPTIC, 10, 3, 0.02),
}
G = 9.81


def truth(case, t):
    """Where the box is in truth; None where it only has to stay."""
    if case == "hand_hold":
        return None
    if case == "box_slide":
        angle = np.radians(25)
        return np.array([0.5 * G * (np.sin(angle) - 0.4 * np.cos(angle)) * t * t, 0, 0.03])
    return np.array([0, 0, 0.03])


class Peer:
    """A case in MuJoCo at one setting."""

    def __init__(self, name, xml, setting):
        self.name = name
        self.model = mujoco.MjModel.from_xml_string(xml)
        integrator, cone, impratio, noslip, contact_time = SETTINGS[setting]
        option = self.model.opt
        option.timestep, option.integrator, option.cone = DT, integrator, cone
        option.impratio, option.noslip_iterations = impratio, noslip
        option.tolerance, option.iterations = 1e-8, 100
        self.model.geom_solref[:] = [contact_time, 1]
        self.data = mujoco.MjData(self.model)
        self.until = 3.0 if name == "hand_hold" else 1.0

    def run(self):
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        mujoco.mj_step(self.model, self.data, nstep=round(self.until / DT))

    def error_mm(self):
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        worst, settled, chunk = 0.0, None, round(self.until / DT / SAMPLES)
        for i in range(SAMPLES):
            mujoco.mj_step(self.model, self.data, nstep=chunk)
            t, at = (i + 1) * chunk * DT, self.data.body("body_0").xpos.copy()
            should = truth(self.name, t)
            if should is None and settled is None and t >= SETTLED - 1e-9:
                settled = at
            should = settled if should is None else should
            if should is not None:
                worst = max(worst, np.linalg.norm(at - should))
        return 1e3 * worst

    def rate(self, seconds):
        begin, runs = time.perf_counter(), 0
        while runs == 0 or time.perf_counter() - begin < seconds:
            self.run()
            runs += 1
        return runs * self.until / (time.perf_counter() - begin)


def ours(binary, case, seconds, dt=None, extra=()):
    command = [binary, "--case", case, "--seconds", str(seconds), *extra]
    if dt is not None:
        command += ["--dt", str(dt)]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [json.loads(line) for line in out.splitlines()]


def build():
    command = ["cargo", "build", "--release", "--quiet", "-p", "drex-mujoco", "--example", "speed"]
    subprocess.run(command, check=True, cwd=ROOT)
    target = os.environ.get("CARGO_TARGET_DIR", ROOT / "target")
    return str(pathlib.Path(target) / "release" / "examples" / "speed")


def compare(case, binary, xml, rounds, seconds):
    demand = DEMANDS[case]
    rows, best_ours, best_peer = [], None, None
    for line in ours(binary, case, 0.1):
        counts = line["error_mm"] <= demand
        rows.append((f"ours, {1e3 * line['dt_s']:g} ms", line["error_mm"], line["rate"], counts))
        if counts and (best_ours is None or line["rate"] > best_ours["rate"]):
            best_ours = line
    for setting in SETTINGS:
        peer = Peer(case, xml, setting)
        error, rate = peer.error_mm(), peer.rate(0.1)
        counts = error <= demand
        rows.append((f"MuJoCo, {1e3 * DT:g} ms, {setting}", error, rate, counts))
        if counts and (best_peer is None or rate > best_peer[1]):
            best_peer = (peer, rate, setting)
    print(f"\n{case}: at most {demand:g} mm from the true path")
    for name, error, rate, counts in rows:
        print(f"  {name:74} {error:10.4f} mm{'' if counts else '  too large':12}  {rate:9.1f} s/s")
    if best_ours is None or best_peer is None:
        print("  nothing to compare: an engine meets the demand at no setting")
        return
    pairs = []
    for _ in range(rounds):
        mine = ours(binary, case, seconds, best_ours["dt_s"])[0]["rate"]
        pairs.append((mine, best_peer[0].rate(seconds)))
    ratios = [a / b for a, b in pairs]
    mine, theirs = (statistics.median(column) for column in zip(*pairs))
    print(f"  ours at {1e3 * best_ours['dt_s']:g} ms {mine:.1f} s/s, MuJoCo ({best_peer[2]}) {theirs:.1f} s/s = "
          f"{theirs / DT / 1e3:.1f} k steps/s: ratio {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=0.5, help="wall time per engine and round")
    args = parser.parse_args()
    binary = build()
    if hasattr(os, "sched_setaffinity"):
        # One core for this process and those it starts.
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(f"MuJoCo {mujoco.__version__} (Python wheel), one core, {args.rounds} rounds of {args.seconds:g} s per engine")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([binary, "--seconds", "0", "--mjcf", folder], check=True, capture_output=True)
        for case in DEMANDS:
            compare(case, binary, (pathlib.Path(folder) / f"{case}.xml").read_text(), args.rounds, args.seconds)


main()
