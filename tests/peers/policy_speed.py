"""Time of the first training phase next to the same network in PyTorch on the CPU, in one run, by turns.

    pip install torch
    cargo build --release -p drex-policy --example train_speed
    python tests/peers/policy_speed.py [--epochs N] [--turns N] [--threads N]

Both train 900 samples (300 grasps at three masses) of one object: 512 points with 39 numbers each, 128 hidden units, 16 modes of 16 joints, wrist,
squeeze, logit and four contacts; batches of 64, Adam, the likelihood of a mixture of Student's t with learned spreads, the distance of the nearest
mode, squeeze and contact terms. Both shake and encode the points anew in each step, and run the encoder once per step, since a batch
shares its cloud. Neither evaluates anything in between. The numbers of a step do not depend on the data, so the peer's are random. Wall clock and
CPU seconds are both told: on a shared machine the first depends on who else is there.
"""

import argparse
import json
import math
import os
import pathlib
import subprocess
import time

import torch

ROOT = pathlib.Path(__file__).resolve().parents[2]
POINTS, FREQUENCIES, HIDDEN, BATCH, MODES, JOINTS, FINGERS, SCALARS = 512, 6, 128, 64, 16, 16, 4, 3
SAMPLES = 900
ENCODED, WIDTH = 3 * (1 + 2 * FREQUENCIES), JOINTS + 11 + FINGERS
TAIL, DIMENSIONS, LENGTH = 5.0, JOINTS + 6, 0.1


def dense(inputs, outputs):
    return torch.nn.Parameter((torch.rand(inputs, outputs) * 2 - 1) * math.sqrt(6 / inputs))


def bias(count):
    return torch.nn.Parameter(torch.zeros(count))


class Peer:
    def __init__(self):
        h, out = HIDDEN, MODES * WIDTH
        self.p = [dense(ENCODED, h), bias(h), dense(h, h), bias(h), dense(h, h), bias(h), dense(h, h), dense(h, h), dense(SCALARS, h),
                  bias(h), dense(h, h), bias(h), dense(h, out), dense(SCALARS, out), bias(out), bias(JOINTS + 2)]
        self.adam = torch.optim.Adam(self.p, lr=2e-3)
        self.cloud = (torch.rand(POINTS, 3) - 0.5) * 0.16
        self.octaves = math.pi * 2.0 ** torch.arange(FREQUENCIES)
        self.scalars = torch.rand(SAMPLES, SCALARS) * 2 - 1
        self.joints, self.wrist, self.force = torch.rand(SAMPLES, 1, JOINTS), torch.rand(SAMPLES, 1, 9), torch.rand(SAMPLES, 1)
        self.contacts = (torch.rand(SAMPLES, 1, FINGERS) > 0.3).float()

    def encode(self):
        x = (self.cloud + 0.001 * torch.randn(POINTS, 3)) / LENGTH
        angles = x[..., None] * self.octaves
        return torch.cat([x[..., None], torch.sin(angles), torch.cos(angles)], -1).reshape(POINTS, ENCODED)

    def outputs(self, encoded, scalars):
        p = self.p
        x = torch.relu(torch.addmm(p[1], encoded, p[0]))
        x = torch.relu(torch.addmm(p[3], x, p[2]))
        x = torch.relu(torch.addmm(p[5], x, p[4]))
        cloud = x.amax(0, keepdim=True) @ p[6] + x.mean(0, keepdim=True) @ p[7] + p[9]
        x = torch.relu(scalars @ p[8] + cloud)
        x = torch.relu(torch.addmm(p[11], x, p[10]))
        return (torch.addmm(p[14], x, p[12]) + scalars @ p[13]).view(-1, MODES, WIDTH)

    def loss(self, rows, share):
        out, spread = self.outputs(self.encode(), self.scalars[rows]), self.p[15]
        joint = (torch.tanh(out[..., :JOINTS]) - self.joints[rows]) ** 2
        wrist = (out[..., JOINTS:JOINTS + 9] - self.wrist[rows]) ** 2
        move, turn = wrist[..., :3].sum(-1), 0.75 * wrist[..., 3:].sum(-1)
        scale = torch.exp(-2 * spread)
        z2 = (joint * scale[:JOINTS]).sum(-1) + move * scale[JOINTS] + turn * scale[JOINTS + 1]
        spreads = spread[:JOINTS].sum() + 3 * spread[JOINTS] + 3 * spread[JOINTS + 1]
        log_p = -(TAIL + DIMENSIONS) / 2 * torch.log1p(z2 / TAIL) - spreads
        log_joint = torch.log_softmax(out[..., JOINTS + 10], -1) + log_p
        log_likelihood = torch.logsumexp(log_joint, -1)
        responsible = (log_joint - log_likelihood[:, None]).exp().detach()
        nearest = (joint.mean(-1) + move + turn).amin(-1)
        force = ((torch.tanh(out[..., JOINTS + 9]) - self.force[rows]) ** 2 * responsible).sum(-1)
        logits, wanted = out[..., JOINTS + 11:], self.contacts[rows].expand(-1, MODES, -1)
        contact = torch.nn.functional.binary_cross_entropy_with_logits(logits, wanted, reduction="none").sum(-1)
        contact = (contact * responsible).sum(-1)
        total = -(1 - share) * log_likelihood - share * log_p.mean(-1) + 20 * (torch.sqrt(1 + 100 * nearest) - 1)
        return (total + 100 * force + contact).mean()

    def train(self, epochs):
        for epoch in range(epochs):
            order = torch.randperm(SAMPLES)
            for start in range(0, SAMPLES, BATCH):
                self.adam.zero_grad()
                self.loss(order[start:start + BATCH], 0.05 * (1 - epoch / epochs)).backward()
                self.adam.step()
                with torch.no_grad():
                    self.p[15].clamp_(min=math.log(0.02))


def peer(epochs):
    torch.manual_seed(0)
    model = Peer()
    model.train(1)
    cpu, wall = time.process_time(), time.perf_counter()
    model.train(epochs)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    encoded = model.encode()
    times = []
    with torch.no_grad():
        for _ in range(50):
            started = time.perf_counter()
            model.outputs(encoded, model.scalars[:1])
            times.append(1e3 * (time.perf_counter() - started))
    return wall, cpu, sorted(times)[25]


def ours(epochs, threads):
    program = ROOT / "target/release/examples/train_speed"
    environment = dict(os.environ, RAYON_NUM_THREADS=str(threads))
    found = json.loads(subprocess.run([program, str(epochs)], check=True, capture_output=True, text=True, env=environment).stdout)
    return found["seconds"], found["cpu_seconds"], found["ms_per_prediction"]


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--epochs", type=int, default=20)
    arguments.add_argument("--turns", type=int, default=3)
    arguments.add_argument("--threads", type=int, default=2)
    arguments = arguments.parse_args()
    torch.set_num_threads(arguments.threads)
    steps = arguments.epochs * math.ceil(SAMPLES / BATCH)
    rows = {"drex": [], "torch": []}
    for _ in range(arguments.turns):
        rows["drex"].append(ours(arguments.epochs, arguments.threads))
        rows["torch"].append(peer(arguments.epochs))
    best = {name: [min(column) for column in zip(*found)] for name, found in rows.items()}
    print(f"{steps} steps, {arguments.threads} threads, torch {torch.__version__}, best of {arguments.turns} turns")
    for name, (wall, cpu, predict) in best.items():
        print(f"{name:6} {1e3 * wall / steps:7.2f} ms/step  {1e3 * cpu / steps:7.2f} CPU ms/step  {predict:6.2f} ms/prediction")
    print(f"torch / drex: wall {best['torch'][0] / best['drex'][0]:.2f}, CPU {best['torch'][1] / best['drex'][1]:.2f}")


if __name__ == "__main__":
    main()
