"""Rollouts and their derivatives."""

import unittest

import numpy as np

import drex
from support import Case, box

G = 9.81


def cube(mass_kg=0.2, side=0.04):
    return drex.mesh_asset(box(side, side, side), mass_kg=mass_kg)


class Simulate(Case):
    def test_free_fall(self):
        times_s = np.linspace(0, 0.3, 31)
        motion = drex.simulate(cube(), times_s=times_s, pose=[0, 0, 2, 1, 0, 0, 0], velocity_m_s=[0.5, 0, 0],
                               angular_velocity_rad_s=[0, 0, 2], table_height_m=None)
        # Semi-implicit Euler is off by half a step of velocity.
        np.testing.assert_allclose(motion.poses[:, 2], 2 - G * times_s**2 / 2, atol=1e-3)
        np.testing.assert_allclose(motion.poses[:, 0], 0.5 * times_s, atol=1e-12)
        np.testing.assert_allclose(2 * np.arctan2(motion.poses[:, 6], motion.poses[:, 3]), 2 * times_s, atol=1e-3)
        np.testing.assert_allclose(motion.velocities_m_s[-1], [0.5, 0, -G * 0.3], atol=6e-3)
        np.testing.assert_allclose(motion.angular_velocities_rad_s, np.tile([0, 0, 2], (31, 1)), atol=1e-12)
        self.assertIsNone(motion.joints)
        self.assertIsNone(motion.d_poses_d_log_mass)
        self.assertEqual(len(motion), 31)

    def test_a_block_at_rest_stays_and_a_sliding_one_stops(self):
        rest = drex.simulate(cube(), times_s=[0, 1.0])
        np.testing.assert_allclose(rest.poses[1], rest.poses[0], atol=1e-4)
        slide = drex.simulate(cube(), times_s=[0.5], velocity_m_s=[0.7, 0, 0], friction=0.5, derivatives=True)
        way = 0.7**2 / (2 * 0.5 * G)
        self.assertAlmostEqual(slide.poses[0, 0], way, delta=1e-3)
        # x = v²/(2 μ g): by the logarithm of the friction the way changes by minus itself, by that of the mass not at all.
        self.assertAlmostEqual(slide.d_poses_d_log_friction[0, 0], -way, delta=2e-3 * way + 1e-4)
        self.assertAlmostEqual(slide.d_poses_d_log_mass[0, 0], 0.0, delta=1e-6)

    def test_derivatives_are_the_differences(self):
        asset = cube()
        # Pulled at an upper edge: it tilts and slides.
        push = dict(force_times_s=[0.05, 0.3], forces_n=[[1.6, 0, 0], [0, 0, 0]], point_in_object_m=[-0.02, 0.002, 0.015])
        times_s = [0.1, 0.15, 0.2]

        def run(log_mass, log_friction, **more):
            return drex.simulate(asset, times_s=times_s, mass_kg=0.2 * np.exp(log_mass), friction=0.5 * np.exp(log_friction), **push, **more)

        motion = run(0, 0, derivatives=True)
        np.testing.assert_allclose(motion.poses, run(0, 0).poses, atol=1e-12)
        self.assertGreater(np.abs(motion.d_poses_d_log_mass).max(), 1e-2)
        h = 1e-5
        by_mass = (run(h, 0).poses - run(-h, 0).poses) / (2 * h)
        by_friction = (run(0, h).poses - run(0, -h).poses) / (2 * h)
        np.testing.assert_allclose(motion.d_poses_d_log_mass, by_mass, atol=2e-4)
        np.testing.assert_allclose(motion.d_poses_d_log_friction, by_friction, atol=2e-4)

    def test_the_mass_of_the_asset_counts_unless_another_is_given(self):
        lift = dict(times_s=[0.2], force_times_s=[0, 1], forces_n=[[0, 0, 3], [0, 0, 0]], point_in_object_m=[0, 0, 0])
        height = lambda m: 0.02 + 0.5 * (3 / m - G) * 0.2**2
        self.assertAlmostEqual(drex.simulate(cube(0.25), **lift).poses[0, 2], height(0.25), delta=1e-3)
        self.assertAlmostEqual(drex.simulate(cube(0.25), mass_kg=0.2, **lift).poses[0, 2], height(0.2), delta=1e-3)

    def test_a_robot_holds_its_joints_and_follows_commands(self):
        robot = drex.Robot("leap_right")
        robot_q = robot.joint_vector({"if_mcp": 0.4, "th_cmc": 0.5})
        base = [0, 0, 0.5, 1, 0, 0, 0]
        held = drex.simulate(robot=robot, robot_q=robot_q, robot_base=base, times_s=[0, 0.5])
        self.assertIsNone(held.poses)
        np.testing.assert_array_equal(held.joints[0], robot_q)
        self.assertLess(np.abs(held.joints[1] - robot_q).max(), 0.3)
        # A drive that is told another angle goes there.
        i = robot.actuator_names.index("if_mcp")
        controls = np.stack([robot_q, robot_q])
        controls[1, i] = 0.9
        moved = drex.simulate(robot=robot, robot_q=robot_q, robot_base=base, robot_controls=controls,
                              robot_control_times_s=[0.0, 0.2], times_s=[0.2, 1.0])
        joint = robot.joint_names.index("if_mcp")
        self.assertGreater(moved.joints[1, joint] - moved.joints[0, joint], 0.3)

    def test_a_hand_that_sweeps_by_takes_a_floating_box_along(self):
        robot = drex.Robot("leap_right")
        asset = drex.mesh_asset(box(0.1, 0.1, 0.1), mass_kg=0.2)
        # The straight fingers of the hand point along x.
        settings = dict(times_s=[0.0, 1.0], pose=[0, -0.03, 0, 1, 0, 0, 0], table_height_m=None, gravity_m_s2=[0, 0, 0],
                        robot=robot, robot_base_times_s=[0.0, 1.0])
        at = lambda x: [x, 0, 0, 1, 0, 0, 0]
        away = drex.simulate(asset, **settings, robot_base=[at(-0.4), at(-0.6)])
        np.testing.assert_array_equal(away.poses[1], away.poses[0])
        along = drex.simulate(asset, **settings, robot_base=[at(-0.4), at(0.1)], robot_friction=1.0)
        self.assertGreater(along.poses[1, 0], 0.05)

    def test_refusals(self):
        asset, robot = cube(), drex.Robot("leap_right")
        one = dict(times_s=[0.1])
        for call, words in [
            (lambda: drex.simulate(times_s=[0]), "neither an asset nor a robot"),
            (lambda: drex.simulate(asset, times_s=[0.2, 0.1]), "sort the times"),
            (lambda: drex.simulate(asset, times_s=[-0.1]), "starts at 0"),
            (lambda: drex.simulate(asset, times_s=[[0.1]]), "times_s has the shape"),
            (lambda: drex.simulate(asset, **one, mass_kg=0), "mass_kg"),
            (lambda: drex.simulate(asset, **one, friction=-1), "friction"),
            (lambda: drex.simulate(asset, **one, friction=0, derivatives=True), "logarithm"),
            (lambda: drex.simulate(asset, **one, dt_s=1.0), "time step"),
            (lambda: drex.simulate(asset, **one, forces_n=[[1, 0, 0]]), "all three or none"),
            (lambda: drex.simulate(asset, **one, forces_n=[[1, 0, 0]], force_times_s=[0, 1], point_in_object_m=[0, 0, 0]), "one value per time"),
            (lambda: drex.simulate(asset, **one, pose=np.zeros((2, 7))), "norm"),
            (lambda: drex.simulate(asset, **one, pose=np.tile(asset.rest_pose, (2, 1))), "pose has the shape"),
            (lambda: drex.simulate(asset, **one, pose=[0, 0, -0.1, 1, 0, 0, 0]), "inside"),
            (lambda: drex.simulate(asset, **one, robot_q=[0]), "no robot"),
            (lambda: drex.simulate(robot=robot, **one, mass_kg=1), "give an asset"),
            (lambda: drex.simulate(robot=robot, **one, robot_q=[0]), "16 joints"),
            (lambda: drex.simulate(robot=robot, **one, robot_base=[0, 0, 1, 1, 0, 0, 0], robot_controls=[0]), "16 drives"),
            (lambda: drex.simulate(robot=robot, **one, robot_control_times_s=[0]), "without robot_controls"),
            (lambda: drex.simulate(robot=robot, **one, robot_base=np.tile(asset.rest_pose, (2, 1))), "robot_base_times_s"),
            (lambda: drex.simulate(robot=robot, **one, robot_base_times_s=[0]), "one pose per time"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                call()


if __name__ == "__main__":
    unittest.main()
