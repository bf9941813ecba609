"""The motors' maker's own client on the emulated LEAP hand: what it reads, writes and refuses is what a real hand would say.

    pip install dynamixel-sdk
    cargo build --release -p drex-hw --example leap_emulator
    python tests/peers/dynamixel_sdk_client.py [--seconds N] [--program FILE]

Ping, read, write (whole registers, and the refusal of parts of them), registered write and action, reboot, sync, bulk, fast sync and
fast bulk read, in current-based position mode: all joints go to a goal. Then exchanges per second are measured,
as this client does them. Ends with an error if an answer is not the expected one.
"""

import argparse
import pathlib
import subprocess
import tempfile
import time

import dynamixel_sdk as dxl

ROOT = pathlib.Path(__file__).resolve().parents[2]
IDS = range(16)
MODEL, WRONG_LENGTH, LOCKED = 1240, 5, 7
MODE, TORQUE, GAIN_P, GOAL_CURRENT, GOAL, PRESENT, POSITION, TEMPERATURE = 11, 64, 84, 102, 116, 126, 132, 146


def check(what, found, expected):
    if found != expected:
        raise SystemExit(f"{what}: {found}, expected {expected}")


def signed(number, bits):
    return number - (1 << bits) if number >> (bits - 1) else number


def little(number, count):
    return list(number.to_bytes(count, "little"))


class Client:
    def __init__(self, path):
        self.port = dxl.PortHandler(str(path))
        self.packets = dxl.PacketHandler(2.0)
        if not (self.port.openPort() and self.port.setBaudRate(4_000_000)):
            raise SystemExit(f"{path} cannot be opened")

    def done(self, what, answer):
        *value, result, error = answer
        check(what, (result, error), (dxl.COMM_SUCCESS, 0))
        return value[0] if value else None

    def write(self, motor, address, value, count):
        send = {1: self.packets.write1ByteTxRx, 2: self.packets.write2ByteTxRx, 4: self.packets.write4ByteTxRx}[count]
        return send(self.port, motor, address, value)

    def sync_write(self, address, count, values):
        group = dxl.GroupSyncWrite(self.port, self.packets, address, count)
        for motor, value in values.items():
            group.addParam(motor, little(value, count))
        check("sync write", group.txPacket(), dxl.COMM_SUCCESS)

    def sync_read(self, fast):
        """Current, mA, and position, ticks, of every motor; None if the exchange failed."""
        group = dxl.GroupSyncRead(self.port, self.packets, PRESENT, 10)
        for motor in IDS:
            group.addParam(motor)
        result = group.fastSyncRead() if fast else group.txRxPacket()
        if result != dxl.COMM_SUCCESS:
            return None
        return {m: (signed(group.getData(m, PRESENT, 2), 16), signed(group.getData(m, POSITION, 4), 32)) for m in IDS}

    def bulk_read(self, fast):
        group = dxl.GroupBulkRead(self.port, self.packets)
        group.addParam(3, GAIN_P, 2)
        group.addParam(4, TEMPERATURE, 1)
        check("bulk read", group.fastBulkRead() if fast else group.txRxPacket(), dxl.COMM_SUCCESS)
        return group.getData(3, GAIN_P, 2), group.getData(4, TEMPERATURE, 1)


def talk(client):
    """Every instruction once, with the answers that have to come."""
    packets, port = client.packets, client.port
    for motor in IDS:
        check(f"ping {motor}", client.done("ping", packets.ping(port, motor)), MODEL)
    found, result = packets.broadcastPing(port)
    check("broadcast ping", (result, sorted(found)), (dxl.COMM_SUCCESS, list(IDS)))
    check("nobody", packets.ping(port, 99)[1], dxl.COMM_RX_TIMEOUT)

    client.done("write", client.write(3, GAIN_P, 777, 2))
    check("read back", client.done("read", packets.read2ByteTxRx(port, 3, GAIN_P)), 777)
    for fast in (False, True):
        check("bulk read", client.bulk_read(fast), (777, 31))

    client.done("registered write", packets.regWriteTxRx(port, 3, GAIN_P, 2, little(600, 2)))
    check("not yet", client.done("read", packets.read2ByteTxRx(port, 3, GAIN_P)), 777)
    check("action", packets.action(port, 3), dxl.COMM_SUCCESS)
    # This client does not wait for the answer to an action, and would take it for that of what it asks next.
    port.setPacketTimeout(11)
    answer, result = packets.rxPacket(port, False)
    check("answer to the action", (result, answer[4], answer[8]), (dxl.COMM_SUCCESS, 3, 0))  # its motor, its error
    check("now", client.done("read", packets.read2ByteTxRx(port, 3, GAIN_P)), 600)

    # Only whole registers are taken: half of a goal position, a goal current and half of what follows it, the second byte of a gain.
    client.done("goal", client.write(3, GOAL, 2048, 4))
    for address, count in ((GOAL, 2), (GOAL, 1), (GOAL + 2, 2), (GOAL_CURRENT, 4), (GAIN_P + 1, 1)):
        check(f"{count} bytes at {address}", client.write(3, address, 0, count), (dxl.COMM_SUCCESS, WRONG_LENGTH))
    check("nothing was written", client.done("read", packets.read4ByteTxRx(port, 3, GOAL)), 2048)
    result, error = packets.regWriteTxRx(port, 3, GOAL, 2, little(0, 2))
    check("half a registered write", (result, error), (dxl.COMM_SUCCESS, WRONG_LENGTH))
    client.done("two registers", packets.writeTxRx(port, 3, GOAL_CURRENT, 6, little(0, 6)))

    client.done("torque on", client.write(5, TORQUE, 1, 1))
    check("a mode under torque", client.write(5, MODE, 5, 1)[1], LOCKED)
    client.done("reboot", packets.reboot(port, 5))
    time.sleep(0.3)
    check("torque after a reboot", client.done("read", packets.read1ByteTxRx(port, 5, TORQUE)), 0)


def move(client):
    """All joints to a goal with limited current; plain and fast reads have to agree at rest."""
    for motor in IDS:
        client.done("mode", client.write(motor, MODE, 5, 1))
        client.done("current", client.write(motor, GOAL_CURRENT, 300, 2))
        client.done("gain", client.write(motor, GAIN_P, 600, 2))
    here = client.sync_read(False)
    client.sync_write(GOAL, 4, {m: here[m][1] for m in IDS})
    client.sync_write(TORQUE, 1, dict.fromkeys(IDS, 1))
    client.sync_write(GOAL, 4, {m: 2048 + 20 * m for m in IDS})
    time.sleep(1.0)
    # Joints creep by a tick now and then: at rest is what two plain reads, one before and one after the fast one, agree on.
    for _ in range(50):
        plain, fast, again = (client.sync_read(kind) for kind in (False, True, False))
        if plain == again:
            break
    else:
        raise SystemExit(f"the joints do not come to rest: {plain}, then {again}")
    check("plain and fast reads at rest", fast, plain)
    for motor, (_, position) in plain.items():
        if abs(position - 2048 - 20 * motor) > 12:
            raise SystemExit(f"motor {motor} is at {position}, its goal was {2048 + 20 * motor}")
    client.sync_write(TORQUE, 1, dict.fromkeys(IDS, 0))


def rate(client, fast, seconds):
    times, failed, end = [], 0, time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        client.sync_write(GOAL, 4, dict.fromkeys(IDS, 2048))
        failed += client.sync_read(fast) is None
        times.append(time.perf_counter() - start)
    times.sort()
    middle = times[len(times) // 2] * 1e6
    print(f"{'fast' if fast else 'plain'} sync read: {len(times) / sum(times):.0f}/s, p50 {middle:.0f} us, failed {failed} of {len(times)}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=2.0, help="how long each rate is measured")
    parser.add_argument("--program", type=pathlib.Path, default=ROOT / "target/release/examples/leap_emulator")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        link = pathlib.Path(folder) / "leap"
        program = [arguments.program, str(link)]
        with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as emulator:
            try:
                emulator.stdout.readline()
                client = Client(link)
                talk(client)
                move(client)
                print("all answers are as they have to be")
                for fast in (False, True):
                    rate(client, fast, arguments.seconds)
            finally:
                emulator.stdin.close()


if __name__ == "__main__":
    main()
