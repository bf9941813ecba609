"""A position loop in Python, with python-can, on the emulated Allegro hand: the frames are those that others read and write.

    pip install python-can pyserial
    cargo build --release -p drex-hw --example allegro_emulator
    python tests/peers/python_can_allegro.py [--seconds N]

The loop knows the wire format from the vendor's drivers only, not from drex: identifiers, byte order, units. Each joint is sent
against a wall at 0.2 rad with a clip; its contact torque has to be the clip, and its angle the wall's. Prints cycles per second.
"""

import argparse
import json
import math
import pathlib
import struct
import subprocess
import sys
import time

import can

ROOT = pathlib.Path(__file__).resolve().parents[2]
WALL = 0.2
GOAL = 1.2
CLIP_NM = 0.1
KP, KD = 0.5, 0.02

# Per version: the frame that sets the period of poses, rad per count, counts per N m.
VERSIONS = {
    "v3": dict(period=(0x0CA, b"\x03"), rad=math.radians(333.3 / 65536), unit=1200),
    "v4": dict(period=(0x81 << 2, struct.pack("<3H", 3, 0, 0)), rad=math.radians(333.3 / 65536), unit=1200),
    "v5": dict(period=(0x81 << 2, struct.pack("<3H", 2, 0, 0)), rad=math.radians(0.088), unit=1430),
}


def send(bus, identifier, data=b""):
    bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))


def pose(version, message):
    """Finger and angles, rad, or None."""
    if message.is_remote_frame or message.is_extended_id or len(message.data) != 8:
        return None
    if version == "v3":
        command, source = message.arbitration_id >> 6, message.arbitration_id & 7
        if command != 0x0F or not 3 <= source <= 6:
            return None
        finger, counts = source - 3, [c - 32768 for c in struct.unpack("<4H", message.data)]
    else:
        finger, counts = (message.arbitration_id >> 2) - 0x20, struct.unpack("<4h", message.data)
        if not 0 <= finger < 4:
            return None
    return finger, [c * VERSIONS[version]["rad"] for c in counts]


def send_torques(bus, version, torques):
    unit = VERSIONS[version]["unit"]
    for finger in range(4):
        counts = [round(t * unit) for t in torques[4 * finger : 4 * finger + 4]]
        if version == "v3":
            send(bus, (0x06 + finger) << 6 | 1 << 3 | 2, struct.pack(">4h", *reversed(counts)))
        else:
            send(bus, (0x60 + finger) << 2, struct.pack("<4h", *counts))


def run(version, seconds):
    hand = subprocess.Popen(
        [ROOT / "target/release/examples/allegro_emulator", version, ROOT / "target/allegro-peer", str(WALL)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        port = hand.stdout.readline().strip()
        bus = can.Bus(interface="slcan", channel=port, bitrate=1_000_000, sleep_after_open=0)
        on, off = ((0x01 << 6 | 0x0A), (0x02 << 6 | 0x0A)) if version == "v3" else (0x40 << 2, 0x41 << 2)
        send(bus, off)
        send(bus, *VERSIONS[version]["period"])
        send(bus, on)
        if version == "v3":
            send(bus, 0x0E << 6 | 0x0A)
        q, last, v = [None] * 16, [None] * 16, [0.0] * 16
        fresh, cycles, begin, before = set(), 0, time.monotonic(), None
        while time.monotonic() < begin + seconds:
            message = bus.recv(0.1)
            found = message and pose(version, message)
            if not found:
                continue
            finger, angles = found
            q[4 * finger : 4 * finger + 4] = angles
            fresh.add(finger)
            if len(fresh) < 4:
                continue
            fresh.clear()
            now = time.monotonic()
            if before:
                dt = max(now - before, 1e-3)
                v = [0.7 * o + 0.3 * (a - b) / dt for o, a, b in zip(v, q, last)]
            last, before = list(q), now
            send_torques(bus, version, [max(-CLIP_NM, min(CLIP_NM, KP * (GOAL - a) - KD * w)) for a, w in zip(q, v)])
            cycles += 1
        rate = cycles / (time.monotonic() - begin)
        hand.stdin.write("\n")
        hand.stdin.flush()
        truth = json.loads(hand.stdout.readline())
        send_torques(bus, version, [0.0] * 16)
        send(bus, off)
        bus.shutdown()
    finally:
        hand.stdin.close()
        hand.wait(5)
    torque = max(abs(t - CLIP_NM) for t in truth["contact_nm"])
    angle = max(abs(a - WALL) for a in q)
    good = torque < 1e-3 and angle < 2e-3
    print(f"{version}: {rate:.0f} cycles/s, contact torque off by {torque:.1e} N m, angle by {angle:.1e} rad: {'ok' if good else 'WRONG'}")
    return good


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3.0)
    seconds = parser.parse_args().seconds
    sys.exit(0 if all([run(version, seconds) for version in VERSIONS]) else 1)


if __name__ == "__main__":
    main()
