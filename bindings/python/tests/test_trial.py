"""Grasps of a mesh, and what becomes of them in simulation."""

import os
import pathlib
import subprocess
import sys
import unittest

import numpy as np

import drex
from support import Case, box, runs_beside

EXAMPLE = pathlib.Path(__file__).resolve().parents[1] / "examples" / "grasp_a_mesh.py"
IN_RUST = os.environ.get("DREX_EXAMPLE")
QUICK = dict(candidates=2000, simulated=2, trials=2)
MASS_KG = 0.1


class Trials(Case):
    @classmethod
    def setUpClass(cls):
        cls.parts = []
        cls.mesh = box(0.05, 0.05, 0.05)
        cls.cube = drex.mesh_asset(cls.mesh, unit="m", mass_kg=MASS_KG)
        cls.found = drex.find_grasp(cls.cube, progress=cls.parts.append, **QUICK)

    def test_a_grasp_is_found_and_tried(self):
        found, grasp = self.found, self.found.grasp
        self.assertEqual((grasp.hand, len(found.verdicts)), ("leap_right", 2))
        self.assertEqual(found.held, found.verdicts.count("success"))
        self.assertGreater(found.held, 0)
        self.assertTrue(0 <= found.interval[0] <= found.held / 2 <= found.interval[1] <= 1)
        # Two fingers at friction 0.5 press at least with the weight over the friction.
        self.assertGreater(found.grip_force_n, MASS_KG * 9.81 / 0.5)
        self.assertEqual(grasp.contact_points_m.shape, grasp.contact_normals.shape)
        self.assertEqual(len(grasp.contact_links), len(grasp.contact_points_m))
        np.testing.assert_allclose(np.linalg.norm(grasp.contact_normals, axis=1), 1)
        self.assertEqual((self.parts, self.parts[-1]), (sorted(self.parts), 1.0))
        # A mesh and a mass are the same object.
        again = drex.find_grasp(self.mesh, MASS_KG, drex.Robot("leap_right"), unit="m", **QUICK)
        self.assertEqual((again.grasp, again.verdicts), (grasp, found.verdicts))
        self.assertNotEqual(drex.find_grasp(self.cube, seed=1, **QUICK).grasp, grasp)
        # Nothing holds what weighs 50 kg.
        self.assertIsNone(drex.find_grasp(self.cube, 50.0, **QUICK))

    def test_a_command_is_carried_out_under_what_is_true(self):
        trial = drex.Trial(self.cube)
        self.assertEqual((trial.mass_kg, trial.friction, trial.hand), (MASS_KG, 0.5, "leap_right"))
        command = trial.command(self.found.grasp)
        self.assertEqual((command.joints_rad.shape, command.torques_nm.shape), ((16,), (16,)))
        self.assertTrue(np.all(command.limits_nm >= np.abs(command.torques_nm) - 1e-12))
        self.assertLessEqual(command.per_finger_n.sum(), command.grip_force_n + 1e-9)
        there = trial.world_from_object[:3] + self.found.grasp.object_from_base[:3]
        np.testing.assert_allclose(command.world_from_base[:3], there, atol=1e-9)
        light, firm = (trial.command(self.found.grasp, grip_force_n=n).grip_force_n for n in (6, 9))
        self.assertTrue(5.9 < light < 6.1 and 8.9 < firm < 9.1, (light, firm))

        outcome = trial.run(command)
        self.assertEqual((outcome.verdict, outcome.failed_at_s), ("success", None))
        self.assertEqual(outcome.grip_force_n, command.grip_force_n)
        self.assertTrue(0 < outcome.safety_margin <= 1 and outcome.held_n > 0)
        # A grasp is commanded for what the trial knows, so that is the same.
        self.assertEqual(trial.run(self.found.grasp).slip_m, outcome.slip_m)
        heavier = trial.run(command, mass_kg=1.0)
        self.assertNotEqual(heavier.verdict, "success")
        self.assertIsNotNone(heavier.failed_at_s)
        away = trial.run(command, shift_m=[0.3, 0.0])
        self.assertEqual((away.verdict, away.safety_margin), ("no_contact", 0))

    def test_rollouts_draw_what_is_true(self):
        trial, parts = drex.Trial(self.cube), []
        verdicts = trial.rollouts(self.found.grasp, 6, seed=2, progress=parts.append)
        self.assertEqual(verdicts, trial.rollouts(self.found.grasp, 6, seed=2))
        self.assertEqual((len(verdicts), parts), (6, sorted(parts)))
        self.assertEqual(trial.rollouts(self.found.grasp, 0), [])
        open_hand = drex.Grasp("leap_right", self.found.grasp.joint_names, np.zeros(16), [0, 0, 0.4, 1, 0, 0, 0])
        self.assertEqual(trial.rollouts(open_hand, 2), ["no_contact"] * 2)
        with self.assertRaisesRegex(drex.NoCommand, "0 fingers touch the object; a grasp needs two") as raised:
            trial.command(open_hand)
        self.assertEqual(raised.exception.verdict, "no_contact")
        with self.assertRaises(drex.NoCommand):
            trial.run(open_hand)

    def test_a_grasp_of_arrays(self):
        names = self.found.grasp.joint_names
        pose = np.eye(4)
        pose[:3, 3] = 0.01, 0.02, 0.1
        grasp = drex.Grasp("leap_right", names, np.arange(16) / 20, pose)
        np.testing.assert_allclose(grasp.object_from_base, [0.01, 0.02, 0.1, 1, 0, 0, 0])
        self.assertEqual((grasp.contact_points_m.shape, grasp.contact_links, grasp.grip_force_n), ((0, 3), [], None))
        self.assertEqual(grasp, drex.Grasp("leap_right", names, np.arange(16) / 20, pose))
        self.assertEqual(grasp.to_dict()["joint_names"], names)
        copy = drex.Grasp(*(getattr(self.found.grasp, x) for x in ("hand", "joint_names", "joints_rad", "object_from_base")))
        trial = drex.Trial(self.cube)
        self.assertAlmostEqual(trial.run(copy).grip_force_n, trial.run(self.found.grasp).grip_force_n, delta=1e-3)

    def test_refusals(self):
        names, row = self.found.grasp.joint_names, [0, 0, 0, 1, 0, 0, 0]
        mesh = box(0.05, 0.05, 0.05)
        trial = drex.Trial(mesh, mass_kg=0.1, unit="m")
        for call, words in [
            (lambda: drex.find_grasp(mesh), "nobody says what the object weighs"),
            (lambda: drex.find_grasp(mesh, -1.0), "a mass of -1 kg; give kilograms"),
            (lambda: drex.find_grasp(mesh, 0.1, friction=9), "a friction of 9"),
            (lambda: drex.find_grasp(mesh, 0.1, "leep"), "leap_right"),
            (lambda: drex.find_grasp(3, 0.1), "neither a path nor a tuple"),
            (lambda: drex.Trial(mesh, mass_kg=0.1, shake_m_s2=-1), "shake_m_s2 is -1"),
            (lambda: drex.Grasp("leap_right", names, [0], row), "16 joint_names and 1 joints_rad"),
            (lambda: drex.Grasp("leap_right", names, np.full(16, np.nan), row), "holds NaN"),
            (lambda: drex.Grasp("leap_right", names, np.zeros(16), [0, 0, 0]), r"has the shape \(3,\)"),
            (lambda: trial.command(drex.Grasp("claw", names, np.zeros(16), row)), 'is none of "leap_right"'),
            (lambda: trial.command(self.found.grasp, mass_kg=0.0), "a mass of 0 kg"),
            (lambda: trial.run(self.found.grasp, shift_m=[1, 2, 3]), r"shift_m has the shape \(3,\)"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                call()
        with self.assertRaises(FileNotFoundError):
            drex.find_grasp(self.folder / "nowhere.obj", 0.1)
        with self.assertRaises(TypeError):
            trial.run("a grasp")

    def test_a_search_lets_others_run_and_ends_with_an_exception_of_progress(self):
        trial = drex.Trial(self.cube)
        runs_beside(self, lambda: trial.rollouts(self.found.grasp, 4))

        class Enough(Exception):
            pass

        def stop(part):
            if part > 0:
                raise Enough

        with self.assertRaises(Enough):
            drex.find_grasp(self.cube, simulated=100000, progress=stop)

    @unittest.skipUnless(IN_RUST, "DREX_EXAMPLE names no program")
    def test_the_examples_in_python_and_rust_say_the_same(self):
        vertices, faces = self.mesh
        lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
        (self.folder / "cube.obj").write_text("\n".join(lines))
        said = [
            subprocess.run([*program, "cube.obj", "0.1", "2"], cwd=self.folder, capture_output=True, text=True, check=True)
            for program in ([sys.executable, EXAMPLE], [IN_RUST])
        ]
        said = [done.stdout for done in said]
        self.assertEqual(said[0], said[1])
        self.assertRegex(said[0], r"grip force: \d+\.\d N\nheld in \d+ of 24 trials: \w+")


if __name__ == "__main__":
    unittest.main()
