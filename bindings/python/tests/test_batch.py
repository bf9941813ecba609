"""Batches done in this process: requests, rows, tables, interrupts."""

import json
import math
import os
import pathlib
import shutil
import subprocess
import threading
import unittest

import drex
from support import DATA, PROGRAM, TIN_MESH, Case, files, twins


class Batches(Case):
    def test_rows_and_tables_are_those_of_the_command_line(self):
        folder = twins(self.folder / "many", 4, broken=[2])
        batch = drex.Batch.open(folder)
        self.assertEqual(batch.names, ["row0/tin-0", "row0/tin-2", "row1/tin-1", "row1/tin-3"])
        self.assertEqual(batch.out, folder / "batch")
        runner = drex.Runner(threads=1)
        self.assertEqual(runner.threads, 1)
        notes, parts = [], []
        rows = [runner.run(request, parts.append, note=notes.append) for request in batch.requests(["asset"])]
        self.assertEqual([row["name"] for row in rows], batch.names)
        self.assertEqual([row["status"] for row in rows], ["done", "failed", "done", "done"])
        self.assertEqual((rows[0]["mass_kg"], rows[0]["mass_source"], rows[0]["held"]), (0.2, "weighed", None))
        self.assertRegex(rows[1]["error"], r"^row0/tin-2/twin.toml: \[object\] friction = -1")
        self.assertEqual((rows[0]["threads"], rows[0]["host"]), (1, os.uname().nodename))
        self.assertTrue(any("asset  done" in line for line in notes) and parts[-1] == 1.0, (notes, parts))
        self.assertLessEqual(rows[0]["core_seconds"], rows[0]["seconds"] + 0.1)
        self.assertGreater(rows[0]["peak_memory_bytes"], 1e6)
        self.assertEqual(batch.record(rows), folder / "batch" / "results.csv")
        table = (folder / "batch" / "results.csv").read_text()
        self.assertEqual([line.split(",")[0] for line in table.splitlines()], ["name", *batch.names])

        # What is up to date stays, and another seed is another twin.
        again = [drex.Runner(threads=2).run(request) for request in batch.requests(["asset"])]
        steady = drex.Batch.open(folder).record(again).read_text()
        self.assertEqual(steady, table)
        self.assertEqual([row["threads"] for row in again], [2] * 4)
        runs = (folder / "batch" / "runs.csv").read_text().splitlines()
        self.assertEqual([line.split(",")[1] for line in runs], ["attempts", "2", "2", "2", "2"])
        self.assertEqual(runner.run(batch.requests(["identify"], seed=7)[0])["seed"], 7)
        if PROGRAM:
            command = [PROGRAM, "batch", folder, "--stages", "asset"]
            before = files(folder / "row1")
            said = subprocess.run(command, capture_output=True, text=True)
            self.assertEqual(said.returncode, 1, said.stderr)
            # All but the twin that has another seed since.
            self.assertIn("2 are up to date", said.stderr)
            self.assertIn("1 failed before", said.stderr)
            self.assertEqual(files(folder / "row1"), before)
            self.assertEqual((folder / "batch" / "results.csv").read_text(), table)

    def test_grasps_are_found_once(self):
        shutil.copy(TIN_MESH, self.folder / "tin.obj")
        (self.folder / "objects.toml").write_text(
            'schema = 1\n[[grasps]]\nmeshes = ["tin.obj"]\nmasses_kg = [0.2, 50]\nhands = ["leap_right"]\n'
            "candidates = 2000\nsimulated = 2\ntrials = 2\n"
        )
        batch = drex.Batch.open(self.folder / "objects.toml", self.folder / "found")
        runner = drex.Runner()
        rows = [runner.run(request) for request in batch.requests()]
        self.assertEqual([row["verdict"] for row in rows], ["found", "none"])
        file = self.folder / "found" / "grasps" / "tin-leap_right-0.2kg.json"
        self.assertEqual(json.loads(file.read_text())["grip_force_n"], rows[0]["grip_force_n"])
        before = file.stat().st_mtime_ns
        again = [drex.Runner().run(request) for request in batch.requests()]
        steady = [name for name in rows[0] if name not in {"ended_unix_s", "seconds", "core_seconds", "peak_memory_bytes"}]
        for row, once in zip(again, rows):
            self.assertEqual({name: row[name] for name in steady}, {name: once[name] for name in steady})
        self.assertEqual(file.stat().st_mtime_ns, before)
        self.assertNotEqual(runner.run(batch.requests(seed=3)[0])["seed"], rows[0]["seed"])
        self.assertNotEqual(file.stat().st_mtime_ns, before)

    def test_what_is_kept_is_not_taken_for_another(self):
        runner = drex.Runner()
        effort = "masses_kg = [0.2]\ncandidates = 1000\nsimulated = 1\ntrials = 1\n"

        def found(name, rest):
            folder = self.folder / name
            folder.mkdir()
            (folder / "list.toml").write_text(f'schema = 1\n[[grasps]]\nmeshes = ["{TIN_MESH}"]\n{effort}{rest}')
            return lambda: runner.run(drex.Batch.open(folder / "list.toml").requests()[0])

        # A hand of the same name beside another list, and the same mesh in another unit.
        with_hand = found("with", 'hands = ["hand.xml"]')
        shutil.copy(DATA.parent / "crates" / "drex-robot" / "models" / "leap_right.xml", self.folder / "with" / "hand.xml")
        self.assertEqual(with_hand()["verdict"], "found")
        self.assertIn("hand.xml", found("without", 'hands = ["hand.xml"]')()["error"])
        self.assertNotEqual(found("tiny", 'unit = "mm"\nhands = ["leap_right"]')()["verdict"], "found")

    def test_a_lost_item_has_a_row(self):
        folder = twins(self.folder / "many", 2)
        batch = drex.Batch.open(folder, out=self.folder / "out")
        row = drex.Runner.failed(batch.requests()[1], f"worker lost: {folder}/row1/x")
        self.assertEqual((row["name"], row["status"], row["seed"]), ("row1/tin-1", "failed", 1))
        self.assertEqual(row["error"], "worker lost: row1/x")
        # Items without a row are pending.
        self.assertEqual(
            [line.split(",")[2] for line in batch.record([row]).read_text().splitlines()], ["status", "pending", "failed"]
        )

    def test_an_interrupted_item_goes_on(self):
        folder = twins(self.folder / "many", 1, epochs=100000)
        [request] = drex.Batch.open(folder).requests(["train"])
        runner = drex.Runner(threads=1)

        class Enough(Exception):
            pass

        def stop(part):
            if part > 0.5:
                raise Enough

        with self.assertRaises(Enough):
            runner.run(request, stop)
        # The next call waits for the one that was stopped.
        [request] = drex.Batch.open(folder).requests(["identify"])
        self.assertEqual(runner.run(request)["status"], "done")
        self.assertFalse([path for path in folder.rglob("*") if ".tmp" in path.name])

    def test_what_is_no_batch_is_refused(self):
        folder = twins(self.folder / "many", 1)
        batch = drex.Batch.open(folder)
        with self.assertRaisesRegex(drex.Error, "is one twin"):
            drex.Batch.open(folder / "row0" / "tin-0")
        with self.assertRaisesRegex(drex.Error, 'no stage "identfy"'):
            batch.requests(["identfy"])
        for threads in [0, 10**9]:
            with self.assertRaisesRegex(drex.Error, f"threads = {threads}"):
                drex.Runner(threads)
        for request in ["", "{}", "[]", json.dumps({"item": 1})]:
            with self.assertRaisesRegex(drex.Error, "this is no request"):
                drex.Runner(1).run(request)
            with self.assertRaisesRegex(drex.Error, "this is no request"):
                drex.Runner.failed(request, "")
        row = drex.Runner.failed(batch.requests()[0], "lost")
        for rows in [[{}], row, [dict(row, seed=-1)], [dict(row, seconds=math.nan)], [dict(row, status="gone")]]:
            with self.assertRaisesRegex(drex.Error, "these are no rows of a batch"):
                batch.record(rows)
        self.assertFalse((folder / "batch").exists())

    def test_threads_are_its_own(self):
        folder = twins(self.folder / "many", 1)
        names = set()

        def watch(_):
            tasks = pathlib.Path("/proc/self/task").glob("*/comm")
            names.update(name for name in (task.read_text().strip() for task in tasks) if name.startswith("drex-"))

        drex.Runner(threads=3).run(drex.Batch.open(folder).requests(["grasps"])[0], watch)
        if pathlib.Path("/proc/self/task").exists():
            self.assertEqual(names, {"drex-0", "drex-1", "drex-2"})
        self.assertEqual(threading.active_count(), 1)


if __name__ == "__main__":
    unittest.main()
