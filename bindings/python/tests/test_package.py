"""The package as a whole: names, stubs, documentation, the examples of the README, Ctrl-C."""

import inspect
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import unittest

import drex
from support import DATA, TIN_PUSH, Case

README = pathlib.Path(__file__).resolve().parents[1] / "README.md"


class Package(Case):
    def test_everything_is_documented_and_typed(self):
        folder = pathlib.Path(drex.__file__).parent
        self.assertTrue((folder / "py.typed").is_file())
        stubs = (folder / "_drex.pyi").read_text()
        for name in drex.__all__:
            thing = getattr(drex, name)
            if name.startswith("__"):
                continue
            self.assertTrue(inspect.getdoc(thing), name)
            self.assertRegex(stubs, rf"(class|def) {name}\b")
            if inspect.isclass(thing) and thing is not drex.Error:
                for member, value in vars(thing).items():
                    if not member.startswith("_"):
                        self.assertTrue(inspect.getdoc(value), f"{name}.{member}")
                        self.assertRegex(stubs, rf"def {member}\b")
        self.assertTrue(issubclass(drex.Error, ValueError))
        self.assertRegex(drex.__version__, r"^\d+\.\d+\.\d+")

    def test_the_examples_of_the_readme_run(self):
        blocks = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.S | re.M)
        self.assertGreaterEqual(len(blocks), 8)
        os.symlink(DATA, self.folder / "data")
        # They run one after the other, as a reader would type them; the last lines check what the text promises.
        checks = """
            assert answer.verdict == "identified" and answer.ci95_kg[0] < 0.236 < answer.ci95_kg[1]
            import pathlib
            assert pathlib.Path("tin/asset/object.xml").is_file() and pathlib.Path("tin/asset/object.urdf").is_file()
            assert again.ci95_kg[0] < asset.mass_kg < again.ci95_kg[1], (asset.mass_kg, again.ci95_kg)
            assert hand.flags[0]["flag"] == "no_hand"
            assert twin.mass.ci95_kg[0] < 0.236 < twin.mass.ci95_kg[1]
            assert found.held > 0 and planned.grip_force_n > 0
        """
        script = "\n".join(blocks) + textwrap.dedent(checks)
        done = subprocess.run([sys.executable, "-c", script], cwd=self.folder, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)

    @unittest.skipIf(sys.platform == "win32", "signals of POSIX")
    def test_ctrl_c_ends_a_long_call(self):
        for file in ["scan/tin.obj", "demos/grasps.json"]:
            shutil.copy(DATA / "tin" / file, self.folder)
        (self.folder / "twin.toml").write_text(textwrap.dedent("""
            schema = 1
            name = "slow"
            [object]
            mesh = "tin.obj"
            [mass]
            prior_kg = 0.2
            [grasps]
            file = "grasps.json"
            hand = "leap_right"
            [train]
            epochs = 1000000
        """))
        # Each takes hours, or many minutes.
        for call in [
            "drex.simulate(asset, times_s=[1e5])",
            "drex.find_grasp(asset, simulated=100000, trials=100000, progress=ready)",
            'drex.Twin.open(".").run(["train"], lambda part: ready(part - 0.5))',
        ]:
            with self.subTest(call):
                self.is_interrupted(call)

    def is_interrupted(self, call):
        script = textwrap.dedent(f"""
            import drex, signal, sys
            sys.path.append({str(pathlib.Path(__file__).parent)!r})
            from support import box
            # A job in the background of a shell is born with this signal ignored.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            asset = drex.mesh_asset(box(0.05, 0.05, 0.05), unit="m", mass_kg=0.1)

            def ready(part):
                if part > 0:
                    print("ready", flush=True)

            try:
                {"ready(1)" if "ready" not in call else "pass"}
                {call}
            except KeyboardInterrupt:
                print("interrupted", flush=True)
        """)
        command = [sys.executable, "-c", script]
        with subprocess.Popen(command, cwd=self.folder, stdout=subprocess.PIPE, text=True) as process:
            self.assertEqual(process.stdout.readline().strip(), "ready")
            time.sleep(0.5)
            begin = time.monotonic()
            process.send_signal(signal.SIGINT)
            line = "ready"
            while line == "ready":
                line = process.stdout.readline().strip()
            self.assertEqual(line, "interrupted")
            process.wait(timeout=60)
            self.assertLess(time.monotonic() - begin, 30)
            self.assertEqual(process.returncode, 0)

    def test_the_seed_decides(self):
        one, two = drex.identify(TIN_PUSH, seed=1).to_dict(), drex.identify(TIN_PUSH, seed=1).to_dict()
        self.assertEqual(one, two)


if __name__ == "__main__":
    unittest.main()
