"""`exceptiondrive plot`: pictures of samples, drawn by the scoring code's own geometry."""

import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest
from typer.testing import CliRunner

from exceptiondrive import InvalidArgumentError, InvalidFileError, StrategyRecorder
from exceptiondrive.checking import manifest_of
from exceptiondrive.cli import app
from exceptiondrive.inputs import given_bytes, given_split
from exceptiondrive.plot import Scenes, picture, plot_file
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.drawing import View
from exceptiondrive_schemas.protocol import packaged_protocol

MakeFile = Callable[..., Path]
SVG = "{http://www.w3.org/2000/svg}"
FRONT_M = 1.486 + 4.084 / 2
STANDING = [[0.0, 0.0]] * 6
SHORT = [[2.0 * step, 0.0] for step in range(1, 7)]
FAR = [[4.0 * step, 0.0] for step in range(1, 7)]
PREDICTIONS = [
    {"sample_id": "s0", "source": FAR, "edited": SHORT},
    {"sample_id": "s1", "source": FAR, "edited": FAR},
    {"sample_id": "s2", "source": None, "edited": STANDING},
    {"sample_id": "s3", "source": FAR, "edited": None},
]


@pytest.fixture
def file(planning_file: MakeFile) -> Path:
    """Drives short of, into and away from regions that begin at 20 m; one is missing."""
    return planning_file(predictions=PREDICTIONS)


@pytest.fixture
def scenes(file: Path, split_file: Path) -> Scenes:
    protocol, split = packaged_protocol(), given_split(split_file)
    manifest = manifest_of(split, protocol)
    document = check(given_bytes(file).data, protocol=protocol, manifest=manifest).document
    assert document is not None
    return Scenes(document, split, protocol)


def _classes(svg: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for element in Xml.fromstring(svg).iter():
        name = element.get("class")
        if name:
            found[name] = found.get(name, 0) + 1
    return found


def test_a_scene_holds_the_clearance_by_hand(scenes: Scenes) -> None:
    scene = scenes.scene("s0")
    assert scene.clearance_m == pytest.approx(20 - 12 - FRONT_M)
    assert scene.segment is not None
    (x1, _), (x2, _) = scene.segment
    assert (x1, x2) == pytest.approx((12 + FRONT_M, 20))
    assert len(scene.footprints) == 7
    assert len(scene.tube) == 6
    assert scene.metrics["hcc"] == 1.0


def test_an_intrusion_has_no_clearance_to_draw(scenes: Scenes) -> None:
    svg = picture([scenes.scene("s1")], "one")
    assert "gap-text" not in _classes(svg)
    assert "hit; 1 m required" in svg
    assert _classes(picture([scenes.scene("s0")], "one"))["gap-text"] == 1


def test_what_is_missing_is_said_and_not_drawn(scenes: Scenes) -> None:
    without_edited, without_source = (picture([scenes.scene(s)], "one") for s in ("s3", "s2"))
    assert "no path with the hazard: counts as a hit" in without_edited
    assert "box" not in _classes(without_edited)
    assert _classes(without_edited)["source-dot"] == 6
    assert "source-dot" not in _classes(without_source)
    assert "CTS undefined" in without_source


def test_the_worst_come_first_and_missing_trajectories_not_at_all(scenes: Scenes) -> None:
    assert scenes.worst(9) == ["s1", "s0", "s2"]
    assert scenes.worst(1) == ["s1"]


def test_everything_that_moves_lies_inside_the_panel_in_one_scale(scenes: Scenes) -> None:
    for sample_id in ("s0", "s1", "s2"):
        scene = scenes.scene(sample_id)
        view = View.of([scene], 430, 240)
        for point in (*scene.edited, *scene.source, *(c for f in scene.footprints for c in f)):
            x, y = view.at(point)
            assert 0 <= x <= 430
            assert 0 <= y <= 240
        (x0, y0), (x1, y1) = view.at((0, 0)), view.at((1, 1))
        assert x1 - x0 == pytest.approx(y0 - y1)


def test_a_picture_says_in_words_what_it_shows_and_follows_light_and_dark(scenes: Scenes) -> None:
    svg = picture([scenes.scene("s0"), scenes.scene("s1")], "a & b")
    root = Xml.fromstring(svg)
    assert root.findtext(f"{SVG}title") == "a & b"
    assert "clearance 4.47 m of 2 m required" in (root.findtext(f"{SVG}desc") or "")
    assert "prefers-color-scheme:dark" in svg


def test_the_command_writes_svg_and_png(file: Path, split_file: Path, tmp_path: Path) -> None:
    svg, png = tmp_path / "out.svg", tmp_path / "out.png"
    base = ["plot", str(file), "--split", str(split_file)]
    one = CliRunner().invoke(app, [*base, "--sample", "s0", "-o", str(svg)])
    assert one.exit_code == 0, one.output
    assert "1 sample in" in one.output
    assert _classes(svg.read_text("utf-8"))["box"] == 7
    pytest.importorskip("resvg_py", reason="the extra `plot` is not installed")
    assert CliRunner().invoke(app, [*base, "--worst", "2", "-o", str(svg)]).exit_code == 0
    assert "2 of the worst, in turn of each family" in svg.read_text("utf-8")
    several = CliRunner().invoke(app, [*base, "--worst", "2", "-o", str(png), "--json"])
    assert json.loads(several.output)["sample_ids"] == ["s1", "s0"]
    assert png.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_what_cannot_be_drawn_is_refused_in_words(
    file: Path, planning_file: MakeFile, split_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.svg"
    with pytest.raises(InvalidArgumentError, match="no sample 'nowhere'"):
        plot_file(file, out, split=split_file, sample_ids=["nowhere"])
    with pytest.raises(InvalidArgumentError, match=r"neither .svg nor .png"):
        plot_file(file, tmp_path / "out.gif", split=split_file)
    with StrategyRecorder(tmp_path / "a.json", split="tiny") as recorder:
        for number in range(4):
            recorder.add(f"s{number}", strategy="C")
    with pytest.raises(InvalidArgumentError, match="Only planning files"):
        plot_file(tmp_path / "a.json", out, split=split_file)
    with pytest.raises(InvalidFileError):
        plot_file(planning_file("bad.json", split="other"), out, split=split_file)
    with pytest.raises(InvalidArgumentError, match=r"out\.svg cannot be written"):
        plot_file(file, tmp_path / "nowhere" / "out.svg", split=split_file)
    assert not out.exists()
