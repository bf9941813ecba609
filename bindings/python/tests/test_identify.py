"""Masses from pushes."""

import json
import unittest

import numpy as np

import drex
from support import DATA, TIN_MESH, TIN_PUSH, Case, box, runs_beside

TRUTH = json.loads((DATA / "tin" / "truth.json").read_text())


def cube():
    return drex.mesh_asset(box(0.06, 0.06, 0.06), mass_kg=0.2)


LIFT = dict(force_times_s=[0.2, 0.5], forces_n=[[0, 0, 3], [0, 0, 0]], point_in_object_m=[0, 0, 0])


def lifted(noise_m=1e-3, seed=3, **more):
    """A cube of 0.2 kg that 3 N lift, from the closed form, tracked with noise."""
    times_s = np.arange(0, 0.5, 1 / 60)
    poses = np.zeros((len(times_s), 7))
    poses[:, 3] = 1
    poses[:, 2] = 0.03 + 0.5 * (3 / 0.2 - 9.81) * np.clip(times_s - 0.2, 0, None) ** 2
    poses[:, :3] += np.random.default_rng(seed).normal(0, noise_m, (len(times_s), 3))
    known = dict(friction=0.5, position_sd_m=noise_m, rotation_sd_rad=0.01)
    return drex.Push(times_s, poses, **LIFT, **(known | more))


class Identify(Case):
    def test_the_tin_weighs_what_it_was_simulated_with(self):
        parts = []
        answer = drex.identify(TIN_PUSH, progress=parts.append)
        self.assertEqual(answer.verdict, "identified")
        lo, hi = answer.ci95_kg
        self.assertTrue(lo < TRUTH["mass_kg"] < hi, f"{TRUTH} is not in {answer.ci95_kg}")
        self.assertTrue(lo < answer.mass_kg < hi)
        self.assertLess(abs(answer.mass_kg / TRUTH["mass_kg"] - 1), 0.1)
        # The profile is lowest near the estimate, and its masses increase.
        self.assertTrue(np.all(np.diff(answer.profile_mass_kg) >= 0))
        best = answer.profile_mass_kg[np.argmin(answer.profile_cost)]
        self.assertTrue(lo * 0.9 < best < hi * 1.1)
        push = answer.pushes[0]
        self.assertEqual(push.observed.shape, push.simulated.shape)
        self.assertEqual(push.observed.shape, (len(push.times_s), 7))
        self.assertLess(push.rms_position_m, 0.01)
        # Nothing but poses was observed here.
        self.assertEqual(push.information.shape, push.times_s.shape)
        self.assertAlmostEqual(push.information.sum(), 1, delta=1e-9)
        whole = answer.to_dict()
        self.assertEqual(whole["mass_kg"], answer.mass_kg)
        self.assertEqual(len(whole["profile"]), len(answer.profile_cost))
        self.assertEqual(parts, sorted(parts))
        self.assertTrue(parts and 0 <= parts[0] and parts[-1] <= 1)

    def test_arrays_and_files_are_one(self):
        push = drex.Push.load(TIN_PUSH / "push.toml")
        asset = drex.mesh_asset(TIN_MESH, unit="m")
        by_file, by_asset = drex.identify([TIN_PUSH]), drex.identify(push, asset=asset, seed=0)
        self.assertEqual(by_file.mass_kg, by_asset.mass_kg)
        self.assertEqual(push.poses.shape, (len(push.times_s), 7))
        self.assertEqual(push.mesh.name, "tin.obj")

    def test_a_lift_from_arrays(self):
        answer = drex.identify(lifted(), asset=cube())
        self.assertEqual(answer.verdict, "identified")
        self.assertTrue(answer.ci95_kg[0] < 0.2 < answer.ci95_kg[1], repr(answer))
        self.assertLess(abs(answer.mass_kg - 0.2), 0.01)
        # Another zero of the clock is the same push.
        plain = lifted(noise_m=1e-3)
        later = drex.Push(
            plain.times_s + 100, plain.poses, **(LIFT | dict(force_times_s=[100.2, 100.5])), friction=0.5,
            position_sd_m=1e-3, rotation_sd_rad=0.01,
        )
        np.testing.assert_allclose(later.times_s, plain.times_s, atol=1e-12)
        self.assertAlmostEqual(drex.identify(later, asset=cube()).mass_kg, answer.mass_kg, delta=1e-6)

    def test_a_push_that_cannot_weigh_is_a_verdict(self):
        weak = lifted()
        # The force is too weak to lift: nothing moves but by noise.
        still = np.tile([0, 0, 0.03, 1, 0, 0, 0], (len(weak.times_s), 1))
        still[:, :3] += np.random.default_rng(1).normal(0, 1e-3, (len(still), 3))
        push = drex.Push(
            weak.times_s, still, **(LIFT | dict(forces_n=[[0, 0, 0.05], [0, 0, 0]])), friction=0.5,
            position_sd_m=1e-3, rotation_sd_rad=0.01,
        )
        answer = drex.identify(push, asset=cube())
        self.assertEqual(answer.verdict, "not_identifiable")
        self.assertIsNone(answer.mass_kg)
        self.assertTrue(answer.reason)
        self.assertIn("no mass", repr(answer))

    def test_what_is_known_changes_the_answer(self):
        fixed = drex.identify(lifted(), asset=cube(), fix={"mass": 0.3})
        self.assertIsNone(fixed.mass_kg)
        self.assertIn("fixed", fixed.reason)
        # A force that was really 10 % larger than recorded moved 10 % more mass.
        plain = drex.identify(lifted(), asset=cube())
        more = drex.identify(lifted(), asset=cube(), fix={"force_gain": 1.1})
        self.assertAlmostEqual(more.mass_kg / plain.mass_kg, 1.1, delta=0.02)
        wider = drex.identify(lifted(), asset=cube(), prior={"force_gain": (1.0, 0.1)})
        self.assertGreater(wider.sd_log_mass, plain.sd_log_mass)

    def test_refusals(self):
        for call, words in [
            (lambda: drex.identify([]), "at least one"),
            (lambda: drex.identify([3]), "neither a Push nor a path"),
            (lambda: drex.identify(lifted()), "names no mesh"),
            (lambda: drex.identify(lifted(), asset=cube(), fix={"weight": 1}), "choose one of"),
            (lambda: drex.identify(lifted(), asset=cube(), fix={"mass": 1}, free=["mass"]), "stated twice"),
            (lambda: drex.identify(lifted(), asset=cube(), method="magic"), "lm"),
            (lambda: lifted(position_sd_m=None), "give both or neither"),
            (lambda: lifted(friction=-1), "friction"),
            (lambda: drex.Push([0, 1], np.zeros((2, 7)), **LIFT), "norm"),
            (lambda: drex.Push([0, 0], np.zeros((2, 7)), **LIFT), "is not after"),
            (lambda: drex.Push([0, 1], np.zeros((3, 6)), **LIFT), r"has the shape \(3, 6\)"),
            (lambda: drex.Push([0], [[0, 0, 0, 1, 0, 0, 0]], **(LIFT | {"force_times_s": [1]})), "one force"),
            (lambda: drex.Push.load(self.folder), "push.toml"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                call()
        with self.assertRaises(FileNotFoundError):
            drex.identify(self.folder / "push.toml")

    def test_an_exception_of_progress_ends_the_call(self):
        class Enough(Exception):
            pass

        def stop(part):
            raise Enough

        with self.assertRaises(Enough):
            drex.identify(TIN_PUSH, progress=stop)

    def test_other_threads_run_on(self):
        runs_beside(self, lambda: drex.identify(TIN_PUSH))


if __name__ == "__main__":
    unittest.main()
