"""Many objects by Ray: a row for each twin or grasp, on one machine or on a cluster.

    pip install 'drex[ray]'

``run_twins`` does a folder of twins or a list, as ``drex batch`` does, and writes the same tables. ``RunTwin`` and ``FindGrasps`` are callables
for ``map`` and ``map_batches`` of pipelines of one's own. Twins stay files, paths travel. A row has the columns of ``SCHEMA``, whatever became
of its item: texts are empty and numbers null where there are none, and "error" says why an item failed.

The folders must be where all workers see them; where workers share no disk, a twin may be named by a URL that fsspec knows ("s3://...",
"gs://...", "memory://..."). It is then copied to a temporary folder, and what changed is copied back with twin.lock last, so that a run goes on
where a copy was interrupted. All that its twin.toml names must then lie in its folder, and nothing keeps two programs from doing one twin.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

try:
    # Not all are typed, and mypy reads this file also where they are not installed.
    import pyarrow as pa  # type: ignore[import-not-found, import-untyped, unused-ignore]
    import ray  # type: ignore[import-not-found, unused-ignore]
    import ray.data  # type: ignore[import-not-found, unused-ignore]

    from ._remote import listed, local_request
except ImportError:
    raise ImportError("drex.ray needs Ray's data sets: pip install 'ray[data]>=2.40'")

from . import Batch, Busy, Error, Runner

if TYPE_CHECKING:
    from ._drex import _Stage

__all__ = ["SCHEMA", "FindGrasps", "RunTwin", "run_twins"]

_TEXT, _NUMBER, _COUNT = pa.string(), pa.float64(), pa.uint64()
#: Names and types of the columns: those of results.csv, and those of runs.csv.
SCHEMA = pa.schema(
    [("name", _TEXT), ("task", _TEXT), ("status", _TEXT)]
    + [("mass_kg", _NUMBER), ("mass_low_kg", _NUMBER), ("mass_high_kg", _NUMBER), ("mass_source", _TEXT)]
    + [("verdict", _TEXT), ("hand", _TEXT), ("friction", _NUMBER), ("proposed", _COUNT), ("passed", _COUNT)]
    + [("grip_force_n", _NUMBER), ("held", _COUNT), ("trials", _COUNT)]
    + [("success_rate", _NUMBER), ("success_low", _NUMBER), ("success_high", _NUMBER)]
    + [("seed", _COUNT), ("program", _TEXT), ("error", _TEXT)]
    + [("ended_unix_s", _NUMBER), ("seconds", _NUMBER), ("core_seconds", _NUMBER)]
    + [("peak_memory_bytes", _COUNT), ("threads", _COUNT), ("host", _TEXT)]
)
#: How often an item is tried again whose worker was lost, or on which another program was at work.
RETRIES = 2
#: How long workers that were told to end are waited for.
_FAREWELL_S = 20.0
#: The runners of this worker, by their classes and threads.
_KEPT: dict[tuple[type[RunTwin], int | None], RunTwin] = {}
#: Most tasks that Ray holds at a time.
_MOST_TASKS = 2000


def run_twins(
    folder_or_list: str | os.PathLike[str],
    *,
    stages: Sequence[_Stage] | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] | None = None,
    num_cpus: int = 1,
    concurrency: int | None = None,
    progress: Callable[[float], object] | None = None,
    runner: type[RunTwin] | None = None,
) -> ray.data.Dataset:
    """Does every item of a folder of twins, of a list file, or of a folder of twins that is given by its URL, and returns their rows.

    There is one row for each item, in the order of their names, also for one that failed. An item whose worker was lost (killed, out of memory,
    node gone) is done again, twice at most; then its row is failed, with "worker lost". One on which another program is at work is tried again
    after the others; then it is pending. What is up to date is not done again.

    Stages and seed are those of ``Batch.requests``. Each item takes ``num_cpus`` of the cluster's and has as many threads; ``concurrency`` is how
    many items are done at a time (as many as the cluster has room for if left out). ``out`` is a folder of this machine for the tables
    results.csv and runs.csv, as for ``Batch.open``; for twins that are given by URL they go to the folder "batch" there if it is left out.
    ``progress`` is called with the part of the items that are done, from 0 to 1. ``runner`` is a class in place of ``RunTwin``.

    Ctrl-C, or whatever else ends the call, ends the workers at once, and another call goes on from there.
    """
    with listed(os.fspath(folder_or_list), out) as (batch, moved):
        requests = batch.requests(stages, seed)
        results = _results([moved(request) for request in requests], runner or RunTwin, num_cpus, concurrency, progress)
        rows = [row if isinstance(row, dict) else Runner.failed(requests[i], row) for i, row in enumerate(results)]
        batch.record([row for row in rows if row["status"] != "pending"])
    return ray.data.from_arrow(pa.Table.from_pylist(rows, SCHEMA))


class RunTwin:
    """Runs twins one after the other; for ``ray.data.Dataset.map``, where "twin" is the column of their folders or URLs.

    ``stages`` and ``seed`` are those of ``Batch.requests``. An actor has as many threads as its ``num_cpus`` unless ``threads`` says how many, and
    keeps hands and meshes loaded. A failure is a row; for lost workers Ray's rules hold, not those of ``run_twins``.
    """

    def __init__(self, stages: Sequence[_Stage] | None = None, seed: int | None = None, threads: int | None = None) -> None:
        self._stages, self._seed = stages if stages is None else list(stages), seed
        self._runner = Runner(threads or _assigned_cpus())

    def __call__(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Runs the twin of the row, and returns the row with the columns of ``SCHEMA``; "name" is the twin."""
        twin = os.fspath(row["twin"])
        base = os.path.dirname(twin.rstrip("/"))
        request = _request(twin, {"twin": twin}, base, base, stages=self._stages, seed=self._seed)
        made = self.run(request)
        return {**row, **{field.name: pa.scalar(made[field.name], field.type) for field in SCHEMA}}

    def run(self, request: str) -> dict[str, Any]:
        """Does one of ``Batch.requests``, whose twin may be named by a URL, and returns its row. Only an interrupt is an exception."""
        return _row(self._runner, request)


class FindGrasps:
    """Finds grasps, for ``ray.data.Dataset.map_batches``: its columns are "mesh" (file), "mass_kg" and "hand" (bundled, or a file).

    The options are those of ``find_grasp`` and the unit of the meshes ("m", "cm" or "mm"). A batch comes back with the columns of ``SCHEMA``, where
    "verdict" is "found" or "none" and "name" the mesh, and "grasp", a JSON text with the hand, its joints, the pose of its base and the contacts.
    An actor has as many threads as its ``num_cpus`` unless ``threads`` says how many, and keeps hands and the last mesh loaded.
    """

    def __init__(
        self,
        *,
        unit: str = "m",
        friction: float | None = None,
        torque_cap_nm: float | None = None,
        seed: int = 0,
        candidates: int | None = None,
        simulated: int | None = None,
        trials: int | None = None,
        threads: int | None = None,
    ) -> None:
        self._options = dict(unit=unit, friction=friction, torque_cap_nm=torque_cap_nm, seed=seed)
        self._options.update(candidates=candidates, simulated=simulated, trials=trials)
        self._runner = Runner(threads or _assigned_cpus())

    def __call__(self, batch: Mapping[str, Any]) -> pa.Table:
        """Finds a grasp for each row of the batch."""
        rows = []
        for mesh, mass_kg, hand in zip(batch["mesh"], batch["mass_kg"], batch["hand"]):
            with tempfile.TemporaryDirectory() as out:
                # What is no mass is none of nothing, and refused.
                known = isinstance(mass_kg, (int, float, np.number)) and math.isfinite(mass_kg)
                task = dict(self._options, mesh=str(mesh), mass_kg=float(mass_kg) if known else 0.0, hand=str(hand))
                row = _row(self._runner, _request("found", {"find": task}, "", out))
                file = Path(out) / "grasps" / "found.json"
                found = json.loads(file.read_text())["grasp"] if file.exists() else None
            rows.append(dict(row, name=str(mesh), hand=str(hand), grasp=json.dumps(found) if found else ""))
        table = pa.Table.from_pylist(rows, SCHEMA.append(pa.field("grasp", _TEXT)))
        for name in batch:
            if name not in table.column_names:
                table = table.append_column(name, pa.array(batch[name]))
        return table


def _row(runner: Runner, request: str) -> dict[str, Any]:
    """What a runner answers to a request, whose twin may be named by a URL, or why it does not."""
    try:
        with local_request(request) as here:
            return runner.run(here)
    except (KeyboardInterrupt, SystemExit):
        raise
    except Busy as error:
        return dict(Runner.failed(request, str(error)), status="pending")
    except BaseException as error:  # a panic is none of Exception
        return Runner.failed(request, str(error) if isinstance(error, Error) else f"{type(error).__name__}: {error}")


def _request(
    name: str, task: dict[str, Any], base: str, out: str, *, stages: Sequence[_Stage] | None = None, seed: int | None = None
) -> str:
    item = {"name": name, "task": task}
    return json.dumps({"item": item, "base": base, "out": out, "stages": stages, "seed": seed, "max_memory_bytes": None})


def _assigned_cpus() -> int | None:
    """Cores that Ray gives this worker, at least one; None where this process is no worker."""
    if ray.is_initialized():
        with contextlib.suppress(AssertionError):  # that of a process that is no worker
            return max(1, int(ray.get_runtime_context().get_assigned_resources().get("CPU", 1)))
    return None


def _run(runner: type[RunTwin], request: str) -> dict[str, Any]:
    """What a worker does; its process keeps the runner for the next item."""
    key = (runner, _assigned_cpus())
    if key not in _KEPT:
        _KEPT[key] = runner(threads=key[1])
    try:
        return _KEPT[key].run(request)
    except KeyboardInterrupt:  # a call of ray.cancel
        # The work goes on beside the interpreter until it hears of it, which may take a stage: with the process it ends now.
        os._exit(1)


def _results(
    requests: list[str],
    runner: type[RunTwin],
    num_cpus: int,
    concurrency: int | None,
    progress: Callable[[float], object] | None,
) -> list[dict[str, Any] | str]:
    """The row of each request, or why its workers were lost."""
    # Ray would do an item again for ever whose workers run out of memory.
    task = ray.remote(_run).options(num_cpus=num_cpus, max_retries=0)
    results: list[dict[str, Any] | str] = [""] * len(requests)
    todo = deque((i, 0) for i in range(len(requests)))
    running: dict[Any, tuple[int, int]] = {}
    done = 0
    try:
        while todo or running:
            while todo and len(running) < (concurrency or _MOST_TASKS):
                i, tried = todo.popleft()
                running[task.remote(runner, requests[i])] = (i, tried)
            [reference], _ = ray.wait(list(running))
            i, tried = running.pop(reference)
            try:
                results[i] = row = ray.get(reference)
                again = row["status"] == "pending"
            except ray.exceptions.RayError as error:
                why = error.cause if isinstance(error, ray.exceptions.RayTaskError) else str(error).strip().split("\n")[0]
                results[i] = f"worker lost {tried + 1} times: {why}"
                again = True
            if again and tried < RETRIES:
                todo.append((i, tried + 1))
                continue
            done += 1
            if progress:
                progress(done / len(requests))
    finally:
        # Nothing, unless something was raised. Workers work on their twins until they are gone.
        for reference in running:
            ray.cancel(reference, force=True)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=_FAREWELL_S)
    return results
