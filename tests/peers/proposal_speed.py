"""Time of a proposal for an object that the network has not seen next to the same network in PyTorch on one core, in one run, by turns.

    pip install torch
    cargo build --release -p drex-policy --example propose_speed
    python tests/peers/proposal_speed.py [--turns N]

Ours is everything from 1024 points to ten grasps: 256 points far from each other, what is seen from 64 places, the network, and its answer decoded. PyTorch's is
the network alone: 64 x 96 points through 3-32-64-128, their largest and mean value and 5 numbers through 256-256 to 256 rates, and 120 pairs of place and
prototype through 128-128-22. Its weights are random, which changes no time.
"""

import argparse
import json
import os
import pathlib
import subprocess
import time

import torch

ROOT = pathlib.Path(__file__).resolve().parents[2]
PLACES, PATCH, SCALARS, PROTOTYPES, PAIRS, PLACE, CHANGE, CHANGED = 64, 96, 5, 256, 120, 256, 128, 22


def peer():
    torch.manual_seed(0)
    layer = torch.nn.Linear
    point = torch.nn.Sequential(layer(3, 32), torch.nn.ReLU(), layer(32, 64), torch.nn.ReLU(), layer(64, 128), torch.nn.ReLU())
    place = torch.nn.Sequential(layer(2 * 128 + SCALARS, PLACE), torch.nn.ReLU(), layer(PLACE, PLACE), torch.nn.ReLU())
    rate, of_place, of_prototype = layer(PLACE, PROTOTYPES), layer(PLACE, CHANGE), torch.nn.Embedding(PROTOTYPES, CHANGE)
    change = torch.nn.Sequential(torch.nn.ReLU(), layer(CHANGE, CHANGE), torch.nn.ReLU(), layer(CHANGE, CHANGED))
    patches, scalars = torch.randn(PLACES, PATCH, 3), torch.randn(PLACES, SCALARS)
    times = []
    with torch.no_grad():
        for _ in range(100):
            started = time.perf_counter()
            x = point(patches)
            features = place(torch.cat([x.amax(1), x.mean(1), scalars], -1))
            best = rate(features).flatten().topk(PAIRS).indices
            change(of_place(features[best // PROTOTYPES]) + of_prototype(best % PROTOTYPES))
            times.append(1e3 * (time.perf_counter() - started))
    times.sort()
    return times[50], times[0]


def ours():
    program = ROOT / "target/release/examples/propose_speed"
    environment = dict(os.environ, RAYON_NUM_THREADS="1")
    found = json.loads(subprocess.run([program], check=True, capture_output=True, text=True, env=environment).stdout)
    return found["median_ms"], found["least_ms"]


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--turns", type=int, default=5)
    arguments = arguments.parse_args()
    torch.set_num_threads(1)
    rows = {"drex": [], "torch": []}
    for _ in range(arguments.turns):
        rows["drex"].append(ours())
        rows["torch"].append(peer())
    best = {name: [min(column) for column in zip(*found)] for name, found in rows.items()}
    print(f"one core, torch {torch.__version__}, best of {arguments.turns} turns")
    for name, (median, least) in best.items():
        print(f"{name:6} {median:6.2f} ms median, {least:6.2f} ms least")
    print(f"torch (network alone) / drex (points to grasps): {best['torch'][0] / best['drex'][0]:.2f}")


if __name__ == "__main__":
    main()
