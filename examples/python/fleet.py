"""Labels a folder of captures on a cluster of Dask: fleet.py CAPTURES OUT [SCHEDULER].

Makes OUT/NAME.parquet of each capture: a row for each return. Run it again after it was stopped: what is finished is left
out. SCHEDULER is the address of a cluster whose machines all see both folders and have the package `sweepd`; without it the
processes of this machine do it. Needs: pip install sweepd-*.whl pandas pyarrow "dask[distributed]"
"""

import os
import sys
import uuid
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import sweepd

# How the names of captures end. `sweepd replay` also takes other compressions, and folders of ROS 2 bags.
ENDINGS = (".pcap", ".pcapng", ".pcap.gz", ".pcapng.gz", ".mcap", ".bag", ".db3")
# Given, and not of the first sweep, which may be empty.
SCHEMA = pa.schema(
    {
        "column": pa.int32(), "row": pa.int32(), "range_m": pa.float32(), "reflectivity": pa.uint8(), "label": pa.uint32(),
        "time_ns": pa.int64(), "x_m": pa.float64(), "y_m": pa.float64(), "z_m": pa.float64(),
        "sensor": pa.string(), "seq": pa.int64(),
    }
)  # fmt: skip


def rows(sweep):
    """What is kept of a sweep: a row for each return. For `segments_to_pandas` SCHEMA must have its columns."""
    table = sweep.to_pandas(sweep.points("robot")).assign(sensor=sweep.name or sweep.sensor, seq=sweep.sequence)
    return pa.Table.from_pandas(table, SCHEMA, preserve_index=False)


def label(capture, out):
    """Makes the table of a capture, and gives the number of its sweeps, or why there are none."""
    out.parent.mkdir(parents=True, exist_ok=True)
    # A name of its own: another run may still be at the same capture.
    unfinished = out.with_name(f"{out.name}.{uuid.uuid4().hex}.unfinished")
    count = 0
    try:
        with pq.ParquetWriter(unfinished, SCHEMA) as table:
            # One thread: the cluster has a process for each core.
            for sweep in sweepd.replay(capture, jobs=1):
                table.write_table(rows(sweep))
                count += 1
        os.replace(unfinished, out)
    except sweepd.SweepdError as error:
        return str(error)
    finally:
        unfinished.unlink(missing_ok=True)
    return count


def main(captures, out, *scheduler):
    """Has the cluster make all tables that are not there, and says which could not be made."""
    from dask.distributed import Client, as_completed

    files = [path for path in sorted(captures.rglob("*")) if path.name.endswith(ENDINGS) and path.is_file()]
    found = [path for path in files if out not in path.parents]
    if out == captures or not found:
        sys.exit(f"fleet.py: {captures} has no captures ({', '.join(ENDINGS)}) outside of {out}")
    tables = {path: out / f"{path.relative_to(captures)}.parquet" for path in found}
    todo = [path for path in found if not tables[path].exists()]
    bad = []
    with Client(*scheduler) if scheduler else Client(threads_per_worker=1) as cluster:
        futures = {cluster.submit(label, path, tables[path], pure=False): path for path in todo}
        for done, future in enumerate(as_completed(futures), start=1):
            # An exception is no matter of the capture: the disk is full, or a machine is gone.
            error = future.exception()
            result = future.result() if error is None else repr(error)
            is_made = isinstance(result, int)
            print(f"{done} of {len(todo)}: {futures[future]}: {f'{result} sweeps' if is_made else 'bad'}", flush=True)
            if not is_made:
                bad.append(f"{futures[future]}: {result}")
    print(f"{len(found) - len(todo)} were there before, {len(todo) - len(bad)} are new, {len(bad)} are bad")
    sys.exit("\n".join(bad) or 0)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit("usage: fleet.py CAPTURES OUT [SCHEDULER]")
    main(Path(sys.argv[1]).absolute(), Path(sys.argv[2]).absolute(), *sys.argv[3:])
