"""Grasps of meshes, each with each mass and hand, by Ray; a Parquet file for each in the folder grasps.

    python bindings/python/examples/many_grasps.py [MESH.obj ...]

Without arguments it grasps the tin of the repository. Needs Ray's data sets: pip install 'ray[data]'.
"""

import itertools
import os
import sys

import ray

import drex.ray

masses_kg, hands = [0.1, 0.3], ["leap_right", "allegro_right"]
# Workers have other working directories.
meshes, out = [os.path.abspath(mesh) for mesh in sys.argv[1:] or ["data/tin/scan/tin.obj"]], os.path.abspath("grasps")
items = [dict(mesh=mesh, mass_kg=kg, hand=hand) for mesh, kg, hand in itertools.product(meshes, masses_kg, hands)]
grasps = ray.data.from_items(items, override_num_blocks=len(items)).map_batches(
    drex.ray.FindGrasps,
    fn_constructor_kwargs=dict(candidates=4000, simulated=4),  # in a hurry: it does five times as much by itself
    batch_size=1,
    num_cpus=1,
    compute=ray.data.ActorPoolStrategy(min_size=1, max_size=8),
)
grasps.write_parquet(out)
for row in ray.data.read_parquet(out).sort("name").take_all():
    print(f'{os.path.basename(row["name"])}  {row["hand"]:>13}  {row["mass_kg"]} kg  {row["verdict"]} {row["error"]}  held {row["held"]} of {row["trials"]}')
