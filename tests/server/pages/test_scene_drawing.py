"""The drawing says what the real geometry says."""

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring.footprint import footprints_m
from exceptiondrive_server.pages import scene_drawing as drawing
from exceptiondrive_server.pages.scene_geometry import (
    convex_hull,
    footprint,
    headings_rad,
    nearest_positions,
)


def test_footprints_are_those_of_the_scorer(protocol: Protocol) -> None:
    edited, _ = drawing._trajectories(protocol.geometry)
    ours = drawing._footprints(edited, protocol.geometry)
    theirs = footprints_m(np.array([edited]), protocol.geometry)[0]
    assert np.allclose(np.array(ours), theirs, atol=1e-9)


def test_the_pictured_sample_passes_at_sixty_per_cent_of_the_required_clearance(
    protocol: Protocol,
) -> None:
    scene = drawing.scene_drawing(protocol)
    assert scene.task.id == "BG1"
    assert scene.clearance_m == pytest.approx(0.6 * 0.8, abs=1e-6)
    assert scene.hcc == pytest.approx(0.6, abs=1e-6)
    assert scene.hpr == pytest.approx(0.8 / (0.32 + 0.8), abs=1e-6)


def test_the_drawing_follows_the_document(protocol: Protocol) -> None:
    wider = protocol.geometry.model_copy(update={"footprint_width_m": 2.4, "waypoints": 8})
    grading = protocol.grading.model_copy(update={"d_safe_scale": 2.0})
    changed = protocol.model_copy(update={"geometry": wider, "grading": grading})
    scene = drawing.scene_drawing(changed)
    assert scene.d_safe_m == pytest.approx(1.6)
    assert scene.clearance_m == pytest.approx(0.96, abs=1e-6)
    assert len(scene.waypoints) == 8
    boxes = changed.geometry.model_copy(update={"collision_tube": "footprints"})
    assert len(drawing.scene_drawing(changed.model_copy(update={"geometry": boxes})).tube) == 9


def test_a_straight_footprint_stands_where_the_protocol_says() -> None:
    corners = footprint((0, 0), 0.0, 4.0, 2.0, 1.5)
    assert corners == ((3.5, 1.0), (-0.5, 1.0), (-0.5, -1.0), (3.5, -1.0))


def test_a_short_step_holds_the_heading_and_reversing_does_not_turn_the_car() -> None:
    assert headings_rad([(0, 0), (0, 0.05)], 0.1, 90) == (0.0, 0.0)
    assert headings_rad([(0, 0), (-1, 0)], 0.1, 90)[1] == pytest.approx(0.0)


def test_the_hull_drops_inner_positions_and_distances_are_exact() -> None:
    assert set(convex_hull([(0, 0), (2, 0), (2, 2), (0, 2), (1, 1)])) == {
        (0, 0),
        (2, 0),
        (2, 2),
        (0, 2),
    }
    a, b = nearest_positions(((0, 0), (1, 0), (1, 1)), ((3, 0.5), (4, 0), (4, 1)))
    assert (a, b) == ((1.0, 0.5), (3, 0.5))
