"""Cameras of photos next to COLMAP (pycolmap) and openmvg-rs: the same sets, turn by turn, judged against exact poses.

    pip install pycolmap==4.2.1 openmvg-rs numpy
    cargo build --release -p drex-sfm --example register
    DREX_SHARED=... python tests/peers/sfm_poses.py [--sets orbit60,plain50] [--programs drex,colmap,openmvg] [--threads 2]

The sets are those of DREX_SHARED/data/sfm; masks go to drex and COLMAP where a set has them. COLMAP runs with its own defaults and one camera
for all photos (8192 features, exhaustive matching, SIMPLE_RADIAL, incremental mapper), openmvg-rs with its defaults. Each program
runs in a process of its own; core-seconds are its user and system time, everything from photos to model. Of several models the largest is
judged. The ratio is that of drex's core-seconds to COLMAP's.
"""

import argparse
import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "target/release/examples/register"
SHARED = pathlib.Path(os.environ.get("DREX_SHARED", ROOT.parent / "shared"))
SETS = ["orbit60", "echo60", "turntable72", "plain50", "video240"]
# Of a video's frames the peers get every third.
EVERY = {"video240": 3}


def main():
    arguments = parse()
    if arguments.one:
        return one(*arguments.one, arguments.threads)
    for name in arguments.sets.split(","):
        compare(name, arguments)


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--programs", default="drex,openmvg,colmap")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--one", nargs=4, metavar=("PROGRAM", "PHOTOS", "MASKS", "OUT"), help="runs one program; for this script itself")
    return parser.parse_args()


def compare(name, arguments):
    folder = SHARED / "data/sfm" / name
    seconds = {}
    for program in arguments.programs.split(","):
        with tempfile.TemporaryDirectory() as work:
            out = pathlib.Path(work) / "out"
            out.mkdir()
            photos = folder / "images"
            if program != "drex" and name in EVERY:
                photos = pathlib.Path(work) / "images"
                photos.mkdir()
                for file in sorted((folder / "images").iterdir())[:: EVERY[name]]:
                    (photos / file.name).symlink_to(file)
            masks = folder / "masks" if (folder / "masks").is_dir() else "-"
            before = used()
            command = [sys.executable, __file__, "--threads", str(arguments.threads), "--one", program, photos, masks, out]
            done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
            seconds[program] = used() - before
            print(f"{name:12} {program:8} {seconds[program]:6.0f} core-s  {judged(done, out, folder)}", flush=True)
    if {"drex", "colmap"} <= seconds.keys():
        print(f"{name:12} drex / colmap: ratio {seconds['drex'] / seconds['colmap']:.2f} in core-seconds", flush=True)


def used():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def judged(done, out, folder):
    models = sorted({file.parent for ending in ("bin", "txt") for file in out.rglob(f"images.{ending}")})
    if done.returncode != 0 or not models:
        return "no model: " + (done.stderr.strip().splitlines() or ["it says nothing"])[-1][:150]
    judge = [sys.executable, SHARED / "tools/compare_poses.py", models[0] if len(models) == 1 else models[0].parent, folder / "truth", "--json"]
    found = json.loads(subprocess.run([str(c) for c in judge], capture_output=True, text=True, check=True).stdout)
    if "rotation_deg" not in found:
        return f"{found['registered']} of {found['reference_photos']} registered"
    rotation, position = found["rotation_deg"], found["position_pct"]
    return (
        f"{found['registered']} registered in {found['models']} models; rotation {rotation['median']:.4f} deg, worst {rotation['worst']:.3f}; "
        f"position {position['median']:.4f} %, worst {position['worst']:.3f}"
    )


def one(program, photos, masks, out, threads):
    photos, masks, out = pathlib.Path(photos), None if masks == "-" else pathlib.Path(masks), pathlib.Path(out)
    if program == "drex":
        environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
        done = subprocess.run([EXAMPLE, photos, out, *([masks] if masks else [])], env=environment)
        return sys.exit(done.returncode)
    if program == "openmvg":
        import openmvg_rs

        model = openmvg_rs.reconstruct(str(photos), max_workers=threads)
        return model.write_colmap(out)
    import pycolmap

    database = out / "database.db"
    reading = pycolmap.ImageReaderOptions()
    if masks:
        reading.mask_path = str(masks)
    extraction, matching, mapping = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions(), pycolmap.IncrementalPipelineOptions()
    for options in (extraction, matching, mapping):
        options.num_threads = threads
    pycolmap.extract_features(database, photos, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reading, extraction_options=extraction)
    pycolmap.match_exhaustive(database, matching_options=matching)
    models = pycolmap.incremental_mapping(database, photos, out / "sparse", options=mapping)
    if not models:
        sys.exit("no good initial image pair")


if __name__ == "__main__":
    main()
