"""Memory of many small identifications: in this process by one Runner, then in one Ray actor by one RunTwin, where Ray is there.

    python bindings/python/tests/memory.py [COUNT]

Each is the stage identify of one twin with another seed: a box of 100 g on a table, pulled up by a known force for 0.3 s. Prints what is resident
after a tenth of them and after all; exit status 1 if that is more than 1.2 times as much. A thousand take about two minutes on one core.
"""

import os
import pathlib
import sys
import tempfile
import time

import numpy as np

import drex

#: Where the middle of the box is in the beginning: it stands on the table.
HEIGHT_M = 0.025
#: Most that may be resident at the end, over what was after a tenth.
MOST = 1.2


def box_twin(folder):
    """A folder with the one twin."""
    twin = folder / "box"
    twin.mkdir()
    corners = [[(i >> axis & 1) * 0.05 - 0.025 for axis in range(3)] for i in range(8)]
    faces = ["1 3 4", "1 4 2", "5 6 8", "5 8 7", "1 2 6", "1 6 5", "3 7 8", "3 8 4", "1 5 7", "1 7 3", "2 4 8", "2 8 6"]
    lines = ["v {} {} {}".format(*corner) for corner in corners] + [f"f {face}" for face in faces]
    (twin / "box.obj").write_text("\n".join(lines) + "\n")
    times_s = np.arange(20) / 60
    force = dict(force_times_s=[0.0, 0.2], forces_n=[[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
    asset = drex.mesh_asset(twin / "box.obj", unit="m", mass_kg=0.1)
    motion = drex.simulate(asset, times_s=times_s, point_in_object_m=[0.0, 0.0, 0.0], **force)
    rows = np.column_stack([times_s, motion.poses + [0, 0, HEIGHT_M, 0, 0, 0, 0]]).tolist()
    (twin / "poses.csv").write_text("t,x,y,z,qw,qx,qy,qz\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    (twin / "force.csv").write_text("t,fx,fy,fz\n0,0,0,2\n0.2,0,0,0\n")
    (twin / "push.toml").write_text(f"""
        schema = 1
        name = "pull"
        mesh = "box.obj"
        gravity_m_s2 = [0.0, 0.0, -9.81]
        mass_prior_kg = 0.2
        [track]
        file = "poses.csv"
        format = "pose_csv"
        frame = "world"
        [track.clock]
        kind = "relative"
        [start]
        at_rest = true
        time_s = 0.0
        [start.pose]
        position_m = [0.0, 0.0, {HEIGHT_M}]
        quat_wxyz = [1.0, 0.0, 0.0, 0.0]
        [force]
        file = "force.csv"
        point_in_object_m = [0.0, 0.0, 0.0]
        [force.clock]
        kind = "relative"
    """)
    (twin / "twin.toml").write_text("""
        schema = 1
        name = "box"
        [object]
        mesh = "box.obj"
        [mass]
        identify = ["."]
        prior_kg = 0.2
    """)
    return folder


def resident_mb():
    """What this process holds, MB."""
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(run, requests):
    """What is resident after a tenth of the requests and after all, MB, and the seconds that they took."""
    begin = time.monotonic()
    for done, request in enumerate(requests, 1):
        row = run(request)
        assert row["status"] == "done" and row["verdict"] == "identified", row
        if done == max(1, len(requests) // 10):
            early = resident_mb()
    return early, resident_mb(), time.monotonic() - begin


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as folder:
        batch = drex.Batch.open(box_twin(pathlib.Path(folder)))
        requests = [batch.requests(["identify"], seed)[0] for seed in range(count)]
        found = {"one process": measure(drex.Runner(threads=1).run, requests)}
        try:
            import ray

            from drex.ray import RunTwin
        except ImportError as error:
            print(f"skipped the Ray actor: {error}")
        else:

            class Measured(RunTwin):
                def measure(self, requests):
                    return measure(self.run, requests)

            ray.init(address="local", num_cpus=1, object_store_memory=80 << 20, include_dashboard=False, logging_level="error")
            found["one Ray actor"] = ray.get(ray.remote(Measured).remote().measure.remote(requests))
        for what, (early, late, seconds) in found.items():
            print(f"{what}: {count} in {seconds:.0f} s; {early:.1f} MB after {count // 10}, {late:.1f} MB in the end, {late / early:.3f} times")
        sys.exit(any(late > MOST * early for early, late, _ in found.values()))


if __name__ == "__main__":
    main()
