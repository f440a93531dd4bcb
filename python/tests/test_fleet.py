"""`examples/python/fleet.py` on a cluster of two workers. The variable SWEEPD names the program."""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from unittest import mock

import numpy as np
import pyarrow.parquet as pq
import sweepd
from dask.distributed import LocalCluster

TOP = pathlib.Path(__file__).parents[2]
FIXTURES = [TOP / "pcap_fixtures" / name for name in ("street_vlp16_losses.pcap", "street_vlp16_dual.pcap.gz")]
LIMIT_S = 120


class Fleet(unittest.TestCase):
    """A folder of captures, good and bad."""

    def test_a_fleet_goes_on_where_it_was_stopped(self):
        with tempfile.TemporaryDirectory() as folder, LocalCluster(2, threads_per_worker=1, dashboard_address=None) as two:
            captures, out = pathlib.Path(folder, "captures"), pathlib.Path(folder, "captures/tables")
            for number, fixture in enumerate(4 * FIXTURES):
                (captures / f"day{number % 3}").mkdir(parents=True, exist_ok=True)
                shutil.copy(fixture, captures / f"day{number % 3}/{number}_{fixture.name}")
            (captures / "notes.pcap").write_text("no capture")
            (captures / "notes.txt").write_text("not by its name either")
            command = [sys.executable, TOP / "examples/python/fleet.py", captures, out, two.scheduler_address]

            def finished():
                return {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}

            # Killed when something is finished: a line names it.
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as first:
                self.assertTrue(any(line.endswith(" sweeps\n") for line in first.stdout))
                first.kill()
            # Its workers may still be at captures. And as a machine leaves one that it was at when it went down:
            table = out / f"day0/0_{FIXTURES[0].name}.parquet"
            table.unlink(missing_ok=True)
            half = table.with_name(f"{table.name}.unfinished")
            before = finished()
            half.write_text("half")
            second = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
            self.assertEqual(second.returncode, 1, second.stderr)
            self.assertEqual(len(second.stderr.splitlines()), 1, second.stderr)
            self.assertRegex(second.stderr, "notes.pcap: .*notes.pcap")
            old, new = map(int, re.search(r"(\d+) were there before, (\d+) are new, 1 are bad", second.stdout).groups())
            self.assertTrue(old + new == 8 and old >= len(before), second.stdout)
            after = finished()
            self.assertTrue(len(after) == 8 and before.items() <= after.items())
            self.assertEqual(list(out.rglob("*.unfinished")), [half])
            for table in after:
                sweeps = list(sweepd.replay(captures / table.relative_to(out).with_suffix("")))
                made = pq.read_table(table).to_pandas()
                for name in ("label", "time_ns", "z_m"):
                    expected = np.concatenate([sweep.to_pandas(sweep.points("robot"))[name] for sweep in sweeps])
                    self.assertTrue((made[name] == expected).all(), f"{table}: {name}")
            # All that is left is the bad one.
            (captures / "notes.pcap").unlink()
            third = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
            self.assertEqual((third.returncode, third.stderr), (0, ""), third.stdout)

    def test_what_cannot_be_is_told_at_once(self):
        with tempfile.TemporaryDirectory() as folder:
            full = pathlib.Path(folder, "full")
            full.mkdir()
            shutil.copy(FIXTURES[0], full)
            none = "has no captures"
            wrong = [(f"{folder}/none", "out"), (full, full), (TOP / "python", "out")]
            for args, words in [((), "usage"), *((args, none) for args in wrong)]:
                script = TOP / "examples/python/fleet.py"
                said = subprocess.run([sys.executable, script, *args], capture_output=True, text=True, cwd=folder)
                self.assertEqual((said.returncode, said.stdout, said.stderr.count("\n")), (1, "", 1), said.stderr)
                self.assertIn(words, said.stderr)

    def test_a_table_does_not_depend_on_the_first_sweep(self):
        sys.path.insert(0, str(TOP / "examples/python"))
        fleet = __import__("fleet")
        sweep = next(sweepd.replay(FIXTURES[1]))
        empty = sweep.copy()
        empty.range[:] = 0
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder, "table.parquet")
            with mock.patch.object(sweepd, "replay", return_value=iter([empty, sweep])):
                self.assertEqual(fleet.label("capture", out), 2)
            self.assertEqual(pq.read_table(out).schema.types, fleet.SCHEMA.types)
            self.assertEqual(pq.read_metadata(out).num_rows, (sweep.range > 0).sum())
            # Whatever goes wrong, nothing is left.
            with mock.patch.object(fleet, "rows", side_effect=KeyboardInterrupt), self.assertRaises(KeyboardInterrupt):
                fleet.label(FIXTURES[1], pathlib.Path(folder, "other.parquet"))
            self.assertEqual([path.name for path in pathlib.Path(folder).iterdir()], [out.name])


if __name__ == "__main__":
    unittest.main()
