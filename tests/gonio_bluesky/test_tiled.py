"""A run's documents go into a Tiled server and come back, where Tiled is installed (it is large, and in no extra)."""

import copy
import math
from pathlib import Path

import pytest
from gonio_bluesky.event_files import read, write

from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from tests.gonio.numpy_rig import Plugin, measured, plan_in

pytest.importorskip("tiled", reason="tiled is not installed: pip install 'tiled[all]' bluesky-tiled-plugins")
plugins = pytest.importorskip("bluesky_tiled_plugins", reason="bluesky-tiled-plugins is not installed")


@pytest.mark.filterwarnings("ignore")  # theirs
def test_tiled_reads_back_every_key_bit_for_bit(tmp_path: Path) -> None:
    from tiled.client import from_context, from_uri
    from tiled.server import SimpleTiledServer

    rig = Plugin(options={"pushes": {3: 99}})  # a step without frames
    run = measured(plan_in(tmp_path), tmp_path / "RUN", rig)
    run.write_table(brdf.reduce(Run.open(run.path)))
    write(str(run.path), tmp_path / "run.jsonl")
    told = list(read(tmp_path / "run.jsonl"))
    names = {d["uid"]: d["name"] for kind, d in told if kind == "descriptor"}
    with SimpleTiledServer(readable_storage=[str(run.path)]) as server, from_uri(server.uri).context as context:
        client = from_context(context)
        writer = plugins.TiledWriter(client)
        for kind, document in told:
            writer(kind, copy.deepcopy(document))
        there = client[told[0][1]["uid"]]
        assert there.metadata["stop"]["exit_status"] == "success"
        for stream in ("primary", "reference", "dark", "reduced", "journal"):
            rows = [d["data"] for kind, d in told if kind == "event" and names[d["descriptor"]] == stream]
            for key in rows[0]:
                if key == "frames":
                    continue
                back = [value.tolist() if hasattr(value, "tolist") else value for value in there[stream][key].read()]
                assert [_plain(value) for value in back] == [_plain(row[key]) for row in rows], (stream, key)


def _plain(value: object) -> object:
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return "not known" if value is None or (isinstance(value, float) and math.isnan(value)) else value
