"""Weighs the objects of simulated pushes with drex, with mujoco.sysid and with phyz: error, coverage, seconds, in one run.

    pip install "mujoco[sysid]" numpy
    DREX_SHARED=... python tests/peers/weigh.py [--data DIR] [--finger] [--force exact] [--only drex,sysid,phyz] [--drex PROGRAM] [PUSH ...]

Pushes are folders OBJECT/SCENARIO of simulated pushes (scene.xml, meta.json, csv files); without names, all by a known force, and with
--finger those by a fingertip too. Each program is given the noisy poses, the noisy force (or the commands and the encoder of the fingertip),
the stated pose at the start, friction and mesh, and the same wrong first guess of the mass. Each runs on one core. truth.json is read for the
scores alone.

    drex          the example `identify` of drex-sysid, or with --drex the whole program: `drex identify` on what `drex import mujoco-push`
                  makes of the folder. It scans 5 g to 5 kg, fits clock, bias and errors of the force beside the mass, tries other contacts,
                  and gives an interval or says why there is none.
    mujoco.sysid  the toolbox of MuJoCo's Python package with its own parameter of a body's mass (rotational inertia goes along, bounds 0.1 to
                  10 times the guess), its default optimiser (differences over 1 g) and its intervals, on the folder's own scene. The force
                  acts through three actuators at a site. Residuals are weighted by the noise that is stated, through `modify_residual`: by
                  default they would be divided by the size of the signal.
    phyz          phyz 0.4 (Rust): its convex contacts and its adjoint, in tests/peers/phyz; primitives instead of the mesh, 1 ms steps.

The last two descend from the guess, which is where they stall if the object does not move with it, and also from the best of 28
masses over their bounds, since neither has a search of its own. MuJoCo weighs what MuJoCo simulated, with the same contacts and step: no model
error is left to it. The seconds are processor time of the fit (for drex and phyz of the whole process), without imports and compiling: what it
takes on one idle core, also if the machine is not idle.
"""

import argparse
import contextlib
import io
import json
import logging
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
FORCES = ["lift_force", "slide_force", "tilt_force", "overhang_press"]
FINGERS = ["finger_fast", "finger_slow", "finger_tilt"]
POSITION_M, ROTATION, ENCODER_M = 2e-3, np.radians(1.0), 1e-4
SCANNED = 28
# Over MuJoCo's own 1.5e-8 kg the differences show the chatter of contacts and little else.
DIFFERENCE_KG = 1e-3
PHYZ = "phyz 0.4.0"


class Missing(Exception):
    """Why a program cannot be run here."""


class Unable(Exception):
    """What a program cannot do with a push."""


def table(path):
    return np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2)


def force_file(force):
    return dict(noisy="force_noisy.csv", exact="force.csv")[force]


def turn(a, b):
    """Rotation vectors from quaternions a to b, row by row."""
    w = np.sum(a * b, axis=1)
    v = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    v, w = v * np.where(w < 0, -1, 1)[:, None], np.abs(w)
    size = np.linalg.norm(v, axis=1)
    return v * np.where(size > 1e-12, 2 * np.arctan2(size, w) / np.maximum(size, 1e-12), 2)[:, None]


def seconds_of_children():
    spent = os.times()
    return spent.children_user + spent.children_system


def one_core(command):
    """Standard output and processor seconds of a program."""
    begin = seconds_of_children()
    run = subprocess.run(list(map(str, command)), capture_output=True, text=True, env={**os.environ, "RAYON_NUM_THREADS": "1"})
    seconds = seconds_of_children() - begin
    if run.returncode != 0:
        raise Unable((run.stderr.strip() or run.stdout.strip()).splitlines()[-1])
    return run.stdout, seconds


class Drex:
    names = ["drex"]

    def __init__(self, program, force):
        self.program, self.force, self.version = program, force, "drex (example identify)"
        if program is None:
            build = ["cargo", "build", "--release", "--quiet", "--locked", "-p", "drex-sysid", "--example", "identify"]
            if subprocess.run(build, cwd=ROOT).returncode != 0:
                raise Missing(f"`{' '.join(build)}` failed")
            self.program = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release/examples/identify"
        self.example = pathlib.Path(self.program).name.startswith("identify")
        if not self.example:
            self.version = subprocess.run([self.program, "--version"], capture_output=True, text=True).stdout.strip()
        elif force != "noisy":
            raise Missing("the exact force needs --drex with the whole program")

    def weigh(self, folder, work):
        if self.example:
            command = [self.program, "--mujoco", folder]
        else:
            one_core([self.program, "import", "mujoco-push", folder, "--force", self.force, "--out", work / "push"])
            command = [self.program, "identify", work / "push", "--threads", 1, "--json"]
        out, seconds = one_core(command)
        answer = json.loads(out)
        yield dict(mass=answer["mass_kg"], interval=answer.get("ci95_kg"), seconds=seconds, why=answer["verdict"])


class Sysid:
    names = ["mujoco.sysid, from the guess", "mujoco.sysid, after a scan"]

    def __init__(self, force):
        self.force = force
        try:
            import mujoco
            from mujoco import sysid

            sysid.optimize  # There is nothing in the module where the extra is not installed.
        except (ImportError, AttributeError) as error:
            raise Missing(f'needs `pip install "mujoco[sysid]"`, 3.5 or later: {error}') from None
        logging.getLogger("absl").setLevel(logging.ERROR)  # It warns that no sensor of the model is measured: the state is.
        self.mujoco, self.sysid, self.version = mujoco, sysid, f"mujoco {mujoco.__version__}"

    def weigh(self, folder, _work):
        for masses in (0, SCANNED):
            begin = time.process_time()
            answer = self.fit(folder, masses)
            yield dict(answer, seconds=time.process_time() - begin)

    def fit(self, folder, masses):
        sysid = self.sysid
        meta = json.loads((folder / "meta.json").read_text())
        spec, control, columns = self.scene(folder, meta)
        model = spec.compile()
        dt, track = model.opt.timestep, table(folder / "pose_noisy.csv")
        finger = meta["finger"]
        encoder = table(folder / "proprio.csv")[:, :4] if finger else np.zeros((0, 4))
        steps = lambda times: np.round(times / dt).astype(int)
        track, encoder = (rows[steps(rows[:, 0]) > 0] for rows in (track, encoder))
        count = max(steps(rows[-1:, 0]).max(initial=0) for rows in (track, encoder))
        times = np.arange(count + 1) * dt
        held = control[np.maximum(np.searchsorted(control[:, 0], times + 1e-9, side="right") - 1, 0), 1:4]
        home = np.array(finger["home"]) if finger else np.zeros(3)

        def modify_residual(params, predicted, measured, model, return_pred_all, state=None, **_):
            # The state after step k is row k - 1; its first column is the time.
            pose = state[steps(track[:, 0]) - 1, 1:8]
            tip = state[steps(encoder[:, 0]) - 1, 8:11] + home if finger else encoder[:, 1:]
            parts = [(track[:, 1:4] - pose[:, :3]) / POSITION_M, turn(pose[:, 3:], track[:, 4:]) / ROTATION, (encoder[:, 1:] - tip) / ENCODER_M]
            return np.concatenate([p.ravel() for p in parts]), measured, measured

        sequence = sysid.ModelSequences(
            "push", spec, folder.name, sysid.create_initial_state(model, model.qpos0.copy()),
            sysid.TimeSeries.from_control_names(times, held - home if finger else held, model),
            sysid.TimeSeries.from_custom_map(track[:, 0], track[:, 1:], columns), allow_missing_sensors=True)
        # The default modifier hands an array to MjsBody.mass, which refuses it under numpy 2.4.
        scale = lambda spec, p: sysid.model_modifier.apply_body_mass_ipos(spec, "object", mass=float(p.value[0]), rot_inertia_scale=True)
        mass = sysid.body_inertia_param(spec, model, "object", inertia_type=sysid.InertiaType.Mass, modifier=scale)
        params = sysid.ParameterDict()
        params.add(mass)
        residual = sysid.build_residual_fn(models_sequences=[sequence], modify_residual=modify_residual, n_threads=1)
        if masses:
            low, high = np.log(mass.get_bounds()).ravel()
            starts = np.exp(np.linspace(low, high, masses))
            mass.value[:] = min(starts, key=lambda kg: np.sum(np.square(residual(np.array([kg]), params)[0])))
        with contextlib.redirect_stdout(io.StringIO()):
            found, result = sysid.optimize(initial_params=params, residual_fn=residual, optimizer="mujoco", verbose=False, eps=DIFFERENCE_KG)
            _, half = sysid.calculate_intervals(residual(result.x, found)[0], result.jac)
        kg = float(result.x[0])
        return dict(mass=kg, interval=[kg - float(half[0]), kg + float(half[0])] if np.isfinite(half[0]) else None)

    def scene(self, folder, meta):
        """The model with what the robot knows, what drives it, and names for the measured columns."""
        spec = self.mujoco.MjSpec.from_file(str(folder / "scene.xml"))
        if meta["finger"] is None:
            spec.body("object").add_site(name="point", pos=meta["force_point_body"])
            spec.worldbody.add_site(name="world")
            for i, axis in enumerate("xyz"):
                # In the axes of the site `world`, however the object turns.
                spec.add_actuator(name="force_" + axis, trntype=self.mujoco.mjtTrn.mjTRN_SITE, target="point", refsite="world", gear=np.eye(6)[i])
        control = table(folder / ("action.csv" if meta["finger"] else force_file(self.force)))
        return spec, control, ["x", "y", "z", "qw", "qx", "qy", "qz"]


class Phyz:
    names = ["phyz, from the guess", "phyz, after a scan"]
    version = PHYZ

    def __init__(self, target, force):
        self.force = force
        try:
            import mujoco
        except ImportError:
            raise Missing("needs mujoco to read scene.xml") from None
        self.mujoco = mujoco
        project = ROOT / "tests/peers/phyz"
        build = ["cargo", "build", "--release", "--quiet", "--locked", "--manifest-path", project / "Cargo.toml", "--target-dir", target]
        done = subprocess.run(list(map(str, build)), cwd=ROOT, capture_output=True, text=True)
        if done.returncode != 0:
            raise Missing("its build failed: " + (done.stderr.strip().splitlines() or ["it said nothing"])[-1])
        self.program = target / "release/weigh-with-phyz"

    def weigh(self, folder, work):
        push = work / "push.txt"
        push.write_text(self.describe(folder))
        for masses in (0, SCANNED):
            out, seconds = one_core([self.program, push, masses])
            answer = json.loads(out)
            refused = f"; its adjoint refused {answer['refused']} of {answer['adjoints']} times" if answer["refused"] else ""
            yield dict(mass=answer["mass_kg"], interval=None, seconds=seconds, note=refused)

    def describe(self, folder):
        mj, meta = self.mujoco, json.loads((folder / "meta.json").read_text())
        if meta["finger"] is not None:
            raise Unable("a fingertip's encoder is not built into tests/peers/phyz")
        model = mj.MjModel.from_xml_path(str(folder / "scene.xml"))
        body, axes = model.body("object").id, np.zeros(9)
        mj.mju_quat2Mat(axes, model.body_iquat[body])
        axes = axes.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T / model.body_mass[body]
        lines = [["guess_kg", meta["mass_prior"]], ["friction", meta["friction_object_table"]], ["gravity", *meta["gravity"]],
                 ["com", *model.body_ipos[body]], ["inertia_per_kg", *inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]],
                 ["point", *meta["force_point_body"]], ["start", *meta["initial_pose"]]]
        for g in np.flatnonzero(model.geom_bodyid == body):
            kind = {mj.mjtGeom.mjGEOM_BOX: ("box", 3), mj.mjtGeom.mjGEOM_CYLINDER: ("cylinder", 2)}[mj.mjtGeom(model.geom_type[g])]
            lines.append([kind[0], *model.geom_size[g][: kind[1]], *model.geom_pos[g], *model.geom_quat[g]])
        if meta["step"]:
            half = meta["step"]["half"]
            lines.append(["support", *half, meta["step"]["x"], 0, half[2]])
        lines += [["pose", *row] for row in table(folder / "pose_noisy.csv")] + [["force", *row] for row in table(folder / force_file(self.force))]
        return "\n".join(" ".join([line[0], *(repr(float(x)) for x in line[1:])]) for line in lines)


def shown(answer, truth):
    if answer["mass"] is None:
        return f"none: {answer['why']}"
    text = f"{1e3 * answer['mass']:7.1f} g ({100 * (answer['mass'] / truth - 1):+7.2f} %)"
    if answer["interval"]:
        lo, hi = answer["interval"]
        text += f", {1e3 * lo:.1f} to {1e3 * hi:.1f} g" + ("" if lo <= truth <= hi else ", which misses")
    return text + answer.get("note", "")


def summary(answers):
    """One row per class of push and program; `answers` maps (class, program) to the answers."""
    print("\n| push | program | answers | error, median | of drex's | worst | within 5 % | truth in the 95 % interval | its half width, median | s, median | of drex's |")
    print("|---" * 11 + "|")
    for kind, name in answers:
        ours = Score(answers[kind, "drex"]) if name != "drex" and (kind, "drex") in answers else None
        print(f"| {kind} | {name} | " + " | ".join(Score(answers[kind, name]).cells(ours)) + " |")


class Score:
    """How good the answers of one program are."""

    def __init__(self, rows):
        given = [r for r in rows if r["mass"] is not None]
        bounded = [r for r in given if r["interval"]]
        self.count, self.given, self.bounded = len(rows), len(given), len(bounded)
        self.errors = [100 * abs(r["mass"] / r["truth"] - 1) for r in given]
        self.inside = sum(r["interval"][0] <= r["truth"] <= r["interval"][1] for r in bounded)
        self.half = [50 * (r["interval"][1] - r["interval"][0]) / r["truth"] for r in bounded]
        self.seconds = statistics.median(r["seconds"] for r in rows)

    def cells(self, ours):
        error = statistics.median(self.errors) if self.errors else None
        of_ours = f"{error / statistics.median(ours.errors):.1f}" if ours and self.errors and ours.errors else ""
        return [f"{self.given} of {self.count}", f"{error:.2f} %" if self.errors else "", of_ours, f"{max(self.errors):.1f} %" if self.errors else "",
                f"{sum(e <= 5 for e in self.errors)} of {self.count}", f"{self.inside} of {self.bounded}" if self.bounded else "none given",
                f"{statistics.median(self.half):.2f} %" if self.bounded else "", f"{self.seconds:.2f}", f"{self.seconds / ours.seconds:.1f}" if ours else ""]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pushes", nargs="*", metavar="PUSH", help="OBJECT/SCENARIO; all by a known force if left out")
    parser.add_argument("--data", type=pathlib.Path, help="folder of objects; DREX_SHARED/data/push_mujoco if left out")
    parser.add_argument("--finger", action="store_true", help="pushes by a fingertip too")
    parser.add_argument("--force", choices=["noisy", "exact"], default="noisy", help="exact: how much of an error is the noise of the force")
    parser.add_argument("--only", default="drex,sysid,phyz")
    parser.add_argument("--drex", help="a built drex, or a built example identify")
    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache"))
    parser.add_argument("--phyz-target", type=pathlib.Path, default=cache / "drex-peers/phyz", help="folder for what cargo makes of phyz")
    args = parser.parse_args()
    if args.data is None and "DREX_SHARED" not in os.environ:
        parser.error("give --data or set DREX_SHARED")
    data = args.data or pathlib.Path(os.environ["DREX_SHARED"]) / "data" / "push_mujoco"
    kinds = FORCES + (FINGERS if args.finger else [])
    pushes = args.pushes or [f"{p.parent.name}/{p.name}" for k in kinds for p in sorted(data.glob(f"*/{k}"))]
    if not pushes:
        parser.error(f"no push in {data}")
    makers = dict(drex=lambda: Drex(args.drex, args.force), sysid=lambda: Sysid(args.force), phyz=lambda: Phyz(args.phyz_target, args.force))
    programs = []
    for name in args.only.split(","):
        try:
            programs.append(makers[name]())
        except Missing as why:
            print(f"{name} is left out: {why}")
    if hasattr(os, "sched_setaffinity"):
        # One core for this process and those it starts.
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(", ".join(p.version for p in programs) + "; one core")
    answers = {}
    for push in pushes:
        folder, kind = data / push, push.split("/")[1]
        truth, guess = (json.loads((folder / f).read_text())[k] for f, k in [("truth.json", "mass"), ("meta.json", "mass_prior")])
        print(f"{push}: true mass {1e3 * truth:.1f} g, first guess {1e3 * guess:.0f} g", flush=True)
        with tempfile.TemporaryDirectory(prefix="drex-weigh-") as work:
            for program in programs:
                try:
                    for name, answer in zip(program.names, program.weigh(folder, pathlib.Path(work))):
                        answers.setdefault((kind, name), []).append(dict(answer, truth=truth))
                        print(f"  {name:29} {answer['seconds']:7.2f} s  {shown(answer, truth)}", flush=True)
                except Unable as why:
                    print(f"  {program.names[0].split(',')[0]:29} cannot: {why}", flush=True)
    order = list(dict.fromkeys(k for k, _ in answers))
    names = [n for p in programs for n in p.names]
    table = {(k, n): answers[k, n] for k in order for n in names if (k, n) in answers}
    for n in names:
        rows = [r for k in order for r in answers.get((k, n), [])]
        if rows:
            table["all", n] = rows
    summary(table)


if __name__ == "__main__":
    sys.exit(main())
