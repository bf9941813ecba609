"""Grasps of meshes, each with each mass and hand, by Ray; a Parquet file for each in the folder grasps.

    python bindings/python/examples/many_grasps.py [MESH.obj ...]

Without arguments it grasps the tin of the repository. Needs Ray's data sets: pip install 'ray[data]'.
"""

import itertools
import sys

import ray

import drex.ray

meshes, masses_kg, hands = sys.argv[1:] or ["data/tin/scan/tin.obj"], [0.1, 0.3], ["leap_right", "allegro_right"]
items = [dict(mesh=mesh, mass_kg=kg, hand=hand) for mesh, kg, hand in itertools.product(meshes, masses_kg, hands)]
grasps = ray.data.from_items(items, override_num_blocks=len(items)).map_batches(
    drex.ray.FindGrasps,
    fn_constructor_kwargs=dict(candidates=4000, simulated=4),  # in a hurry: it does five times as much by itself
    batch_size=1,
    num_cpus=1,
    compute=ray.data.ActorPoolStrategy(min_size=1, max_size=8, max_tasks_in_flight_per_actor=1),
)
grasps.write_parquet("grasps")
for row in ray.data.read_parquet("grasps").sort("name").take_all():
    print(f'{row["name"]}  {row["hand"]:>13}  {row["mass_kg"]} kg  {row["verdict"]} {row["error"]}  held {row["held"]} of {row["trials"]}')
