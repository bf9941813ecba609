"""Objective and CPU time per frame next to dex_retargeting 0.5.0, on the same recordings, in the same run, on one core each.

    pip install dex_retargeting==0.5.0 torch six
    cargo build --release -p drex-retarget --example retarget_speed
    DREX_SHARED=... python tests/peers/retarget_speed.py [--frames N] [SEQUENCE ...]

Sequences are folders of $DREX_SHARED/data/demos with a hand.json. The reference runs with the configurations that it ships (scale
1.6 for vector and dexpilot; position, without scale, only where the recording has MANO's wrist rotation for its start) on the URDF
files of $DREX_SHARED/data/robots; ours runs with the same scale on its bundled models. A frame's time is the reference's CPU time
of the thread (time.thread_time_ns) in its call `retarget`; for ours it is the wall clock, which is never less. Ours starts at the
operator frame of the key points. The objective of either is the reference's definition, without regularisation.
"""

import argparse
import json
import logging
import os
import pathlib
import subprocess
import time

import numpy as np
import torch
import yaml

import dex_retargeting
from dex_retargeting.retargeting_config import RetargetingConfig

ROOT = pathlib.Path(__file__).resolve().parents[2]
SHARED = pathlib.Path(os.environ["DREX_SHARED"])
CONFIGS = pathlib.Path(dex_retargeting.__file__).parent / "configs"
HANDS = {"leap_right": "leap_hand", "allegro_right": "allegro_hand"}
METHODS = {"vector": "teleop/{}_right.yml", "dexpilot": "teleop/{}_right_dexpilot.yml", "position": "offline/{}_right.yml"}


def reference(hand, method, frames):
    """Objectives and CPU milliseconds per frame."""
    name = HANDS[hand]
    config = yaml.safe_load((CONFIGS / METHODS[method].format(name)).read_text())["retargeting"]
    config["urdf_path"] = str(SHARED / f"data/robots/{name}/urdf/{name}_right.urdf")
    retargeting = RetargetingConfig.from_dict(config).build()
    optimizer = retargeting.optimizer
    indices = np.asarray(optimizer.target_link_human_indices)
    if method == "position":
        from pytransform3d import rotations
        wrist = np.array(frames[0]["wrist_rotation"])
        retargeting.warm_start(
            np.array(frames[0]["keypoints"][0]), rotations.quaternion_from_matrix(wrist), is_mano_convention=True
        )
    objectives, times = [], []
    for frame in frames:
        if method == "position":
            value = np.array(frame["keypoints"])[indices]
        else:
            points = np.array(frame["canonical"])
            value = points[indices[1]] - points[indices[0]]
        begin = time.thread_time_ns()
        retargeting.retarget(value)
        times.append((time.thread_time_ns() - begin) * 1e-6)
        objectives.append(optimizer.opt.last_optimum_value())
    return np.array(objectives), np.array(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, help="only the first N frames")
    parser.add_argument("sequences", nargs="*")
    args = parser.parse_args()
    torch.set_num_threads(1)
    logging.disable()  # it misses the meshes of the URDF files, which nobody needs here
    folders = sorted(p.parent for p in (SHARED / "data/demos").glob("*/hand.json"))
    folders = [f for f in folders if not args.sequences or f.name in args.sequences]

    example = ROOT / "target/release/examples/retarget_speed"
    command = [example, "--json", *([] if args.frames is None else ["--frames", str(args.frames)]), *folders]
    rows = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    ours = {(r["sequence"], r["hand"], r["method"]): r for r in rows}

    print(f"{'sequence':24} {'hand':14} {'method':9} {'objective: ours':>15} {'reference':>10} {'ratio':>7}"
          f" {'ms: ours':>9} {'p95':>7} {'reference':>10} {'p95':>7} {'faster':>7}")
    for folder in folders:
        frames = json.loads((folder / "hand.json").read_text())["frames"][: args.frames]
        for hand in HANDS:
            for method in METHODS:
                if method == "position" and "wrist_rotation" not in frames[0]:
                    continue
                objectives, times = reference(hand, method, frames)
                row = ours[(folder.name, hand, method)]
                print(f"{folder.name:24} {hand:14} {method:9} {row['mean_objective']:15.5f} {objectives.mean():10.5f}"
                      f" {row['mean_objective'] / objectives.mean():7.4f} {row['median_ms']:9.4f} {row['p95_ms']:7.4f}"
                      f" {np.median(times):10.3f} {np.percentile(times, 95):7.3f}"
                      f" {np.median(times) / row['median_ms']:6.0f}x", flush=True)


if __name__ == "__main__":
    main()
