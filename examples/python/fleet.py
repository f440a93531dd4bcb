"""Labels a folder of captures on a cluster of Dask: fleet.py CAPTURES OUT [SCHEDULER].

Makes OUT/NAME.parquet of each capture: a row for each return. Run it again after it was stopped: what is finished is left
out. SCHEDULER is the address of a cluster whose machines all see both folders and have the package `sweepd`; without it the
processes of this machine do it. Needs: pip install sweepd-*.whl pandas pyarrow "dask[distributed]"
"""

import os
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import sweepd
from dask.distributed import Client, as_completed


def rows(sweep):
    """What is kept of a sweep: x, y, z, range, label and so on, or the boxes of `segments_to_pandas`."""
    table = sweep.to_pandas(sweep.points("robot")).assign(sensor=sweep.name or sweep.sensor, seq=sweep.sequence)
    return pa.Table.from_pandas(table, preserve_index=False)


def label(capture, out):
    """Makes the table of a capture, and gives the number of its sweeps, or why there are none."""
    out.parent.mkdir(parents=True, exist_ok=True)
    unfinished = out.with_name(f"{out.name}.unfinished")
    try:
        # One thread: the cluster has a process for each core.
        sweeps = sweepd.replay(capture, jobs=1)
        first = rows(next(sweeps))
        with pq.ParquetWriter(unfinished, first.schema) as table:
            table.write_table(first)
            count = 1
            for sweep in sweeps:
                table.write_table(rows(sweep))
                count += 1
    except sweepd.SweepdError as error:
        return str(error)
    os.replace(unfinished, out)
    return count


def main(captures, out, *scheduler):
    """Has the cluster make all tables that are not there, and says which could not be made."""
    found = [path for path in sorted(captures.rglob("*")) if path.is_file() and out not in path.parents]
    tables = {path: out / f"{path.relative_to(captures)}.parquet" for path in found}
    todo = [path for path in found if not tables[path].exists()]
    bad = []
    with Client(*scheduler) if scheduler else Client(threads_per_worker=1) as cluster:
        futures = {cluster.submit(label, path, tables[path], pure=False): path for path in todo}
        for done, future in enumerate(as_completed(futures), start=1):
            # An exception is no matter of the capture: the disk is full, or a machine is gone.
            result = future.exception() or future.result()
            is_made = isinstance(result, int)
            print(f"{done} of {len(todo)}: {futures[future]}: {f'{result} sweeps' if is_made else 'bad'}", flush=True)
            if not is_made:
                bad.append(f"{futures[future]}: {result}")
    print(f"{len(found) - len(todo)} were there before, {len(todo) - len(bad)} are new, {len(bad)} are bad")
    sys.exit("\n".join(bad) or 0)


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute(), Path(sys.argv[2]).absolute(), *sys.argv[3:])
