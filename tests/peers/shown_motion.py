"""Which simulated pushes a noisy track shows at all: whether its poses agree better with the true motion than in any other order.

    python3 shown_motion.py PUSH_MUJOCO [--poses hard|noisy] [--only TEXT]      # needs numpy; PUSH_MUJOCO holds <object>/<scenario>

drex refuses to weigh a push whose poses agree with the best motion that it finds by less than four standard deviations better than in a
random order (mean and variance over all orders: Hoeffding 1951; `shown` in crates/drex-sysid/src/fit.rs, whose constants are repeated
here). Here the motion is the true one, with the true clock and the true constant error of the height. What it leaves well below 1 is rightly
refused, and what drex refuses above 1 it refuses wrongly; an estimate, which is fitted to the poses, may do a few hundredths better.
Printed: a line for each push below 1, then per kind of push how many there are and how many lie below.
"""
import argparse, collections, json, pathlib

import numpy as np

CAUCHY = 40.0
POSITION, ROTATION = 0.002, np.radians(1.0)
SHOWN, SHOWN_SHARE = 4.0, 0.75


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("root", type=pathlib.Path)
    p.add_argument("--poses", choices=["hard", "noisy"], default="hard")
    p.add_argument("--only", default="")
    args = p.parse_args()
    shares = collections.defaultdict(list)
    for path in sorted(args.root.glob("*/*/truth.json")):
        name = f"{path.parent.parent.name}/{path.parent.name}"
        if args.only in name:
            share = shown(path.parent, args.poses)
            shares[path.parent.name].append(share)
            if share < 1.0:
                print(f"{name:30s} {share:.2f}", flush=True)
    if not shares:
        raise SystemExit(f"no <object>/<scenario>/truth.json with `{args.only}` in its name is in {args.root}")
    for kind, of in shares.items():
        print(f"{kind}: {len(of)} pushes, the true motion of {sum(s < 1.0 for s in of)} is not shown")


def shown(folder, poses):
    """How well the poses of a recording show its true motion, as a share of what it takes."""
    clean, seen = (np.loadtxt(folder / f"pose_{p}.csv", delimiter=",", skiprows=1) for p in ("clean", poses))
    error = json.loads((folder / "truth.json").read_text())["hard"] if poses == "hard" else {}
    times = seen[:, 0] - error.get("time_offset", 0.0)
    # Between frames of the exact track a quaternion moves little: its components are interpolated.
    clean[:, 4:] *= np.cumprod(np.append(1.0, np.sign(np.sum(clean[1:, 4:] * clean[:-1, 4:], axis=1))))[:, None]
    true = np.stack([np.interp(times, clean[:, 0], clean[:, k]) for k in range(1, 8)], axis=1)
    true[:, 3:] /= np.linalg.norm(true[:, 3:], axis=1, keepdims=True)
    true[:, 2] += error.get("z_bias", 0.0)
    # Every observed pose (columns) against the motion at every time (rows).
    move = (seen[None, :, 1:4] - true[:, None, :3]) / POSITION
    cosine = np.abs(np.einsum("ik,jk->ij", true[:, 3:], seen[:, 4:]))
    turn = 2.0 * np.arccos(np.minimum(cosine, 1.0)) / ROTATION
    cost = 0.5 * CAUCHY * np.log1p((np.sum(move**2, axis=2) + turn**2) / CAUCHY)
    n = len(times)
    most = np.sqrt(max(n - 1.0, 1.0))
    apart = cost - cost.mean(axis=0)[None] - cost.mean(axis=1)[:, None] + cost.mean()
    sd = max(np.sqrt(np.sum(apart**2)) / most, 1.0)
    return (n * cost.mean() - np.trace(cost)) / (min(SHOWN, SHOWN_SHARE * most) * sd)


main()
