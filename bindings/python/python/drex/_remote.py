"""Twins that a URL names, for workers that share no disk: copied to a folder of this machine, and what changed copied back."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

# It is not typed, and mypy reads this file also where it is not installed.
import fsspec  # type: ignore[import-not-found, import-untyped, unused-ignore]

from . import Batch, Error


#: What changes when a file is written: when, ns, and how long it is, bytes.
_Stamp = tuple[int, int]


@contextlib.contextmanager
def listed(path: str, out: str | os.PathLike[str] | None) -> Iterator[tuple[Batch, Callable[[str], str]]]:
    """The batch, and what its requests are for workers. What is given by URL is listed by its manifests, in a temporary folder."""
    if "://" not in path:
        # Workers have other working directories.
        yield Batch.open(os.path.abspath(path), out and os.path.abspath(out)), str
        return
    base = path.rstrip("/")

    def moved(request: str) -> str:
        content = json.loads(request)
        content["item"]["task"] = {"twin": f"{base}/{content['item']['name']}"}
        return json.dumps(dict(content, base=base))

    with tempfile.TemporaryDirectory() as folder:
        if not _copy_in(base, Path(folder), "/twin.toml"):
            raise Error(f"{path} holds no twin: a twin is a folder with a twin.toml")
        batch = Batch.open(folder, out)
        before = {} if out else _copy_in(f"{base}/batch", batch.out)
        yield batch, moved
        if not out:
            _copy_out(batch.out, f"{base}/batch", before)


@contextlib.contextmanager
def local_request(request: str) -> Iterator[str]:
    """The request, with a twin that is named by a URL in a folder of this machine."""
    content = json.loads(request)
    url = content["item"]["task"].get("twin", "")
    if "://" not in url:
        yield request
        return
    with tempfile.TemporaryDirectory() as base:
        twin = Path(base) / url.removeprefix(content["base"]).strip("/")
        before = _copy_in(url, twin)
        content["item"]["task"] = {"twin": str(twin)}
        yield json.dumps(dict(content, base=base))
        _copy_out(twin, url, before)


def _copy_in(url: str, folder: Path, wanted: str = "") -> dict[str, _Stamp]:
    """Copies the files below a URL whose names end like that into a folder, and returns what `_files` says of it."""
    system, root = fsspec.url_to_fs(url)
    names = [path[len(root) :].lstrip("/") for path in system.find(root) if path.endswith(wanted)]
    for name in names:
        if ".." in name.split("/"):
            raise Error(f"{url}: the name {name} leads out of the folder; rename it")
    for parent in {folder} | {(folder / name).parent for name in names}:
        parent.mkdir(parents=True, exist_ok=True)
    system.get([f"{root}/{name}" for name in names], [str(folder / name) for name in names])
    return _files(folder)


def _copy_out(folder: Path, url: str, before: Mapping[str, _Stamp]) -> None:
    """Makes the files below a URL those of the folder, of which `_files` said before what is there now: twin.lock last."""
    system, root = fsspec.url_to_fs(url)
    after = _files(folder)
    for name in before.keys() - after.keys():
        system.rm_file(f"{root}/{name}")
    changed = [name for name in after if after[name] != before.get(name)]
    for parent in {os.path.dirname(f"{root}/{name}") for name in changed}:
        system.makedirs(parent, exist_ok=True)
    for last in [False, True]:
        names = sorted(name for name in changed if (name == "twin.lock") == last)
        system.put([str(folder / name) for name in names], [f"{root}/{name}" for name in names])


def _files(folder: Path) -> dict[str, _Stamp]:
    """The files in a folder by their names, with what changes when they are written."""
    files = [(path, path.stat()) for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): (stat.st_mtime_ns, stat.st_size) for path, stat in files}
