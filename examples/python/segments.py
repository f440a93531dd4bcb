"""Writes the segments of a capture as a table: segments.py CAPTURE OUT.csv. Needs pandas."""

import sys

import pandas as pd
import sweepd

if len(sys.argv) != 3:
    sys.exit(__doc__)
capture, out = sys.argv[1:]
table = pd.concat(sweep.segments_to_pandas() for sweep in sweepd.replay(capture))
print(table.groupby("seq").agg(segments=("label", "count"), nearest_m=("nearest_m", "min")))
table.to_csv(out, index=False)
