"""Kinematics and dynamics of robot models."""

import unittest

import numpy as np

import drex
from support import Case, rotation

PENDULUM = """<robot name="pendulum">
  <link name="base"/>
  <joint name="swing" type="revolute">
    <parent link="base"/><child link="rod"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="3" velocity="5"/>
  </joint>
  <link name="rod">
    <inertial><origin xyz="0 0 -0.5"/><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""


class Robots(Case):
    def test_a_pendulum_is_what_the_formula_says(self):
        path = self.folder / "pendulum.urdf"
        path.write_text(PENDULUM)
        robot = drex.Robot(path)
        self.assertEqual((robot.name, robot.dof, robot.joint_names, robot.link_names), ("pendulum", 1, ["swing"], ["base", "rod"]))
        np.testing.assert_array_equal(robot.limits, [[-2, 2]])
        np.testing.assert_array_equal(robot.effort_limits, [3])
        self.assertEqual(robot.mass_kg, 2.0)
        q = np.array([0.7])
        np.testing.assert_allclose(robot.mass_matrix(q), [[0.1 + 2 * 0.5**2]])
        np.testing.assert_allclose(robot.gravity_torque(q), [2 * 9.81 * 0.5 * np.sin(0.7)])
        np.testing.assert_allclose(robot.gravity_torque(q, gravity_m_s2=[0, 0, 0]), [0], atol=1e-15)
        np.testing.assert_allclose(robot.bias_force(q, [3.0]), robot.gravity_torque(q), atol=1e-12)
        J = robot.jacobian(q, "rod", point_m=[0, 0, -1])
        np.testing.assert_allclose(J[:, 0], [-np.cos(0.7), 0, np.sin(0.7), 0, 1, 0], atol=1e-12)
        np.testing.assert_array_equal(robot.clamp([5.0]), [2.0])
        self.assertEqual(robot.fingers, [])

    def test_the_jacobian_is_the_derivative_of_the_kinematics(self):
        for name in ["leap_right", "allegro_left"]:
            robot = drex.Robot(name)
            base = [0.1, -0.2, 0.3, *np.array([0.5, -0.5, 0.1, 0.7]) / np.linalg.norm([0.5, -0.5, 0.1, 0.7])]
            q = robot.mid_range
            for finger in robot.fingers:
                link, point = finger["tip_link"], finger["tip_point_m"]
                at = robot.link_names.index(link)

                def tip(q):
                    pose = robot.fk(q, base=base)[at]
                    return rotation(pose) @ point + pose[:3]

                J = robot.jacobian(q, link, point_m=point, base=base)
                self.assertEqual(J.shape, (6, robot.dof))
                h = 1e-6
                steps = h * np.eye(robot.dof)
                slopes = np.array([(tip(q + s) - tip(q - s)) / (2 * h) for s in steps]).T
                np.testing.assert_allclose(J[:3], slopes, atol=1e-8)
                moving = [robot.joint_names.index(j) for j in finger["joints"]]
                still = np.setdiff1d(np.arange(robot.dof), moving)
                self.assertTrue(np.all(J[:, still] == 0))

    def test_many_joint_vectors_at_once(self):
        robot = drex.Robot("leap_right")
        rows = np.stack([robot.mid_range, robot.reference_position, robot.joint_vector({"if_mcp": 0.4})])
        many = robot.fk(rows)
        self.assertEqual(many.shape, (3, len(robot.link_names), 7))
        for one, q in zip(many, rows):
            np.testing.assert_array_equal(one, robot.fk(q))
        np.testing.assert_allclose(np.linalg.norm(many[..., 3:], axis=-1), 1.0, atol=1e-12)
        self.assertEqual(robot.fk(rows[:0]).shape, (0, len(robot.link_names), 7))
        # A base as a matrix, and transposed (not contiguous) input.
        shift = np.eye(4)
        shift[:3, 3] = [1, 2, 3]
        np.testing.assert_allclose(robot.fk(rows[0], base=shift)[:, :3], many[0][:, :3] + [1, 2, 3])
        np.testing.assert_array_equal(robot.fk(np.asfortranarray(rows)), many)

    def test_mirrored(self):
        right = drex.Robot("leap_right")
        left, twice = right.mirrored(), right.mirrored().mirrored()
        q = right.mid_range
        np.testing.assert_allclose(left.mass_matrix(q), right.mass_matrix(q), atol=1e-12)
        np.testing.assert_allclose(twice.fk(q), right.fk(q), atol=1e-12)
        self.assertGreater(np.abs(left.fk(q) - right.fk(q)).max(), 1e-3)

    def test_refusals(self):
        robot = drex.Robot("leap_right")
        for call, words in [
            (lambda: drex.Robot("paw"), "leap_right"),
            (lambda: drex.Robot(self.folder / "none.urdf"), "none.urdf"),
            (lambda: robot.fk([0.0]), r"\(16,\)"),
            (lambda: robot.fk(np.full(16, np.nan)), "NaN"),
            (lambda: robot.fk(robot.mid_range, base=[0, 0, 0]), r"\(7,\)"),
            (lambda: robot.fk(robot.mid_range, base=[0, 0, 0, 0, 0, 0, 0]), "norm"),
            (lambda: robot.fk(robot.mid_range, base=2 * np.eye(4)), "4 x 4|last row"),
            (lambda: robot.jacobian(robot.mid_range, "toe"), "palm"),
            (lambda: robot.mass_matrix([1, 2]), "16 joints"),
            (lambda: robot.joint_vector({"toe": 1.0}), "if_mcp"),
            (lambda: robot.gravity_torque(robot.mid_range, gravity_m_s2=[1, 2]), r"\(3,\)"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                call()
        (self.folder / "bad.urdf").write_text("<robot name='x'><joint/></robot>")
        with self.assertRaisesRegex(drex.Error, "bad.urdf"):
            drex.Robot(self.folder / "bad.urdf")


if __name__ == "__main__":
    unittest.main()
