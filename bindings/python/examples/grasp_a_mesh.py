"""A mesh and a mass in; a grasp, its grip force and what became of it in simulation out.

    python bindings/python/examples/grasp_a_mesh.py [MESH.obj KG [SIMULATED]]

Without arguments it grasps the tin of the repository. SIMULATED is how many grasps are simulated before one is chosen.
crates/drex-twin/examples/grasp_a_mesh.rs is the same in Rust.
"""

import sys

import drex

mesh, mass_kg = sys.argv[1:3] or ("data/tin/scan/tin.obj", 0.236)
simulated = int(sys.argv[3]) if len(sys.argv) > 3 else 20
found = drex.find_grasp(mesh, float(mass_kg), simulated=simulated)
if found is None:
    sys.exit("the hand finds no grasp that holds it")
for joint, angle in zip(found.grasp.joint_names, found.grasp.joints_rad):
    print(f"{joint:>8} {angle:7.3f} rad")
x, y, z, qw, qx, qy, qz = found.grasp.object_from_base
print(f"object_from_base: {x:.4f} {y:.4f} {z:.4f} m, quaternion {qw:.4f} {qx:.4f} {qy:.4f} {qz:.4f}")
print(f"grip force: {found.grip_force_n:.1f} N")
print(f"held in {found.held} of {len(found.verdicts)} trials: {', '.join(found.verdicts)}")
