"""Twins: the pipeline, the mass, the network and the grasp that it gives."""

import fcntl
import json
import shutil
import subprocess
import time
import unittest

import numpy as np

import drex
from support import PROGRAM, TIN_MESH, Case, runs_beside, small_twin


class Twins(Case):
    """A copy of the small twin, whose network learns for a few epochs from a few grasps."""

    def setUp(self):
        super().setUp()
        self.twin = small_twin(self.folder / "twin")

    def test_stages_and_what_they_need_are_done_once(self):
        twin = drex.Twin.open(self.twin)
        self.assertEqual((twin.name, twin.path), ("tea tin", self.twin))
        with self.assertRaisesRegex(drex.Error, "has no mass yet: run its stage identify first"):
            twin.mass
        parts, notes = [], []
        done = twin.run(["asset"], parts.append, note=notes.append)
        self.assertEqual((done["stages_run"], done["stages_current"]), (["identify", "asset"], []))
        self.assertEqual((parts[-1], parts), (1.0, sorted(parts)))
        self.assertTrue(any("asset  done in" in line for line in notes), notes)
        # A second run has nothing to do, whoever opens the twin.
        again = drex.Twin.open(self.twin / "twin.toml").run(stages=["identify", "asset"])
        self.assertEqual((again["stages_run"], again["stages_current"]), ([], ["identify", "asset"]))
        self.assertEqual(drex.Twin.open(self.twin, seed=9).run(["identify"])["stages_run"], ["identify"])

    def test_the_mass_is_that_of_the_push(self):
        twin = drex.Twin.open(self.twin)
        twin.run(["identify"])
        mass, alone = twin.mass, drex.identify(self.twin / "push" / "tilt", seed=1)
        lo, hi = mass.ci95_kg
        self.assertTrue(lo < 0.236 < hi and lo < mass.mass_kg < hi and mass.mass_kg <= mass.grip_kg, repr(mass))
        self.assertEqual((mass.verdict, mass.reason), ("identified", alone.reason))
        self.assertEqual(mass.identification.mass_kg, alone.mass_kg)
        self.assertEqual(mass.to_dict(), json.loads((self.twin / "mass.json").read_text()))
        self.assertEqual(mass.source, "identified")

    def test_without_a_push_there_is_no_verdict(self):
        manifest = self.twin / "twin.toml"
        manifest.write_text(manifest.read_text().replace('identify = ["push/tilt"]\n', ""))
        twin = drex.Twin.open(self.twin)
        twin.run(["identify"])
        mass = twin.mass
        self.assertEqual((mass.source, mass.verdict, mass.reason, mass.identification), ("prior", None, None, None))

    def test_a_trained_twin_grasps(self):
        twin = drex.Twin.open(self.twin)
        with self.assertRaisesRegex(drex.Error, "has no policy yet: run `drex train"):
            twin.policy
        done = twin.run(["train"])
        self.assertEqual(done["stages_run"], ["identify", "grasps", "train"])
        pose = np.eye(4)
        pose[:3, 3] = 0.4, 0.1, 0.2
        there = twin.predict(pose, 0.2)
        self.assertEqual((there.mass_kg, there.friction, there.grasp.origin), (0.2, 0.5, "predicted"))
        self.assertEqual(there.grasp.joints_rad.shape, (16,))
        # The base in the world is the object's pose and then the grasp.
        np.testing.assert_allclose(there.world_from_base[:3], there.grasp.object_from_base[:3] + pose[:3, 3], atol=1e-9)
        # It is closed on the object as it stands, wherever the origin of the world is.
        here = twin.predict([0.1, -0.3, 0.9, 1, 0, 0, 0], 0.2)
        self.assertEqual(here.contacts, there.contacts)
        self.assertEqual(here.needed_grip_force_n, there.needed_grip_force_n)
        np.testing.assert_array_equal(here.grasp.joints_rad, there.grasp.joints_rad)
        self.assertEqual(there.joint_torques_nm.shape, (0,) if there.cannot_hold else (16,))
        self.assertEqual((there.cannot_hold is None), (there.needed_grip_force_n is not None))
        self.assertEqual(twin.predict().mass_kg, twin.mass.grip_kg)
        if PROGRAM:
            command = [PROGRAM, "grasp", self.twin, "--json", "--mass", "0.2", "--pose", "0.1,-0.3,0.9,1,0,0,0"]
            self.assertEqual(json.loads(subprocess.run(command, capture_output=True).stdout), here.to_dict())

        policy = twin.policy
        self.assertEqual(policy.hand, there.grasp.hand)
        asset = drex.mesh_asset(TIN_MESH, unit="m")
        grasps = policy.predict(asset, 0.2)
        self.assertEqual(len(grasps), policy.modes)
        self.assertAlmostEqual(sum(g.weight for g in grasps), 1)
        self.assertEqual(grasps[0].contacts.shape, (len(policy.fingers),))
        self.assertTrue(np.all(policy.joint_limits_rad[:, 0] <= grasps[0].grasp.joints_rad))
        # Points can be given too; the object may lie on its side.
        points = asset.vertices[np.random.default_rng(0).integers(0, len(asset.vertices), policy.points)]
        upright = policy.predict(points, 0.2)[0].grasp
        turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        lying = policy.predict(points @ turn.T, 0.2, up=[1, 0, 0])[0].grasp
        np.testing.assert_allclose(lying.object_from_base[:3], turn @ upright.object_from_base[:3], atol=1e-4)
        drawn = policy.sample(asset, 0.2, 3, seed=5)
        self.assertEqual([g.grasp for g in drawn], [g.grasp for g in policy.sample(asset, 0.2, 3, seed=5)])
        self.assertNotEqual(drawn[0].grasp, policy.sample(asset, 0.2, 3, seed=6)[0].grasp)
        joints = grasps[0].grasp.joints_rad
        likely, far = (policy.log_density(asset, 0.2, q) for q in (joints, joints + 1))
        self.assertGreater(likely, far)
        self.assertEqual(drex.Policy.open(self.twin / "policy" / "network").predict(asset, 0.2)[0].grasp, grasps[0].grasp)
        for call, words in [
            (lambda: twin.predict(mass_kg=1000), "1000"),
            (lambda: policy.predict(points[:3], 0.2), "3 points, but the policy takes"),
            (lambda: policy.predict(points, -1), "mass -1"),
            (lambda: policy.log_density(asset, 0.2, joints[:3]), "3 joint angles for 16 joints"),
            (lambda: twin.predict(pose=[1, 2]), r"pose has the shape \(2,\)"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                call()

    def test_messages_are_those_of_the_command_line(self):
        bare = self.folder / "bare"
        shutil.copytree(self.twin, bare)
        manifest = (bare / "twin.toml").read_text()
        (bare / "twin.toml").write_text(manifest[: manifest.index("[grasps]")])
        broken = self.folder / "broken"
        shutil.copytree(self.twin, broken)
        (broken / "push" / "tilt" / "poses.csv").write_text("no poses\n")
        nowhere = self.folder / "nowhere"
        busy = self.folder / "busy"
        shutil.copytree(self.twin, busy)
        held = open(busy / "twin.toml")
        self.addCleanup(held.close)
        fcntl.flock(held, fcntl.LOCK_EX)
        cases = [
            (lambda: drex.Twin.open(nowhere), ["run", nowhere], "give a twin.toml or the folder that holds it"),
            (lambda: drex.Twin.open(self.twin).predict(), ["grasp", self.twin], "has no policy yet"),
            (lambda: drex.Twin.open(bare).run(["train"]), ["train", bare], r"has no \[grasps\] section"),
            (lambda: drex.Twin.open(broken).run(["identify"]), ["identify", broken], "stage identify"),
            (lambda: drex.Twin.open(busy).run(), ["run", busy], "another drex is at work on .*; wait until it is done"),
        ]
        for call, command, words in cases:
            with self.subTest(words):
                with self.assertRaisesRegex(drex.Error, words) as raised:
                    call()
                self.assertEqual(isinstance(raised.exception, drex.Busy), "at work" in words)
                if PROGRAM:
                    said = subprocess.run([PROGRAM, *command], capture_output=True, text=True).stderr
                    self.assertEqual(f"error: {raised.exception}", said.strip().splitlines()[-1])
        with self.assertRaisesRegex(
            drex.Error,
            'there is no stage "Train"; choose from scan, identify, asset, grasps, train, evaluate, trial, execute, '
            "appearance, report",
        ):
            drex.Twin.open(self.twin).run(["identify", "Train"])

    def test_a_run_lets_others_run_and_is_stopped_and_goes_on(self):
        shutil.rmtree(self.twin)
        small_twin(self.twin, epochs=100000, demonstrations=2)
        twin = drex.Twin.open(self.twin)
        twin.run(["identify", "grasps"])

        class Enough(Exception):
            pass

        def stop(part):
            if part > 0.5:
                raise Enough

        # The last of three stages learns, for an hour if nothing stopped it.
        with self.assertRaises(Enough):
            twin.run(["train"], stop)
        # The run that was stopped keeps the folder until it hears of it.
        self.eventually(lambda: twin.run(["identify"])["stages_current"] == ["identify"])
        self.assertFalse((self.twin / "policy").exists() and any((self.twin / "policy").iterdir()))
        runs_beside(self, lambda: drex.Twin.open(self.twin, seed=3).run(["identify"]))

    def eventually(self, done):
        for _ in range(200):
            try:
                return self.assertTrue(done())
            except drex.Busy as error:
                self.assertIn("another drex is at work", str(error))
                time.sleep(0.1)
        self.fail("the run that was stopped goes on")


if __name__ == "__main__":
    unittest.main()
