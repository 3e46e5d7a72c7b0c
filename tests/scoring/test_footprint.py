"""Footprints and tube pieces, by hand."""

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.drawing import tube_pieces_m
from exceptiondrive_scoring.footprint import footprints_m


def test_the_first_footprint_is_the_vehicle_at_the_origin(geometry: GeometrySection) -> None:
    corners = footprints_m(np.zeros((1, 7, 2)), geometry)
    assert corners.shape == (1, 7, 4, 2)
    expected = [[3.528, 0.925], [-0.556, 0.925], [-0.556, -0.925], [3.528, -0.925]]
    np.testing.assert_allclose(corners[0, 0], expected)


def test_a_footprint_turns_about_the_rear_axle(geometry: GeometrySection) -> None:
    corners = footprints_m(np.array([[[0.0, 0.0], [0.0, 2.0]]]), geometry)
    expected = [[-0.925, 5.528], [-0.925, 1.444], [0.925, 1.444], [0.925, 5.528]]
    np.testing.assert_allclose(corners[0, 1], expected, atol=1e-12)


def test_a_straight_tube_piece_is_one_rectangle(geometry: GeometrySection) -> None:
    pieces = tube_pieces_m(np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]]), geometry)
    assert len(pieces) == 2
    expected = {(-0.556, -0.925), (5.528, -0.925), (5.528, 0.925), (-0.556, 0.925)}
    assert {tuple(np.round(corner, 9)) for corner in pieces[0]} == expected


def test_a_turning_tube_piece_is_the_hull_of_both_footprints(geometry: GeometrySection) -> None:
    (piece,) = tube_pieces_m(np.array([[0.0, 0.0], [0.0, 2.0]]), geometry)
    # (-0.556, 0.925) lies inside, right of the line from (-0.556, -0.925) to (-0.925, 1.444)
    front_and_rear_right = {(-0.556, -0.925), (3.528, -0.925), (3.528, 0.925)}
    expected = front_and_rear_right | {(0.925, 5.528), (-0.925, 5.528), (-0.925, 1.444)}
    assert {tuple(np.round(corner, 9)) for corner in piece} == expected


def test_a_tube_of_footprints_has_one_piece_for_each_time_step(geometry: GeometrySection) -> None:
    footprints = geometry.model_copy(update={"collision_tube": "footprints"})
    points = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    pieces = np.stack(tube_pieces_m(points, footprints))
    np.testing.assert_allclose(pieces, footprints_m(points[None], footprints)[0])
