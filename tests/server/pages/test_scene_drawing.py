"""The drawing of a protocol is set from what the scoring code drew, and from nothing else."""

from pathlib import Path
from typing import Any

import pytest

import exceptiondrive_server
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.drawings import keep_protocol_drawing
from exceptiondrive_schemas.drawing import ProtocolDrawing, packaged_drawing, pictured_digest
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol_toml, parse_protocol
from exceptiondrive_server.boards.scene_drawing import scene_drawing

WIDER = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
WIDER = WIDER.replace("footprint_width_m = 1.85", "footprint_width_m = 2.40")


def test_it_shows_the_values_of_the_drawn_sample(protocol: ProtocolDocument) -> None:
    sample, scene = packaged_drawing().sample, scene_drawing(packaged_drawing(), protocol)
    assert scene.is_own
    assert scene.task_id == sample.task == "BG1"
    assert (scene.clearance_m, scene.d_safe_m) == (sample.clearance_m, 0.8)
    assert (scene.hcc, scene.hpr, scene.shift_m) == tuple(
        sample.metrics[key] for key in ("hcc", "hpr", "cts")
    )
    assert (len(scene.tube), len(scene.footprints), len(scene.waypoints)) == (6, 7, 6)


def test_footprints_are_set_to_scale(protocol: ProtocolDocument) -> None:
    scene = scene_drawing(packaged_drawing(), protocol)
    (ax, ay), (bx, by) = (
        tuple(map(float, corner.split(","))) for corner in scene.footprints[0].split()[:2]
    )
    length_px = ((ax - bx) ** 2 + (ay - by) ** 2) ** 0.5
    px_per_m = scene.width / (20.6 + 2.2)
    assert length_px == pytest.approx(protocol.geometry.footprint_length_m * px_per_m, abs=0.3)


async def test_until_its_own_is_made_a_protocol_shows_that_of_the_first_and_says_so(
    site: Any,
) -> None:
    with site.database.write() as session:
        add_protocol(session, WIDER, "test")
    site.create_phase("wide", protocol="1.1")
    assert "Drawn under protocol 1.0" in (await site.get("/protocols/1.1")).text
    own = pictured_digest(parse_protocol(WIDER))
    moved = packaged_drawing().sample.model_copy(update={"clearance_m": 0.4321})
    with site.database.write() as session:
        keep_protocol_drawing(session, ProtocolDrawing(pictured=own, sample=moved))
    text = (await site.get("/protocols/1.1")).text
    assert "0.432 m here" in text
    assert "Drawn under protocol 1.0" not in text


def test_the_server_holds_no_geometry_of_its_own() -> None:
    folder = Path(exceptiondrive_server.__path__[0])
    code = "\n".join(path.read_text("utf-8") for path in folder.rglob("*.py"))
    for word in ("convex_hull", "headings_rad", "nearest_positions", "footprints_m"):
        assert word not in code
