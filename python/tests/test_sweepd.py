"""The package: `python/check` runs it on each interpreter. SWEEPD names the program, SWEEPD_LIBRARY the library."""

import csv
import gc
import itertools
import os
import pathlib
import pydoc
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import zlib
from unittest import mock

import numpy as np
import sweepd
from sweepd import _library, _show, layout

PROGRAM = os.environ["SWEEPD"]
TOP = pathlib.Path(__file__).parents[2]
DUAL = TOP / "pcap_fixtures/street_vlp16_dual.pcap.gz"
LOSSES = TOP / "pcap_fixtures/street_vlp16_losses.pcap"


def run(*args):
    """Give the standard output of a program that must succeed."""
    return subprocess.run([str(arg) for arg in args], check=True, stdout=subprocess.PIPE, text=True).stdout


def simulate(folder, *options):
    """Make a capture."""
    path = pathlib.Path(folder) / "made.pcap"
    subprocess.run([PROGRAM, "simulate", *options, "--pcap", str(path)], check=True, stderr=subprocess.DEVNULL)
    return path


def children():
    """Give the processes that this one has started and not waited for."""
    return (pathlib.Path("/proc/self/task") / str(os.getpid()) / "children").read_text().split()


def plain(sweep, *, bends=True):
    """Give the points by docs/layout.md, written down as it stands there."""
    columns = len(sweep.columns)
    at = np.arange(columns)[:, np.newaxis] + sweep.beams["shift"].astype(int)
    firing = sweep.columns[at % columns if sweep.has(layout.CIRCULAR) else at.clip(0, columns - 1)]
    beam = {name: sweep.beams[name].astype(float) for name in layout.BEAM.names if not name.startswith("reserved")}
    a = firing["azimuth_rad"].astype(float)
    a = a + firing["azimuth_rate_rad_s"].astype(float) * beam["time_offset_ns"] * 1e-9 - beam["rotation_rad"]
    w = beam["elevation_rad"]
    r = np.where(sweep.range > 0, sweep.range, np.nan).astype(float)[..., np.newaxis]
    along = np.stack([np.cos(w) * np.sin(a), np.cos(w) * np.cos(a), np.sin(w) + 0 * a], axis=-1)
    point = r * along
    if bends:
        sx = (beam["distance_offset_x_m"] - beam["distance_offset_m"]) / (25.04 - 2.40)
        sy = (beam["distance_offset_y_m"] - beam["distance_offset_m"]) / (25.04 - 1.93)
        fx, fy = 1 - sx * np.abs(along[..., 0]), 1 - sy * np.abs(along[..., 1])
        gx, gy = 25.04 * sx + 0 * fx, 25.04 * sy + 0 * fy
        p = along * np.stack([fx, fy, (fx + fy) / 2], axis=-1)
        q = along * np.stack([gx, gy, (gx + gy) / 2], axis=-1)
        pp, pq, qq = (p * p).sum(-1), (p * q).sum(-1), (q * q).sum(-1)
        d = (np.sqrt(pq**2 - pp * (qq - r[..., 0] ** 2)) - pq) / pp
        marked = (sweep.range.view("u4") & 1 == 1) & ((sx != 0) | (sy != 0))
        point = np.where(marked[..., np.newaxis], p * d[..., np.newaxis] + q, point)
    h, v = beam["horizontal_offset_m"], beam["vertical_offset_m"]
    return point + np.stack([-h * np.cos(a), h * np.sin(a), v + 0 * a], axis=-1)


class Replayed(unittest.TestCase):
    """Captures."""

    def test_version(self):
        self.assertEqual(run(PROGRAM, "--version").split()[:2], ["sweepd", sweepd.__version__.replace(".dev0", "-dev")])

    def test_no_sweep_is_lost_and_nothing_is_left(self):
        said = run(PROGRAM, "replay", LOSSES, "--json", "--partial").splitlines()[:-1]
        sweeps = list(sweepd.replay(LOSSES, partial=True))
        self.assertEqual([sweep.sequence for sweep in sweeps], list(range(len(said))))
        self.assertEqual(sweeps[1].sensor, "192.168.1.201:2368")
        self.assertEqual((sweeps[1].name, sweeps[1].header["model"]), ("", 1))
        # Less than a turn is an error that names the option; with it, the part is given.
        with self.assertRaisesRegex(sweepd.SweepdError, "no whole turn.*`partial=True`"):
            next(sweepd.replay(LOSSES, end=0.05))
        self.assertEqual(len(list(sweepd.replay(LOSSES, end=0.05, partial=True))), 1)
        # Half of it, by a loop that ends early, and one whose iterator is dropped.
        for sweep in sweepd.replay(DUAL):
            first = sweep
            break
        sweep = next(sweepd.replay(DUAL))
        gc.collect()
        self.assertEqual(children(), [])
        # Its memory is its own.
        self.assertTrue((first.range == sweep.range).all() and first.range2.shape == first.range.shape)
        copy = sweep.copy()
        for array in (sweep.range, sweep.label2, sweep.segments):
            array[0] = np.zeros((), array.dtype)
        self.assertTrue((copy.range == first.range).all() and not sweep.range[0].any())

    def test_errors_are_the_programs(self):
        with self.assertRaisesRegex(sweepd.SweepdError, "(?s)none.pcap.*No such file"):
            next(sweepd.replay("none.pcap"))
        with self.assertRaisesRegex(sweepd.SweepdError, "--thta.*--theta|(?s:--thta.*similar)"):
            next(sweepd.replay(DUAL, thta=9))
        with self.assertRaisesRegex(sweepd.SweepdError, "cannot run /none/sweepd: No such file"):
            next(sweepd.replay(DUAL, binary="/none/sweepd"))
        with self.assertRaisesRegex(sweepd.LayoutError, "magic bytes at its beginning"):
            next(sweepd.replay(DUAL, binary=self.script("head -c 1000 /dev/zero")))
        with self.assertRaisesRegex(sweepd.LayoutError, "cut short after 3 bytes"):
            next(sweepd.replay(DUAL, binary=self.script("printf abc")))
        variable = os.environ.pop("SWEEPD")
        path = os.environ.pop("PATH")
        try:
            with self.assertRaisesRegex(sweepd.SweepdError, "no program `sweepd` in PATH"):
                next(sweepd.replay(DUAL))
        finally:
            os.environ.update(SWEEPD=variable, PATH=path)
        # What a damaged capture has is given, and then the error.
        with tempfile.TemporaryDirectory() as folder:
            cut = pathlib.Path(folder) / "cut.pcap"
            cut.write_bytes(LOSSES.read_bytes()[:-100])
            with self.assertLogs("sweepd", "WARNING") as logs:
                sweeps = list(sweepd.replay(cut, partial=True))
            self.assertGreater(len(sweeps), 3)
            self.assertIn("replayed", logs.output[0])
        self.assertEqual(children(), [])

    def test_the_program_of_a_wheel_is_beside_it(self):
        with tempfile.TemporaryDirectory() as folder:
            top = pathlib.Path(folder)
            package = top / "a/b/sweepd"
            shutil.copytree(pathlib.Path(sweepd.__file__).parent, package)
            (package / "libsweepd.so").touch()
            foreign, own = top / "bin/sweepd", top / "a/b/bin/sweepd"
            for program in (foreign, own):
                program.parent.mkdir()
            foreign.write_text("#!/bin/sh")
            foreign.chmod(0o755)
            own.touch()
            code = "import sys; sys.prefix = '/none'; from sweepd import _replay; print(_replay._program(None))"
            environment = {"PATH": f"{top}/path", "PYTHONPATH": str(package.parent)}
            python = [sys.executable, "-c", code]
            # That beside it is none yet: it cannot be executed.
            said = subprocess.run(python, env=environment, capture_output=True, text=True)
            self.assertIn("no program `sweepd` in PATH", said.stderr)
            own.chmod(0o755)
            said = subprocess.run(python, env=environment, capture_output=True, text=True)
            self.assertEqual(said.stdout.strip(), str(own), said.stderr)

    def script(self, line):
        """Give a program that does this."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        path = pathlib.Path(folder.name) / "program"
        path.write_text(f"#!/bin/sh\n{line}\n")
        path.chmod(0o755)
        return path

    def test_options_are_those_of_the_command(self):
        both = list(sweepd.replay(DUAL, sensor=["192.168.1.201"], return_="last", partial=False, min_points=30))
        self.assertTrue(all(sweep.segments["points"].min() >= 30 for sweep in both))
        self.assertTrue(all(sweep.header["return_choice"] == layout.CHOICE_LAST for sweep in both))

    def test_returns_are_those_of_the_tables(self):
        pandas = __import__("pandas")
        with tempfile.TemporaryDirectory() as folder:
            run(PROGRAM, "replay", DUAL, "--csv", folder, "--segments", f"{folder}/segments.csv", "--return", "strongest")
            sweep = next(sweepd.replay(DUAL, return_="strongest"))
            with open(f"{folder}/sweep_{sweep.sequence:06}.csv") as table:
                rows = list(csv.DictReader(table))
            first, other = sweep.to_pandas(), sweep.to_pandas(other=True)
            made = pandas.concat([first, other]).sort_values(["column", "row"], kind="stable")
            self.assertEqual(len(rows), len(made))
            for name in ("column", "row", "reflectivity", "label", "time_ns"):
                self.assertEqual([int(row[name]) for row in rows], made[name].tolist(), name)
            for name in ("range_m", "x_m", "y_m", "z_m"):
                off = np.abs(np.array([float(row[name]) for row in rows]) - made[name].to_numpy())
                self.assertLess(off.max(), 0.000_051, name)
            mask = sweep.label >= 2
            of_segments = first[first["label"] >= 2]["time_ns"].to_numpy()
            self.assertTrue((sweep.when(mask & (sweep.range > 0)) == of_segments).all())
            self.assertEqual(sweep.when((3, 5)), sweep.when()[3, 5])

            run(sys.executable, TOP / "examples/python/segments.py", DUAL, f"{folder}/made.csv")
            run(PROGRAM, "replay", DUAL, "--segments", f"{folder}/expected.csv")
            made, expected = (pandas.read_csv(f"{folder}/{name}.csv") for name in ("made", "expected"))
            self.assertEqual(len(made), len(expected))
            for name in made.columns:
                if name == "sensor":
                    self.assertTrue((made[name] == expected[name]).all())
                else:
                    self.assertLess((made[name].astype(float) - expected[name]).abs().max(), 0.000_06, name)

    @unittest.skipUnless(__import__("importlib.util").util.find_spec("pandas"), "no pandas")
    def test_examples_say_what_they_want(self):
        # test_fleet.py has that one, which imports more.
        examples = [example for example in (TOP / "examples/python").glob("*.py") if example.name != "fleet.py"]
        for example in [TOP / "examples/consumer.py", *examples]:
            ran = subprocess.run([sys.executable, str(example)], capture_output=True, text=True)
            self.assertEqual((ran.returncode, ran.stdout), (1, ""), example)
            self.assertRegex(ran.stderr, f"{example.name} [A-Z]")
            self.assertNotIn("Traceback", ran.stderr)

    @unittest.skipUnless(__import__("importlib.util").util.find_spec("open3d"), "no open3d")
    def test_open3d(self):
        sweep = next(sweepd.replay(DUAL))
        cloud = sweep.to_open3d(sweep.points("ros"))
        expected = sweep.points("ros")[sweep.range > 0]
        self.assertTrue(np.allclose(cloud.point.positions.numpy(), expected, rtol=1e-6))
        self.assertEqual(cloud.point.label.numpy()[:, 0].tolist(), sweep.label[sweep.range > 0].tolist())


INTERRUPTED = """
import os, sys, time, sweepd
seconds, *args = sys.argv[1:]
try:
    print("begun", flush=True)
    for sweep in sweepd.Client(*args) if args[1:] else sweepd.replay(*args):
        time.sleep(float(seconds))
except KeyboardInterrupt:
    with open(f"/proc/self/task/{os.getpid()}/children") as children:
        print("children:", children.read())
"""


class Running(unittest.TestCase):
    """What a program publishes on this host."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = f"{folder.name}/root"
        command = [PROGRAM, "replay", DUAL, "--publish", "roof", "--loop", "--root", self.root]
        self.publisher = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(self.publisher.wait)
        self.addCleanup(self.publisher.terminate)
        self.client = sweepd.Client("roof", self.root)
        self.assertIsNotNone(self.client.next(timeout=60))

    def test_memory_stays_while_an_array_looks_at_it(self):
        kept = [self.client.next().range[3:], next(self.client).beams]
        content = [array.tobytes() for array in kept]
        for at in range(2):
            with self.assertRaises(ValueError):
                kept[at].flags.writeable = True
        with self.assertRaisesRegex(sweepd.SweepdError, "holds.*sweeps"):
            self.client.next(timeout=60)
        is_told = self.assertRaisesRegex(sweepd.SweepdError, "holds.*in a notebook, show `sweep.copy")
        with mock.patch.dict(sys.modules, IPython=None), is_told:
            self.client.next(timeout=60)
        # Given back by another thread.
        thread = threading.Thread(target=kept.pop)
        thread.start()
        thread.join()
        sequence = self.client.latest(timeout=60).sequence
        self.assertGreater(self.client.next(timeout=60).sequence, sequence)
        # What is held outlives its client.
        del self.client
        gc.collect()
        time.sleep(0.5)
        self.assertEqual(kept[0].tobytes(), content[0])

    def test_what_is_there_is_named(self):
        self.assertEqual(sweepd.sensors(self.root), ["roof"])
        self.assertEqual(sweepd.sensors(f"{self.root}/none"), [])
        with self.assertLogs("sweepd", "WARNING") as logs:
            typo = sweepd.Client("typo", self.root)
            while not logs.output:
                self.assertIsNone(typo.next(timeout=1))
            self.assertIsNone(typo.next(timeout=1))
        self.assertEqual(len(logs.output), 1)
        self.assertRegex(logs.output[0], "sweeps of `typo`.*: `roof`")
        for wrong in ("", "roof\0x", self.root, "\udcff", "x" * 300):
            with self.assertRaisesRegex(sweepd.SweepdError, "cannot be the name"):
                sweepd.Client(wrong, self.root)
        with self.assertRaisesRegex(sweepd.SweepdError, "is a str.* not b'roof'"):
            sweepd.Client(b"roof", self.root)
        with self.assertRaisesRegex(sweepd.SweepdError, "cannot be a folder"):
            sweepd.sensors(f"{self.root}\0x")

    def test_silence_is_told(self):
        objects = self.client.objects()
        with self.assertLogs("sweepd", "WARNING") as logs:
            self.assertIsNone(objects.next(timeout=4))
        self.assertRegex(logs.output[0], "`roof` is published, but without objects")
        # It cannot say that it is gone.
        self.publisher.kill()
        self.publisher.wait()
        while self.client.next(timeout=0) is not None:
            pass
        with self.assertLogs("sweepd", "WARNING") as logs:
            for _ in range(5):
                self.assertIsNone(self.client.next(timeout=1))
        self.assertEqual(len(logs.output), 1)
        self.assertRegex(logs.output[0], "nothing comes of `roof`: is its daemon alive")

    def test_a_forked_child_makes_a_client_of_its_own(self):
        held = self.client.next(timeout=60)
        for _ in range(40):
            child = os.fork()
            if child == 0:
                status = 1
                try:
                    with self.assertRaisesRegex(sweepd.SweepdError, "process that forked: make one here"):
                        self.client.next(timeout=0)
                    with self.assertRaisesRegex(sweepd.SweepdError, "make one here"):
                        self.client.objects()
                    self.assertIn("the process that forked", repr(self.client))
                    # It ends as those of multiprocessing do: nothing is closed.
                    status = 0 if sweepd.Client("roof", self.root).next(timeout=60) is not None else 2
                finally:
                    os._exit(status)
            self.assertEqual(os.waitpid(child, 0)[1], 0)
        del held
        self.assertIsNone(self.publisher.poll())
        for _ in range(3):
            self.assertIsNotNone(self.client.next(timeout=60))

    def test_what_is_followed_shows_itself(self):
        sweep = self.client.next(timeout=60)
        self.assertRegex(repr(sweep), f"roof, sequence {sweep.sequence}, .*{len(sweep.columns)} x 16")
        self.assertRegex(repr(self.client), "Client sensor roof, published yes")
        self.assertIn("<td>&lt;b&gt;</td>", _show.table("Client", {"sensor": "<b>"}))
        png = __import__("base64").b64decode(re.search('base64,([^"]*)', sweep._repr_html_()).group(1))
        size = int.from_bytes(png[33:37], "big")
        pixels = np.frombuffer(zlib.decompress(png[41 : 41 + size]), np.uint8).reshape(16, -1)[:, 1:]
        self.assertTrue(((pixels == 0) >= (sweep.range.T == 0)).all() and pixels.any())

    def test_ctrl_c_is_quiet(self):
        pipe = f"{self.root}/pipe"
        os.mkfifo(pipe)
        # At a sweep, and in a wait for the first and for the next ones.
        for args in (("60", DUAL), ("0", pipe), ("0", "roof", self.root), ("0", "typo", self.root)):
            command = ["env", "--default-signal=INT", sys.executable, "-W", "error", "-c", INTERRUPTED, *args]
            program = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
            )
            program.stdout.readline()
            time.sleep(2)
            # As a terminal does.
            os.killpg(program.pid, signal.SIGINT)
            said = program.communicate(timeout=60)
            self.assertEqual((said, program.returncode), (("children: \n", ""), 0), args)

    def test_a_missing_library_and_another_version_are_told(self):
        for change, words in (
            (mock.patch.dict(os.environ, SWEEPD_LIBRARY="/none.so"), "/none.so.*install a wheel"),
            (mock.patch.dict(os.environ, SWEEPD_LIBRARY="libc.so.6"), "libc.so.6 is not the library of sweepd"),
            (mock.patch.object(_library, "ABI_VERSION", 99), "version 1 of its interface.* version 99"),
            (mock.patch.dict(_library._FUNCTIONS, sweepd_newer=(None,)), "has no sweepd_newer: it is older"),
        ):
            _library.library.cache_clear()
            with change, self.assertRaisesRegex(sweepd.SweepdError, words):
                sweepd.Client("roof")
        _library.library.cache_clear()

    def test_help_has_every_attribute(self):
        for of in (sweepd.Sweep, sweepd.ObjectsMessage):
            text = pydoc.plaintext.document(of)
            for name in of.__annotations__:
                self.assertRegex(text, f"(?m)^ \\|  {name}\n \\|      [(A]")
        for name in ("name", "root", "model", "is_published"):
            self.assertRegex(pydoc.plaintext.document(sweepd.Client), f"(?m)^ \\|  {name}\n \\|      [A-Z]")


class Geometry(unittest.TestCase):
    """Points."""

    @classmethod
    def setUpClass(cls):
        with tempfile.TemporaryDirectory() as folder:
            # Its calibration is complete after 1.2 s.
            capture = simulate(folder, "--model=hdl64e-s3", "--seconds=1.6")
            cls.sweeps = [*sweepd.replay(capture, partial=True), next(sweepd.replay(DUAL))]

    def test_points_are_those_of_the_formula_and_no_slower(self):
        for sweep in self.sweeps:
            self.assertTrue(np.allclose(sweep.points(), plain(sweep), rtol=0, atol=1e-9, equal_nan=True))
        sweep = max(self.sweeps, key=lambda sweep: sweep.range.size)
        self.assertGreater(sweep.range.size, 64 * 2000)
        ways = {
            "points": sweep.points,
            'points("ros")': lambda: sweep.points("ros"),
            "formula": lambda: plain(sweep),
            "formula of straight beams": lambda: plain(sweep, bends=False),
        }
        best = dict.fromkeys(ways, float("inf"))
        for _, (name, way) in itertools.product(range(7), ways.items()):
            # What other programs take of the cores does not count.
            begun = time.process_time()
            way()
            best[name] = min(best[name], 1e3 * (time.process_time() - begun))
        print(f"{sweep.range.shape}", {name: f"{ms:.1f} ms" for name, ms in best.items()}, file=sys.stderr)
        self.assertLess(best['points("ros")'], best["formula of straight beams"])

    def test_frames(self):
        data = self.sweeps[-1]._data.copy()
        header = data[: layout.HEADER.itemsize].view(layout.HEADER)[0]
        roll, pitch, yaw = 0.1, -0.2, 2.5
        header["roll_rad"], header["pitch_rad"], header["yaw_rad"] = roll, pitch, yaw
        header["position_m"] = position = (0.5, -1.5, 2.0)
        sweep = sweepd.Sweep(data)

        def about(axis, angle):
            one, other = [at for at in range(3) if at != axis]
            turn = np.identity(3)
            turn[one, one] = turn[other, other] = np.cos(angle)
            # Right-handed: x to y, y to z, z to x.
            turn[one, other] = np.sin(angle) * (1 if axis == 1 else -1)
            turn[other, one] = -turn[one, other]
            return turn

        turn = about(2, yaw) @ about(0, pitch) @ about(1, roll)
        expected = sweep.points() @ turn.T + position
        robot = sweep.points("robot")
        self.assertTrue(np.allclose(robot, expected, rtol=0, atol=1e-5, equal_nan=True))
        ros = np.stack([robot[..., 1], -robot[..., 0], robot[..., 2]], axis=-1)
        self.assertTrue(np.allclose(sweep.points("ros"), ros, rtol=0, atol=1e-9, equal_nan=True))
        for frame, pose in (("robot", sweep.mount), ("ros", sweepd.ROS @ sweep.mount)):
            expected = sweep.points(frame)
            for points in (
                sweep.points_in(pose),
                sweep.points_in(lambda when, pose=pose: np.broadcast_to(pose, (*when.shape, 4, 4))),
                sweep.points_in(np.identity(4), frame),
            ):
                self.assertTrue(np.allclose(points, expected, rtol=0, atol=1e-9, equal_nan=True))
        self.assertGreater(len(sweep.segments), 10)
        for frame, pose in (("sensor", np.identity(4)), ("robot", sweep.mount), ("ros", sweepd.ROS @ sweep.mount)):
            boxes, table = sweep.boxes(frame), sweep.segments_to_pandas(frame)
            self.assertEqual(boxes.shape, (len(sweep.segments), 2, 3))
            self.assertEqual(table["wide"].tolist(), (sweep.segments["flags"] == layout.SEGMENT_WIDE).tolist())
            for at, segment in enumerate(sweep.segments):
                corners = np.array(list(itertools.product(*zip(segment["min_m"], segment["max_m"]))), dtype=float)
                corners = corners @ pose[:3, :3].T + pose[:3, 3]
                mean = segment["centroid_m"].astype(float) @ pose[:3, :3].T + pose[:3, 3]
                expected = np.concatenate([mean, corners.min(axis=0), corners.max(axis=0)])
                self.assertTrue(np.allclose(boxes[at].ravel(), expected[3:], rtol=0, atol=1e-9))
                row = table.iloc[at][[f"{name}_{axis}_m" for name in ("centroid", "min", "max") for axis in "xyz"]]
                self.assertTrue(np.allclose(row.astype(float), expected, rtol=0, atol=1e-9))
        other = sweep.points("robot", other=True)
        self.assertTrue((np.isnan(other[..., 0]) == ~(sweep.range2 > 0)).all())
        for wrong in (lambda: sweep.points("map"), lambda: sweep.points_in(np.identity(3))):
            with self.assertRaises(ValueError):
                wrong()
        with self.assertRaisesRegex(ValueError, "one return"):
            self.sweeps[0].points(other=True)

    def test_the_nearest_obstacle(self):
        """By the labels alone, and what is no zone."""
        sweep = self.sweeps[-1]
        self.assertEqual((sweep.floor_m, sweep.mount.tolist()), (-float(sweep.header["height_m"]), np.identity(4).tolist()))
        labels = (False, sweep.label), (True, sweep.label2)
        points = np.concatenate([sweep.points(other=other)[label >= 2] for other, label in labels])
        zone = least_m, most_m = np.array([-3, 1, 0.3]), np.array([3, 30, 2.5])
        above = points - [0, 0, sweep.floor_m]
        inside = points[((above >= least_m) & (above <= most_m)).all(axis=1)]
        found = sweep.obstacle(least_m, most_m.tolist(), unlabelled=16)
        self.assertIsInstance(found, sweepd.Obstacle)
        self.assertGreater(found.label, 1)
        self.assertLess(abs(found.distance_m - np.hypot(*inside.T[:2]).min()), 1e-9)
        self.assertIsNone(sweep.obstacle(least_m, most_m, labelled=len(inside) + 1, unlabelled=16))
        with self.assertRaisesRegex(sweepd.SweepdError, "is no box"):
            sweep.obstacle(most_m, least_m)
        for size, counts in (2, {}), (3, {"labelled": -1}), (3, {"labelled": 2**32}), (3, {"unlabelled": 2**32 + 4}):
            with self.assertRaisesRegex(ValueError, "0 to 4294967295"):
                sweep.obstacle([0] * size, [1] * size, **counts)
        with self.assertRaisesRegex(TypeError, "integer"):
            sweep.obstacle([0, 0, 0], [1, 1, 1], labelled=2.5)
        self.assertEqual(sweep.obstacle(*zone, labelled=np.uint8(3)), sweep.obstacle(*zone))

    def test_a_deskewed_cloud_is_sharp(self):
        """Six turns of a room, seen from a robot that moves and turns: cells of 10 cm that its walls and shelves are in."""
        cells = []
        with tempfile.TemporaryDirectory() as folder:
            motion = ["--velocity=0.5,3", "--turn-rate=40"]
            capture = simulate(folder, "--model=vlp16", "--scene=room", "--seconds=0.6", *motion)
            for given in (("0.5", "3", "40"), ("0", "0", "0")):
                out = pathlib.Path(folder) / "cloud.ply"
                run(sys.executable, TOP / "examples/python/deskew.py", capture, *given, out)
                head, _, body = out.read_bytes().partition(b"end_header\n")
                points = np.array(body.split(), dtype=float).reshape(-1, 3)
                self.assertIn(f"element vertex {len(points)}\n".encode(), head)
                upright = points[(points[:, 2] > 0.3) & (points[:, 2] < 1.0), :2]
                cells.append(len(np.unique(np.floor(upright / 0.1).astype(int), axis=0)))
        print(cells, "cells", file=sys.stderr)
        self.assertLess(2 * cells[0], cells[1])


class Told(unittest.TestCase):
    """Objects, of messages written by hand."""

    def setUp(self):
        header = np.zeros(1, layout.OBJECTS_HEADER)
        header["magic"], header["version"], header["header_bytes"] = layout.OBJECTS_MAGIC, layout.OBJECTS_VERSION, 192
        header["objects"], header["labels"], header["first_label"], header["name"] = 2, 3, 5, b"roof"
        header["sequence"], header["time_ns"], header["flags"] = 7, 1_790_000_000_123_456_789, layout.OBJECTS_LAST
        # It looks to the left of the robot.
        header["position_m"], header["yaw_rad"] = (1, 2, 3), np.pi / 2
        objects = np.zeros(2, layout.OBJECT)
        objects["segment"]["min_m"], objects["segment"]["max_m"] = [(1, 2, 3), (-1, 0, 0)], [(4, 6, 8), (1, 1, 1)]
        objects["why"], objects["last_ns"] = (layout.WHY_SEAM, layout.WHY_COMPLETE), (-1, 2_000_000_000)
        self.header, self.body = header, objects.tobytes() + np.array([2, 0, 3], layout.LABEL).tobytes()

    def data(self, **changes):
        header = self.header.copy()
        for key, value in changes.items():
            header[key] = value
        return header.tobytes() + self.body

    def test_what_is_told(self):
        message = sweepd.ObjectsMessage(self.data())
        self.assertEqual((message.sequence, message.name, message.is_last), (7, "roof", True))
        self.assertEqual((message.labels.tolist(), message.is_segment.tolist()), ([2, 0, 3], [False, True]))
        # The nanosecond counts: f64 would not have it.
        self.assertEqual(message.when().tolist(), [1_790_000_000_123_456_788, 1_790_000_002_123_456_789])
        self.assertEqual(message.boxes().tolist(), [[[1, 2, 3], [4, 6, 8]], [[-1, 0, 0], [1, 1, 1]]])
        # x is -y of the sensor there, and y its x.
        robot = [[[-5, 3, 6], [-1, 6, 11]], [[0, 1, 3], [1, 3, 4]]]
        self.assertTrue(np.allclose(message.boxes("robot"), robot, rtol=0, atol=1e-6))
        ros = [[[3, 1, 6], [6, 5, 11]], [[1, -1, 3], [3, 0, 4]]]
        self.assertTrue(np.allclose(message.boxes("ros"), ros, rtol=0, atol=1e-6))
        with self.assertRaisesRegex(ValueError, "no frame"):
            message.boxes("map")
        for array in (message.objects, message.labels):
            with self.assertRaises(ValueError):
                array[0] = 0
        empty = sweepd.ObjectsMessage(self.data(objects=0, labels=0))
        self.assertEqual((empty.boxes("ros").shape, empty.when().shape, empty.labels.shape), ((0, 2, 3), (0,), (0,)))

    def test_it_is_a_copy(self):
        data = np.frombuffer(self.data(), np.uint8).copy()
        message = sweepd.ObjectsMessage(data)
        data[:] = 0
        self.assertEqual((message.sequence, message.labels.tolist()), (7, [2, 0, 3]))

    def test_what_is_none_is_refused(self):
        whole = self.data()
        cases = {
            "magic": self.data(magic=b"sweepd\r\n"),
            "objects of version 2, and this program reads version 1": self.data(version=2),
            "hold 3 objects": self.data(objects=3),
            "hold 4294967295 objects": self.data(objects=2**32 - 1),
            "4294967295 labels": self.data(labels=2**32 - 1),
            "395 bytes": whole[:-1],
            "191 bytes": whole[:191],
            "^0 bytes": b"",
        }
        for words, data in cases.items():
            with self.assertRaisesRegex(sweepd.LayoutError, words):
                sweepd.ObjectsMessage(data)


if __name__ == "__main__":
    unittest.main()
