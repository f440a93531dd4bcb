"""`examples/python/fleet.py` on a cluster of two workers. The variable SWEEPD names the program."""

import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

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
            command = [sys.executable, TOP / "examples/python/fleet.py", captures, out, two.scheduler_address]

            def finished():
                return {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}

            # Killed when something is finished: a line names it.
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as first:
                self.assertTrue(any(line.endswith(" sweeps\n") for line in first.stdout))
                first.kill()
            time.sleep(2)
            # As a machine leaves a capture that it was at when it went down.
            table = out / f"day0/0_{FIXTURES[0].name}.parquet"
            table.unlink(missing_ok=True)
            half = table.with_name(f"{table.name}.unfinished")
            before = finished()
            half.write_text("half")
            second = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
            self.assertEqual(second.returncode, 1, second.stderr)
            self.assertEqual(len(second.stderr.splitlines()), 1, second.stderr)
            self.assertRegex(second.stderr, "notes.pcap: .*notes.pcap")
            self.assertIn(f"{len(before)} were there before, {8 - len(before)} are new, 1 are bad", second.stdout)
            after = finished()
            self.assertTrue(len(after) == 8 and before.items() <= after.items())
            self.assertEqual(list(out.rglob("*.unfinished")), [])
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


if __name__ == "__main__":
    unittest.main()
