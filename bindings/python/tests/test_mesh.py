"""Assets of meshes."""

import json
import unittest
import xml.etree.ElementTree as xml

import numpy as np

import drex
from support import TIN_MESH, Case, box, rotation


class Assets(Case):
    def test_a_box_has_the_volume_and_inertia_of_a_box(self):
        vertices, faces = box(0.06, 0.04, 0.02)
        asset = drex.mesh_asset((vertices, faces), mass_kg=0.3)
        self.assertAlmostEqual(asset.volume_m3, 48e-6, delta=1e-15)
        np.testing.assert_allclose(asset.center_of_mass_m, 0, atol=1e-15)
        sides = np.array([0.06, 0.04, 0.02])
        expected = 0.3 / 12 * (np.sum(sides**2) - sides**2)
        np.testing.assert_allclose(asset.inertia_kg_m2, np.diag(expected), rtol=1e-12, atol=1e-18)
        self.assertEqual(len(asset.pieces), 1)
        self.assertEqual(asset.vertices.dtype, np.float64)
        self.assertEqual(asset.faces.dtype, np.uint32)
        self.assertEqual(asset.faces.shape, (12, 3))
        # It stands on its lower side, and most probably on one of the two large ones.
        np.testing.assert_allclose(asset.rest_pose, [0, 0, 0.01, 1, 0, 0, 0], atol=1e-12)
        self.assertEqual(asset.stable_poses.shape[1], 7)
        self.assertAlmostEqual(asset.stable_pose_probabilities.sum(), 1.0)
        self.assertAlmostEqual(asset.stable_poses[0, 2], 0.01)

    def test_units_density_and_another_mass(self):
        vertices, faces = box(60, 40, 20)
        asset = drex.mesh_asset((vertices.tolist(), faces.astype(np.float32)), unit="mm", density_kg_m3=500)
        self.assertAlmostEqual(asset.mass_kg, 0.024)
        heavier = asset.with_mass(0.048)
        np.testing.assert_allclose(heavier.inertia_kg_m2, 2 * asset.inertia_kg_m2)
        self.assertAlmostEqual(asset.mass_kg, 0.024)

    def test_what_is_written_agrees_with_what_is_returned(self):
        out = self.folder / "tin"
        asset = drex.mesh_asset(TIN_MESH, unit="m", mass_kg=0.2, out=out)
        inertial = xml.parse(out / "asset" / "object.xml").find(".//inertial")
        self.assertAlmostEqual(float(inertial.get("mass")), 0.2)
        np.testing.assert_allclose([float(x) for x in inertial.get("pos").split()], asset.center_of_mass_m, atol=1e-9)
        self.assertTrue((out / "asset" / "object.urdf").is_file())
        self.assertEqual(len(list((out / "mesh").glob("collision_*.obj"))), len(asset.pieces))
        report = json.loads((out / "mesh" / "report.json").read_text())
        self.assertEqual(report["volume_m3"], asset.volume_m3)
        self.assertEqual(asset.to_dict()["volume_m3"], asset.volume_m3)
        # One hull covers the tin, and fills its shoulder: that is the one rule that it breaks.
        failed = [rule["number"] for rule in drex.mesh_check(out).rules if rule["outcome"] == "fail"]
        self.assertEqual(failed, [13])
        drex.mesh_asset(box(0.06, 0.04, 0.02), mass_kg=0.2, out=self.folder / "box")
        self.assertTrue(drex.mesh_check(self.folder / "box").passed)
        # Pieces are convex: no corner is beyond a face.
        for vertices, faces in asset.pieces:
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            normals = np.cross(b - a, c - a)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            beyond = np.einsum("fi,fvi->fv", normals, vertices[None] - a[:, None])
            self.assertLess(beyond.max(), 1e-6)

    def test_poses_at_rest_touch_the_table(self):
        asset = drex.mesh_asset(TIN_MESH, unit="m")
        corners = np.concatenate([vertices for vertices, _ in asset.pieces])
        for pose in asset.stable_poses:
            self.assertAlmostEqual((corners @ rotation(pose).T + pose[:3])[:, 2].min(), 0.0, delta=1e-9)

    def test_the_rules(self):
        vertices, faces = box(0.06, 0.04, 0.02)
        check = drex.mesh_check((vertices, faces))
        self.assertEqual([rule["number"] for rule in check.rules], list(range(1, 24)))
        self.assertIn("closed", str(check))
        sheet = drex.mesh_check((vertices, faces[:2]))
        self.assertFalse(sheet.passed)
        self.assertTrue(any(rule["outcome"] == "fail" and rule["reason"] for rule in sheet.to_dict()["rules"]))

    def test_refusals(self):
        vertices, faces = box(0.06, 0.04, 0.02)
        for arguments, words in [
            (((vertices[:, :2], faces),), "vertices has the shape"),
            (((vertices, faces + 0.5),), "counted from 0"),
            (((vertices, faces - 1),), "counted from 0"),
            (((vertices, faces + 1),), "beyond"),
            (((vertices * np.nan, faces),), "vertices holds NaN"),
            (((vertices, faces[:0]),), "no triangles"),
            ((17,), "neither a path nor a tuple"),
            ((("a", "b"),), "vertices is no array"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(drex.Error, words):
                drex.mesh_asset(*arguments)
        for settings, words in [
            ({"mass_kg": -1}, "mass in kg"),
            ({"mass_kg": 1, "density_kg_m3": 1}, "give one of them"),
            ({"unit": "ell"}, "no unit of length"),
            ({"up_in_mesh": [0, 0]}, "shape"),
            ({"up_in_mesh": [0, 0, 0]}, "up direction"),
            ({"most_pieces": 0}, "convex parts"),
            ({"friction": float("nan")}, "friction"),
        ]:
            with self.subTest(words), self.assertRaisesRegex(ValueError, words):
                drex.mesh_asset((vertices, faces), **settings)
        with self.assertRaises(FileNotFoundError) as caught:
            drex.mesh_asset(self.folder / "none.stl")
        self.assertIn("none.stl", str(caught.exception))
        self.assertTrue(str(caught.exception.filename).endswith("none.stl"))
        with self.assertRaises(TypeError):
            drex.mesh_asset((vertices, faces), mass=1)
        with self.assertRaises(drex.Error):
            drex.mesh_asset((vertices, faces)).with_mass(0)


if __name__ == "__main__":
    unittest.main()
