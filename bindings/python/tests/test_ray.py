"""Batches by Ray on a local cluster of two workers: rows and bytes, lost workers, cancelled runs, twins where workers share no disk."""

import contextlib
import fcntl
import io
import math
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
import unittest
import unittest.mock

import numpy as np

import drex
from support import PROGRAM, TIN_MESH, Case, files, twins

# Before ray is imported. Its workers give way to all other programs unless told otherwise: on a busy machine they would get next to no time.
os.environ.update(RAY_USAGE_STATS_ENABLED="0", RAY_AUTH_MODE="disabled", RAY_worker_niceness="0")
try:
    import fsspec
    import pyarrow as pa
    import ray

    import drex.ray
except ImportError as error:
    print(f"skipped drex.ray: {error}")
    raise unittest.SkipTest(str(error)) from None

INIT = dict(address="local", num_cpus=2, object_store_memory=80 << 20, include_dashboard=False, log_to_driver=False, logging_level="error")
ROOT = pathlib.Path(__file__).resolve().parents[1]
#: Stages that take a moment.
QUICK = ["asset"]


def setUpModule():
    ray.init(**INIT, _temp_dir=short_folder(unittest.addModuleCleanup))
    unittest.addModuleCleanup(ray.shutdown)
    ray.data.DataContext.get_current().enable_progress_bars = False


def short_folder(clean):
    """A folder for a cluster: the paths of its sockets must be short."""
    folder = tempfile.mkdtemp(prefix="ray", dir="/tmp")
    clean(shutil.rmtree, folder, ignore_errors=True)
    return folder


def eventually(done, seconds=20):
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


def is_busy(twin):
    """Whether a process works on the twin."""
    with open(twin / "twin.toml") as manifest:
        try:
            fcntl.flock(manifest, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def alive(pid):
    try:
        return "Z" not in pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


class Folders(Case):
    def test_rows_and_tables_are_those_of_the_command_line(self):
        folder = twins(self.folder / "many", 8, broken=[5])
        other = shutil.copytree(folder, self.folder / "other")
        parts = []
        rows = drex.ray.run_twins(folder, stages=QUICK, progress=parts.append)
        self.assertEqual(rows.schema().base_schema, drex.ray.SCHEMA)
        rows = rows.take_all()
        self.assertEqual([row["name"] for row in rows], drex.Batch.open(folder).names)
        self.assertEqual({row["name"] for row in rows if row["status"] != "done"}, {"row1/tin-5"})
        self.assertRegex(rows[6]["error"], r"^row1/tin-5/twin.toml: \[object\] friction = -1")
        self.assertEqual((rows[6]["mass_kg"], rows[6]["hand"], rows[0]["held"]), (None, "", None))
        self.assertEqual(parts, sorted(parts))
        self.assertEqual((len(parts), parts[-1]), (8, 1.0))
        self.assertEqual({row["threads"] for row in rows}, {1})
        if not PROGRAM:
            return self.skipTest("DREX_PROGRAM does not name the command line")
        said = subprocess.run([PROGRAM, "batch", other, "--stages", *QUICK], capture_output=True, text=True)
        self.assertEqual(said.returncode, 1, said.stderr)
        shutil.rmtree(other / "batch" / "logs")
        self.assertEqual(files(folder), files(other))
        # Each finds done what the other did.
        said = subprocess.run([PROGRAM, "batch", folder, "--stages", *QUICK], capture_output=True, text=True)
        self.assertIn("7 are up to date", said.stderr)
        self.assertIn("1 failed before", said.stderr)
        self.assertEqual([r["name"] for r in drex.ray.run_twins(other, stages=QUICK, num_cpus=2).take_all() if r["threads"] == 2],
                         [row["name"] for row in rows])
        self.assertEqual(files(folder)["batch/results.csv"], files(other)["batch/results.csv"])

    def test_what_a_lost_worker_did_is_done_again(self):
        folder = twins(self.folder / "many", 6)
        other = shutil.copytree(folder, self.folder / "other")
        drex.ray.run_twins(other, stages=["grasps"])
        marks = self.folder / "marks"
        marks.mkdir()

        class Killed(drex.ray.RunTwin):
            """Is killed in the middle of one twin, once."""

            def run(self, request):
                begun = marks / str(os.getpid())
                begun.touch()
                if "tin-3" in request and not (marks / "killed").exists():
                    (marks / "killed").touch()
                    import threading

                    threading.Timer(0.2, os.kill, (os.getpid(), 9)).start()
                return super().run(request)

        rows = drex.ray.run_twins(folder, stages=["grasps"], runner=Killed).take_all()
        self.assertTrue((marks / "killed").exists())
        self.assertGreater(len(list(marks.iterdir())), 3, "three processes and the mark")
        self.assertEqual([row["name"] for row in rows], drex.Batch.open(folder).names)
        self.assertEqual({row["status"] for row in rows}, {"done"})
        self.assertEqual(files(folder), files(other))

    def test_a_twin_that_ends_its_workers_is_a_row(self):
        folder = twins(self.folder / "many", 4)
        marks = self.folder / "marks"
        marks.mkdir()

        class Dies(drex.ray.RunTwin):
            def run(self, request):
                if "tin-1" in request:
                    (marks / str(os.getpid())).touch()
                    os._exit(1)
                return super().run(request)

        rows = drex.ray.run_twins(folder, stages=QUICK, runner=Dies).take_all()
        self.assertEqual([row["status"] for row in rows], ["done", "done", "failed", "done"])
        self.assertRegex(rows[2]["error"], "^worker lost 3 times: ")
        self.assertEqual((rows[2]["name"], rows[2]["seed"], len(list(marks.iterdir()))), ("row1/tin-1", 1, 3))

    def test_a_twin_on_which_another_program_works_is_pending(self):
        folder = twins(self.folder / "many", 2)
        with open(folder / "row0" / "tin-0" / "twin.toml") as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            rows = drex.ray.run_twins(folder, stages=QUICK).take_all()
        self.assertEqual([row["status"] for row in rows], ["pending", "done"])
        self.assertIn("another drex is at work on", rows[0]["error"])
        table = (folder / "batch" / "results.csv").read_text().splitlines()
        self.assertEqual([line.split(",")[2] for line in table], ["status", "pending", "done"])
        rows = drex.ray.run_twins(folder, stages=QUICK).take_all()
        self.assertEqual([row["status"] for row in rows], ["done", "done"])

    def test_a_run_that_is_stopped_ends_its_workers_and_goes_on(self):
        marks = self.folder / "marks"

        class Marked(drex.ray.RunTwin):
            def run(self, request):
                (marks / str(os.getpid())).touch()
                return super().run(request)

        def work(folder):
            return drex.ray.run_twins(folder, stages=["grasps"], runner=Marked)

        def stop(part):
            raise KeyboardInterrupt

        def by_interrupt(folder):

            with self.assertRaises(KeyboardInterrupt):
                drex.ray.run_twins(folder, stages=["grasps"], runner=Marked, progress=stop)
            self.assertFalse(any(map(is_busy, folder.glob("*/*"))))

        def by_cancel(folder):
            job = ray.remote(num_cpus=0)(work).remote(folder)
            self.assertTrue(eventually(lambda: len(list(marks.iterdir())) == 2))
            ray.cancel(job)
            with self.assertRaises(ray.exceptions.RayError):
                ray.get(job)

        def by_kill(folder):
            actor = ray.remote(Marked).remote()
            job = actor.run.remote(drex.Batch.open(folder).requests(["grasps"])[0])
            self.assertTrue(eventually(lambda: any(marks.iterdir())))
            ray.kill(actor)
            with self.assertRaises(ray.exceptions.ActorDiedError):
                ray.get(job)

        other = twins(self.folder / "other", 3)
        drex.ray.run_twins(other, stages=["grasps"])
        # When nothing is running any more.
        with self.assertRaises(KeyboardInterrupt):
            drex.ray.run_twins(other, stages=["grasps"], concurrency=1, progress=lambda part: part == 1 and stop(part))
        for end in [by_interrupt, by_cancel, by_kill]:
            with self.subTest(end.__name__):
                folder = twins(self.folder / end.__name__, 3)
                shutil.rmtree(marks, ignore_errors=True)
                marks.mkdir()
                end(folder)
                self.assertTrue(any(marks.iterdir()))
                # Workers may live, with nothing to do.
                self.assertTrue(eventually(lambda: not any(map(is_busy, folder.glob("*/*")))))
                self.assertFalse((folder / "batch").exists())
                rows = drex.ray.run_twins(folder, stages=["grasps"]).take_all()
                self.assertEqual({row["status"] for row in rows}, {"done"}, rows)
                self.assertEqual(files(folder), files(other))

    def test_a_driver_that_is_killed_leaves_nothing(self):
        folder = twins(self.folder / "many", 3, epochs=1000000)
        script = textwrap.dedent(f"""
            import os, ray, drex.ray
            ray.init(**{INIT!r}, _temp_dir={short_folder(self.addCleanup)!r})

            class Marked(drex.ray.RunTwin):
                def run(self, request):
                    open({str(self.folder)!r} + f"/pid-{{os.getpid()}}", "w").close()
                    return super().run(request)

            drex.ray.run_twins({str(folder)!r}, stages=["train"], runner=Marked)
        """)
        with subprocess.Popen([sys.executable, "-c", script]) as driver:
            # Two of them learn, for an hour.
            self.assertTrue(eventually(lambda: len(list(folder.glob("*/*/grasps/wrist_fits.json"))) == 2, 120))
            workers = [path.name[4:] for path in self.folder.glob("pid-*")]
            self.assertEqual((len(workers), all(map(alive, workers))), (2, True))
            driver.send_signal(signal.SIGKILL)
        self.assertTrue(eventually(lambda: not any(map(alive, workers))), workers)
        rows = drex.ray.run_twins(folder, stages=["identify", "grasps"]).take_all()
        other = twins(self.folder / "other", 3, epochs=1000000)
        drex.ray.run_twins(other, stages=["identify", "grasps"])
        self.assertEqual({row["status"] for row in rows}, {"done"}, rows)
        self.assertEqual(files(folder), files(other))


class Pipelines(Case):
    def test_twins_are_mapped(self):
        folder = twins(self.folder / "many", 3, broken=[1])
        items = [{"twin": str(twin), "lab": "ours"} for twin in sorted(folder.glob("*/*"))]
        rows = ray.data.from_items(items, override_num_blocks=3).map(
            drex.ray.RunTwin,
            fn_constructor_kwargs={"stages": QUICK},
            compute=ray.data.ActorPoolStrategy(size=1, max_tasks_in_flight_per_actor=1),
            num_cpus=2,
        )
        types = [block.schema for block in ray.get(rows.to_arrow_refs())]
        self.assertEqual([schema.field(field.name) for schema in types for field in drex.ray.SCHEMA], list(drex.ray.SCHEMA) * 3)
        rows = sorted(rows.take_all(), key=lambda row: row["name"])
        self.assertEqual([row["status"] for row in rows], ["done", "done", "failed"])
        self.assertEqual([(row["twin"], row["lab"]) for row in rows], [(item["twin"], "ours") for item in items])
        self.assertEqual([row["name"] for row in rows], [item["twin"] for item in items])
        self.assertEqual([row["threads"] for row in rows], [2, 2, 2])
        self.assertTrue(rows[2]["error"].startswith("tin-1/twin.toml: "), rows[2]["error"])

    def test_grasps_are_found(self):
        batch = {
            "mesh": [str(TIN_MESH)] * 4,
            "mass_kg": [0.2, 50.0, 0.2, math.nan],
            "hand": ["leap_right", "leap_right", "nobody", "leap_right"],
            "shelf": [1, 2, 3, 4],
        }
        found = drex.ray.FindGrasps(candidates=2000, simulated=2, trials=2, threads=1)(batch)
        rows = found.to_pylist()
        self.assertEqual([row["verdict"] for row in rows], ["found", "none", "", ""])
        self.assertEqual([row["status"] for row in rows], ["done", "done", "failed", "failed"])
        self.assertIn("nobody", rows[2]["error"])
        self.assertRegex(rows[3]["error"], "mass")
        self.assertEqual([row["shelf"] for row in rows], [1, 2, 3, 4])
        self.assertIn('"hand": "leap_right"', rows[0]["grasp"])
        self.assertEqual((rows[0]["name"], rows[1]["grasp"]), (str(TIN_MESH), ""))
        # The same by an actor.
        items = [{name: values[i] for name, values in batch.items()} for i in range(4)]
        mapped = ray.data.from_items(items, override_num_blocks=4).map_batches(
            drex.ray.FindGrasps,
            fn_constructor_kwargs=dict(candidates=2000, simulated=2, trials=2),
            batch_size=1,
            compute=ray.data.ActorPoolStrategy(size=1),
        )
        same = ["name", "verdict", "grip_force_n", "held", "grasp", "shelf"]
        mapped = sorted(mapped.take_all(), key=lambda row: row["shelf"])
        self.assertEqual([[row[name] for name in same] for row in mapped], [[row[name] for name in same] for row in rows])


class Documents(Case):
    """What the README and the examples say."""

    def setUp(self):
        super().setUp()
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(self.folder)

    def test_the_readme(self):
        blocks = re.findall(r"^```python ray\n(.*?)^```", (ROOT / "README.md").read_text(), re.S | re.M)
        self.assertEqual(len(blocks), 1)
        twins(pathlib.Path("shelf"), 2)
        with contextlib.redirect_stdout(io.StringIO()) as said:
            exec(blocks[0], {})
        self.assertRegex(said.getvalue(), r"row0/tin-0 +done +0.2\D")

    def test_many_grasps(self):
        script = (ROOT / "examples" / "many_grasps.py").read_text()
        effort = "candidates=4000, simulated=4"
        self.assertIn(effort, script)
        script = script.replace(effort, "candidates=1000, simulated=1, trials=2").replace('"allegro_right"', '"nobody"')
        with unittest.mock.patch("sys.argv", ["many_grasps.py", str(TIN_MESH)]):
            with contextlib.redirect_stdout(io.StringIO()) as said:
                exec(script, {})
        lines = said.getvalue().splitlines()
        self.assertEqual(len(lines), 4, lines)
        self.assertTrue(all(line.startswith(TIN_MESH.name) for line in lines), lines)
        self.assertEqual(sum("nobody" in line and "held None" in line for line in lines), 2, lines)


class Elsewhere(Case):
    """Twins that only a URL names."""

    def test_a_folder_by_its_url(self):
        folder = twins(self.folder / "many", 4, broken=[2])
        (folder / "row1" / "tin-3" / "scan" / "tin.obj").write_text("v 0 0")
        other = shutil.copytree(folder, self.folder / "other")
        url = f"file://{folder}"
        rows = drex.ray.run_twins(url, stages=QUICK).take_all()
        drex.ray.run_twins(other, stages=QUICK)
        self.assertEqual([row["status"] for row in rows], ["done", "failed", "done", "failed"])
        self.assertEqual(files(folder), files(other))
        with self.assertRaisesRegex(drex.Error, "holds no twin"):
            drex.ray.run_twins(f"file://{self.folder}/nowhere")
        # What is up to date is only copied, and tables may go to this machine.
        before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
        drex.ray.run_twins(url, stages=QUICK, out=self.folder / "out")
        self.assertEqual({path: path.stat().st_mtime_ns for path in folder.rglob("*")}, before)
        self.assertEqual((self.folder / "out" / "results.csv").read_bytes(), files(folder)["batch/results.csv"])

    def test_a_copy_that_is_interrupted_is_not_done(self):
        folder = twins(self.folder / "many", 1) / "row0" / "tin-0"
        memory = fsspec.filesystem("memory")
        self.addCleanup(memory.rm, "/lab", recursive=True)
        memory.put(str(folder), "/lab/tin", recursive=True)
        run = drex.ray.RunTwin(QUICK)
        put, copied = memory.put, []

        def some(sources, targets):
            """Breaks off before the lock."""
            if targets and targets[0].endswith("twin.lock"):
                raise OSError("the line is down")
            copied.extend(targets)
            put(sources, targets)

        memory.put = some
        self.addCleanup(lambda: vars(memory).pop("put", None))
        row = run({"twin": "memory://lab/tin"})
        self.assertEqual((row["status"].as_py(), row["error"].as_py()), ("failed", "OSError: the line is down"))
        self.assertTrue(any(name.endswith("asset/object.xml") for name in copied) and not memory.exists("/lab/tin/twin.lock"))
        del memory.put
        row = run({"twin": "memory://lab/tin"})
        self.assertEqual((row["status"].as_py(), row["mass_kg"].as_py()), ("done", 0.2))
        # The same bytes as on a disk; and what a run removes is removed there.
        drex.Twin.open(folder).run(QUICK)
        memory.get("/lab/tin", str(self.folder / "back"), recursive=True)
        self.assertEqual(files(self.folder / "back"), files(folder))
        self.assertEqual(run({"twin": "memory://lab/nowhere"})["status"].as_py(), "failed")

    def test_no_file_is_written_outside(self):
        memory = fsspec.filesystem("memory")
        self.addCleanup(memory.rm, "/bad", recursive=True)
        memory.store["/bad/tin/../../../evil"] = memory.open("/bad/tin/twin.toml", "wb")
        self.addCleanup(memory.store.pop, "/bad/tin/../../../evil", None)
        row = drex.ray.RunTwin(QUICK)({"twin": "memory://bad/tin"})
        self.assertRegex(row["error"].as_py(), r"evil.* leads out of")


class Numbers(Case):
    def test_no_number_is_lost_on_the_way(self):
        folder = twins(self.folder / "many", 1)
        [request] = drex.Batch.open(folder).requests(QUICK)
        row = dict(drex.Runner(1).run(request), seed=2**64 - 1, mass_kg=float(np.nextafter(0.1, 1)), peak_memory_bytes=None)
        [back] = pa.Table.from_pylist([row], drex.ray.SCHEMA).to_pylist()
        self.assertEqual(back, row)


if __name__ == "__main__":
    unittest.main()
