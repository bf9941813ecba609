"""A person's hand on a robot hand."""

import json
import unittest

import numpy as np

import drex
from support import CLIP, Case

RECORD = json.loads(CLIP.read_text())
POINTS = np.array([[[np.nan] * 3 if p is None else p for p in frame["keypoints"]] for frame in RECORD["frames"]])
TIMES_S = np.array([frame["t"] for frame in RECORD["frames"]])


class Retarget(Case):
    def test_arrays_give_what_files_give(self):
        by_file = drex.retarget(CLIP, hand="leap")
        by_array = drex.retarget(POINTS, hand="leap", side=RECORD["hand"], times_s=TIMES_S)
        self.assertEqual(by_file.q.shape, (len(POINTS), 16))
        np.testing.assert_array_equal(by_file.q, by_array.q)
        np.testing.assert_array_equal(by_file.times_s, by_array.times_s)
        np.testing.assert_array_equal(by_file.residuals_mm, by_array.residuals_mm)
        millimetres = drex.retarget(1e3 * POINTS, hand="leap", side=RECORD["hand"], unit="mm", times_s=TIMES_S)
        np.testing.assert_allclose(millimetres.q, by_file.q, atol=1e-6)

    def test_angles_are_within_limits_and_named_as_the_robot_names_them(self):
        for hand, model in [("leap", "leap_right"), ("allegro", "allegro_right")]:
            clip, robot = drex.retarget(CLIP, hand=hand), drex.Robot(model)
            self.assertEqual(clip.joint_names, robot.joint_names)
            for q in (clip.q, clip.q_filtered):
                self.assertTrue(np.all(q >= robot.limits[:, 0] - 1e-12) and np.all(q <= robot.limits[:, 1] + 1e-12))
            self.assertEqual(clip.residuals_mm.shape, (len(clip), len(clip.fingers)))
            self.assertEqual(clip.fingers[0], "thumb")
            self.assertEqual(len(clip.flags), len(clip))

    def test_fingertips_are_where_the_residuals_say(self):
        # `position` wants the robot's fingertips where the person's are; the mapping of the LEAP hand has them at the links' origins.
        clip = drex.retarget(CLIP, hand="leap", objective="position", scale=1.0)
        robot = drex.Robot("leap_right")
        tips = {f["name"]: f for f in robot.fingers}
        self.assertEqual(set(clip.fingers), set(tips))
        for t in range(0, len(clip), 7):
            links = robot.fk(clip.q[t], base=clip.source_from_base[t])
            for i, finger in enumerate(clip.fingers):
                tip = links[robot.link_names.index(tips[finger]["tip_link"])]
                person = POINTS[t, 4 + 4 * ["thumb", "index", "middle", "ring", "little"].index(finger)]
                off_mm = 1e3 * np.linalg.norm(tip[:3] - person)
                self.assertAlmostEqual(off_mm, clip.residuals_mm[t, i], delta=1e-6)

    def test_the_mirror_image_gets_the_mirrored_hand(self):
        side = RECORD["hand"]
        other = "left" if side == "right" else "right"
        clip = drex.retarget(POINTS, side=side, times_s=TIMES_S)
        mirror = drex.retarget(POINTS * [-1, 1, 1], side=other, times_s=TIMES_S)
        np.testing.assert_allclose(mirror.q, clip.q, atol=1e-9)
        self.assertTrue(any("mirror" in note for note in mirror.notes + clip.notes))

    def test_points_that_were_not_seen(self):
        points = POINTS.copy()
        points[5] = np.nan
        points[9, 8] = np.nan  # the index fingertip
        clip = drex.retarget(points, side=RECORD["hand"], times_s=TIMES_S)
        self.assertEqual([flag["flag"] for flag in clip.flags[5]][0], "no_hand")
        np.testing.assert_array_equal(clip.q[5], clip.q[4])
        self.assertTrue(np.all(np.isnan(clip.residuals_mm[5])))
        self.assertTrue(np.isnan(clip.residuals_mm[9, clip.fingers.index("index")]))
        self.assertIn({"flag": "missing_points", "count": 1}, clip.flags[9])

    def test_a_stream(self):
        hand = drex.Retargeter(hand="leap", side=RECORD["hand"], scale=1.3)
        clip = drex.retarget(POINTS, hand="leap", side=RECORD["hand"], scale=1.3, times_s=TIMES_S)
        self.assertIsNone(hand.q)
        self.assertIsNone(hand.t_s)
        streamed = np.array([hand.step(p, t_s=t) for p, t in zip(POINTS, TIMES_S)])
        self.assertEqual(streamed.shape, clip.q.shape)
        self.assertEqual(hand.scale, 1.3)
        self.assertEqual(hand.t_s, TIMES_S[-1])
        self.assertEqual(hand.residuals_mm.shape, (len(hand.fingers),))
        # The clip measures the person on all frames, the stream on the first ones: close, not equal.
        self.assertLess(np.abs(streamed - clip.q_filtered).max(), 0.1)
        first = streamed[0]
        hand.reset()
        again = np.array([hand.step(p) for p in POINTS[:3]])
        self.assertAlmostEqual(hand.t_s, 2 / 30)
        self.assertLess(np.abs(again[0] - first).max(), 0.1)
        before = again[-1]
        np.testing.assert_array_equal(hand.step(np.zeros((21, 3))), before)
        self.assertEqual(hand.flags[0]["flag"], "no_hand")

    def test_refusals(self):
        for call, words in [
            (lambda: drex.retarget(POINTS[:, :20]), r"\(T, 21, 3\)"),
            (lambda: drex.retarget(POINTS[0]), r"\(T, 21, 3\)"),
            (lambda: drex.retarget(POINTS[:0]), "."),
            (lambda: drex.retarget(POINTS, objective="grasp"), "command line"),
            (lambda: drex.retarget(POINTS, side="up"), "right"),
            (lambda: drex.retarget(POINTS, unit="ell"), "mm"),
            (lambda: drex.retarget(POINTS, order="mine"), "mano"),
            (lambda: drex.retarget(POINTS, times_s=TIMES_S[:-1]), "one per frame"),
            (lambda: drex.retarget(POINTS, times_s=TIMES_S[::-1]), "is not after"),
            (lambda: drex.retarget(POINTS, times_s=TIMES_S, fps=30), "one of them"),
            (lambda: drex.retarget(POINTS, fps=-1), "frame"),
            (lambda: drex.retarget(CLIP, times_s=TIMES_S), "for arrays"),
            (lambda: drex.retarget(POINTS, scale=-1), "scale"),
            (lambda: drex.retarget(POINTS, low_pass_alpha=0), "low_pass_alpha"),
            (lambda: drex.retarget(POINTS, hand="paw"), "paw"),
            (lambda: drex.Retargeter(fps=0), "fps"),
            (lambda: drex.Retargeter(side="both"), "right"),
            (lambda: drex.Retargeter().step(POINTS), r"\(21, 3\)"),
            (lambda: drex.Retargeter().step(POINTS[0, :20]), "20 points"),
            (lambda: drex.Retargeter().step(POINTS[0], t_s=float("inf")), "t_s"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                call()
        with self.assertRaises(FileNotFoundError):
            drex.retarget("none.json")
        with self.assertRaises(FileNotFoundError):
            drex.retarget(POINTS, hand="none.urdf")


if __name__ == "__main__":
    unittest.main()
