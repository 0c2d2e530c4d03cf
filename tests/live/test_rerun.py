"""Rerun: a recording that is read back, and a server on the loopback."""

import time

import numpy as np
import pytest

from live.shown_drive import CAMERAS, LOOPBACK, WHEELS, addresses_of, show
from offpiste.core.errors import LiveError
from offpiste.live.viewers import VIEWERS
from transport.routers import free_port

pytest.importorskip("rerun")
chunks = pytest.importorskip("rerun.chunk")


def read_back(path):
    """Return the columns of each entity of a recording."""
    found: dict[str, dict[str, list]] = {}
    for chunk in chunks.RrdReader(str(path)).stream().to_chunks():
        if not chunk.entity_path.startswith("/__"):
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if ":" in name:
                    column = batch.column(batch.schema.names.index(name)).to_pylist()
                    found.setdefault(chunk.entity_path, {}).setdefault(name, []).extend(column)
                elif name == "robot":
                    values = batch.column(batch.schema.names.index(name)).cast("int64").to_pylist()
                    found.setdefault(chunk.entity_path, {}).setdefault(name, []).extend(values)
    return found


def test_a_recording_holds_the_drive(tmp_path):
    file = tmp_path / "drive.rrd"
    viewer = VIEWERS["rerun"](str(file), WHEELS, CAMERAS)
    assert viewer.where == f"Rerun: {file}"
    show(viewer)
    viewer.close()
    found = read_back(file)
    assert found["/world/vehicle"]["robot"] == [1000_500_000_000]
    assert found["/world/vehicle"]["Transform3D:translation"] == [[[0.0, 0.0, 0.0]]], "relative to the first place"
    plan = found["/world/plan"]["LineStrips3D:strips"][0]
    assert len(plan) == 49
    assert plan[1] == [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    assert len(set(found["/world/plan"]["LineStrips3D:colors"][0])) > 40, "colours of speed"
    course = found["/world/course"]
    assert [len(strip) for strip in course["LineStrips3D:strips"][0]] == [50], "one strip of one colour"
    assert course["LineStrips3D:colors"] == [[0x010203FF]]
    assert course["LineStrips3D:radii"] == [[pytest.approx(0.06)]]
    np.testing.assert_allclose(np.array(found["/world/map"]["Points3D:positions"][0])[:, 0], np.arange(50))
    assert found["/events"]["TextLog:text"] == [["stopping: no plan"]]
    assert found["/mode/mode"]["Scalars:scalars"] == [[1.0]]
    assert found["/latencies/plan_ms"]["Scalars:scalars"] == [[80.0]]
    assert bytes(found["/images/front"]["EncodedImage:blob"][0][0]).startswith(b"\xff\xd8")
    with pytest.raises(LiveError, match="already exists"):
        VIEWERS["rerun"](str(file), WHEELS, CAMERAS)


def test_it_listens_on_the_loopback_alone_and_a_taken_port_is_one_line():
    port = free_port()
    viewer = VIEWERS["rerun"](f"127.0.0.1:{port}", WHEELS, CAMERAS)
    assert viewer.where == f"Rerun: rerun rerun+http://127.0.0.1:{port}/proxy"
    show(viewer)
    time.sleep(0.5)
    assert addresses_of(port) == {LOOPBACK}
    with pytest.raises(LiveError, match="cannot listen there"):
        VIEWERS["rerun"](f"127.0.0.1:{port}", WHEELS, CAMERAS)
    viewer.close()
