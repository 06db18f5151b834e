"""A whole export: the frames of a run as a table (docs/writing_a_sampler.md)."""

import csv
import io
from pathlib import Path

from gonio.disk import write_whole
from gonio.errors import ConfigError
from gonio.lab.acquisition.run import Run


def write(source, target):
    if target.suffix != ".csv":
        raise ConfigError(f"{target}: a list of frames is a table; name a .csv")
    run, text, count = Run.open(Path(source)), io.StringIO(), 0
    rows = csv.writer(text)
    rows.writerow(["step", "file", "band", "exposure_s", "lamp"])
    for step in run.steps():  # one at a time: a run may have 100 000
        for frame in step.frames:
            rows.writerow([step.step, frame.file, frame.band, frame.exposure_s, int(frame.lamp)])
            count += 1
    write_whole(target, text.getvalue().encode())  # under another name first: whole, or not there
    return [f"{count} frames"]
