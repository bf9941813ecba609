"""The least standard deviation that any estimate of a mass can have, given noisy poses and a noisy force, by MuJoCo itself.

    python3 force_bound.py PUSH_MUJOCO        # needs mujoco and numpy; PUSH_MUJOCO holds generate.py and <object>/<scenario>

The unknowns of the linear Gaussian problem around the true motion are ln m, the error of every sample of the force (3 % of
its peak + 10 mN), and what drex takes for unknown of a track: clock (5 ms), a constant error of position (10 mm) and rotation
(20 mrad), a drift (2 mm/s). Poses: 2 mm, 1 degree. Printed, in percent of the mass:

    perfect   poses without any error: noise s on samples u leaves s / |u|, since force and mass times one factor move everything alike
    force     exact force
    both      both noisy
    file      what truth.json states for an exact force: slopes over +-10 % of mass, which for a tilt reach beyond toppling
    drawn     the error that the noise in the files leaves an estimate from perfect poses, and the best one from the noisy poses

and at the end the root mean square of the last two.
"""
import glob, importlib.util, json, os, sys

import mujoco
import numpy as np

STEP = 0.5  # of a standard deviation, to each side
ROTATION = np.radians(1.0)


def main(root):
    spec = importlib.util.spec_from_file_location("generate", os.path.join(root, "generate.py"))
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    drawn = []
    for path in sorted(glob.glob(os.path.join(root, "*", "*", "force.csv"))):
        folder = os.path.dirname(path)
        perfect, force, both, stated, errors = bounds(generate, folder)
        drawn.append(errors)
        name = "/".join(folder.split(os.sep)[-2:])
        print(
            f"{name:30s} perfect {perfect:.2f} force {force:.2f} both {both:.2f} file {stated:.3f} "
            f"drawn {errors[0]:+.2f} {errors[1]:+.2f}",
            flush=True,
        )
    print("root mean square of the drawn errors: {:.2f} {:.2f}".format(*np.sqrt(np.mean(np.square(drawn), axis=0))))


def bounds(generate, folder):
    meta, truth = (json.load(open(os.path.join(folder, f + ".json"))) for f in ("meta", "truth"))
    model = mujoco.MjModel.from_xml_path(os.path.join(folder, "scene.xml"))
    body = model.body("object").id
    model.body_inertia[body] *= truth["mass"] / model.body_mass[body]
    model.body_mass[body] = truth["mass"]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    table = lambda name: np.genfromtxt(os.path.join(folder, name), delimiter=",", skip_header=1)
    u = table("force.csv")[:, 1:4]
    noise = table("force_noisy.csv")[:, 1:4] - u
    sd = 0.03 * np.abs(u).max() + 0.01
    base, _ = generate.run(model, meta["duration"], u, meta["force_point_body"])

    def residual(u, shift=0):
        return generate.resid(base, generate.run(model, meta["duration"], u, meta["force_point_body"], shift=shift)[0])

    samples = np.argwhere(u != 0)
    errors = []
    for k, axis in samples:
        more, less = u.copy(), u.copy()
        more[k, axis] += STEP * sd
        less[k, axis] -= STEP * sd
        errors.append((residual(more) - residual(less)) / (2 * STEP))
    by_mass = -sum(e * u[k, axis] / sd for e, (k, axis) in zip(errors, samples))
    track = [(residual(u, 10) - residual(u, -10)) / 0.01 * 0.005]
    for axis in range(6):
        constant = np.zeros((len(base), 6))
        constant[:, axis] = 0.010 / 0.002 if axis < 3 else 0.020 / ROTATION
        track.append(constant.ravel())
    drift = np.zeros((len(base), 6))
    drift[:, 2] = base[:, 0] * 0.002 / 0.002
    track.append(drift.ravel())
    # What the estimate sees: noisy poses against the motion under the noisy force at the true mass.
    drawn = np.array([noise[k, axis] / sd for k, axis in samples])
    seen = generate.resid(base, table("pose_noisy.csv")) - sum(e * x for e, x in zip(errors, drawn))
    best = least(by_mass, track + errors, seen)
    return (
        100 * sd / np.linalg.norm(u),
        least(by_mass, track),
        least(by_mass, track + errors),
        100 * truth["crb_rel_sd_mass_mu_known"],
        (100 * np.sum(noise * u) / np.sum(u * u), best),
    )


def least(by_mass, unit_unknowns, seen=None):
    """Standard deviation of ln m in percent, the other unknowns having a prior deviation of one; or its estimate from residuals."""
    slopes = np.array([by_mass, *unit_unknowns]).T
    covariance = np.linalg.inv(slopes.T @ slopes + np.diag([1e-9] + [1.0] * len(unit_unknowns)))
    return 100 * (np.sqrt(covariance[0, 0]) if seen is None else (covariance @ slopes.T @ seen)[0])


if __name__ == "__main__":
    main(sys.argv[1])
