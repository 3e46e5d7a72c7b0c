"""Pictures of samples: trajectories, footprints, collision tube, hazard region and clearance.

One sample large, or a contact sheet of several, as SVG or as PNG. Needs a split with its hazard
regions and numpy (the extra `evaluate`, or `plot`, which also writes PNG).
"""

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path

from exceptiondrive.checking import write_file
from exceptiondrive.errors import InvalidArgumentError, extra_missing
from exceptiondrive.evaluation import in_turn, sample_results, sound_file
from exceptiondrive.inputs import (
    ProtocolLike,
    SplitLike,
    SubmissionLike,
    given_split,
    given_submission,
)
from exceptiondrive_schemas.check import CheckedDocument, PlanningDocument
from exceptiondrive_schemas.drawing import SampleDrawing, caption, shapes
from exceptiondrive_schemas.printable import first_of
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split

PAD, GAP, HEAD, LEGEND, WORDS = 24, 24, 62, 34, 58
LARGE, SMALL = (880, 380), (430, 240)
LIGHT = {
    "bg": "#fffefb", "plot": "#f6f4ee", "ink": "#17191d", "soft": "#5b606b", "line": "#e2ded3",
    "safe": "#0a6285", "haz": "#bf4526",
}  # fmt: skip
DARK = {
    "bg": "#171b21", "plot": "#101317", "ink": "#eeece6", "soft": "#a2a7b1", "line": "#2a3039",
    "safe": "#5bbbe0", "haz": "#e5694a",
}  # fmt: skip
FONT = "Inter,system-ui,-apple-system,'Segoe UI',Helvetica,Arial,'DejaVu Sans',sans-serif"
SHAPES = (
    f"text{{font-family:{FONT}}}.h{{font-size:19px;font-weight:600}}.name{{font-size:14px;"
    "font-weight:600}.words{font-size:12.5px}.tick{font-size:10px;paint-order:stroke;"
    "stroke-width:3px}.gap-text{font-size:13px;"
    "font-weight:600;text-anchor:middle;paint-order:stroke;stroke-width:4px;stroke-linejoin:round}"
    ".grid{stroke-width:1;fill:none}.safe{opacity:.12;stroke-linejoin:round}"
    ".region{fill-opacity:.35;stroke-width:1.5}.source,.edited{fill:none;stroke-width:2.2}"
    ".source{stroke-dasharray:6 4}.source-dot{stroke-width:1.6}.tube{opacity:.17}"
    ".box{fill:none;stroke-width:1;stroke-opacity:.6}.gap{stroke-width:2;fill:none}"
    ".origin{stroke-width:2}"
)
LEGEND_WORDS = (
    ("source trajectory", '<path class="source" d="M0 0H26"/>'),
    ("edited trajectory", '<path class="edited" d="M0 0H26"/>'),
    ("collision tube", '<g class="tube"><path d="M0 -6H26V6H0z"/></g>'),
    ("hazard region", '<path class="region" d="M0 -6H26V6H0z"/>'),
    ("required clearance", '<path class="safe" d="M0 -6H26V6H0z" stroke-width="0"/>'),
    ("clearance", '<path class="gap" d="M0 0H26"/>'),
)
MAX_PANELS = 60
PNG_ZOOM = 2


class Scenes:
    """Draws samples with the scoring code itself (`exceptiondrive_scoring.drawing`)."""

    def __init__(self, document: CheckedDocument, split: Split, protocol: ProtocolDocument) -> None:
        from exceptiondrive_scoring.arrays import TrajectoryPairs, split_arrays
        from exceptiondrive_scoring.challenge import document_columns
        from exceptiondrive_scoring.drawing import Drawer
        from exceptiondrive_scoring.measure import measure

        if not isinstance(document, PlanningDocument):
            raise InvalidArgumentError(
                "wrong_challenge",
                "Only planning files can be drawn: strategies have no trajectories.",
                "Give a file with the schema exceptiondrive.planning/1.",
            )
        self._results = sample_results(document, split, protocol)
        self.sample_ids = tuple(sorted(sample.sample_id for sample in split.samples))
        arrays = split_arrays(split.samples, protocol.taxonomy)
        pairs = TrajectoryPairs.from_columns(document_columns(document, self.sample_ids))
        measured = measure(pairs, arrays.prepared_regions, protocol.geometry)
        self._drawer = Drawer(self.sample_ids, pairs, measured, arrays, protocol)

    def worst(self, count: int) -> list[str]:
        """Return the worst samples of those answered, in turn of each family, the deepest first."""
        answered = (each for each in self._results if each.clearance_m is not None)
        return [each.sample_id for each in in_turn(answered)][:count]

    def scene(self, sample_id: str) -> SampleDrawing:
        """Return what a picture of one sample shows.

        Raises:
            InvalidArgumentError: The split has no such sample.
        """
        if sample_id not in self.sample_ids:
            raise InvalidArgumentError(
                "unknown_sample",
                f"The split has no sample {sample_id!r}.",
                f"Its samples are {first_of(self.sample_ids)}.",
            )
        return self._drawer.drawing(self.sample_ids.index(sample_id))


def picture(
    scenes: Sequence[SampleDrawing], title: str, *, colours: dict[str, str] | None = None
) -> str:
    """Return an SVG of one or more samples; without `colours` it follows light and dark."""
    box, columns = (LARGE, 1) if len(scenes) == 1 else (SMALL, 3 if len(scenes) > 4 else 2)
    rows = -(-len(scenes) // columns)
    width = 2 * PAD + columns * box[0] + (columns - 1) * GAP
    legend_lines = _legend_lines(width - 2 * PAD)
    top = HEAD + LEGEND * len(legend_lines)
    height = top + rows * (box[1] + WORDS) + PAD / 2
    words = " ".join(f"{scene.sample_id}: {'; '.join(caption(scene))}." for scene in scenes)
    panels = [
        _panel(
            scene,
            PAD + (index % columns) * (box[0] + GAP),
            top + (index // columns) * (box[1] + WORDS),
            box,
            index,
        )
        for index, scene in enumerate(scenes)
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        f'width="{width:g}" height="{height:g}" role="img" aria-labelledby="t d">'
        f'<title id="t">{escape(title)}</title><desc id="d">{escape(words)}</desc>'
        f"<style>{_style_sheet(colours)}</style>"
        f'<rect class="paper" width="{width:g}" height="{height:g}"/>'
        f'<text class="h" x="{PAD}" y="38">{escape(title)}</text>'
        f"{_legend(legend_lines)}{''.join(panels)}</svg>\n"
    )


def _panel(scene: SampleDrawing, x: float, y: float, box: tuple[int, int], index: int) -> str:
    width, height = box
    name, words = caption(scene)
    name = f"{scene.sample_id} · {name}" if len(scene.sample_id) < 30 else name
    clip = f'<clipPath id="c{index}"><rect width="{width}" height="{height}" rx="8"/></clipPath>'
    return (
        f'<g transform="translate({x:g} {y:g})">{clip}'
        f'<rect class="plot" width="{width}" height="{height}" rx="8"/>'
        f'<g clip-path="url(#c{index})">{shapes(scene, width, height)}</g>'
        f'<text class="name" x="0" y="{height + 20}">{escape(_shortened(name, width / 8.2))}</text>'
        f'<text class="words" x="0" y="{height + 38}">{escape(_shortened(words, width / 6.2))}</text></g>'
    )


def _shortened(text: str, n_letters: float) -> str:
    return text if len(text) <= n_letters else text[: int(n_letters) - 1].rstrip() + "…"


def _legend_lines(width: float) -> list[list[tuple[float, str, str]]]:
    """Place the legend's words, breaking the line where they do not fit."""
    lines: list[list[tuple[float, str, str]]] = [[]]
    x = 0.0
    for words, mark in LEGEND_WORDS:
        needed = 34 + 6.6 * len(words) + 14
        if lines[-1] and x + needed > width:
            lines.append([])
            x = 0.0
        lines[-1].append((x, words, mark))
        x += needed
    return lines


def _legend(lines: list[list[tuple[float, str, str]]]) -> str:
    return "".join(
        f'<g transform="translate({PAD + x:g} {HEAD + 8 + LEGEND * number:g})">{mark}'
        f'<text class="words" x="34" y="4">{words}</text></g>'
        for number, line in enumerate(lines)
        for x, words, mark in line
    )


def _style_sheet(colours: dict[str, str] | None) -> str:
    if colours is not None:
        return SHAPES + _colour_rules(colours)
    return (
        f"{SHAPES}{_colour_rules(LIGHT)}@media(prefers-color-scheme:dark){{{_colour_rules(DARK)}}}"
    )


def _colour_rules(c: dict[str, str]) -> str:
    return (
        f".paper{{fill:{c['bg']}}}.plot{{fill:{c['plot']}}}.h,.name{{fill:{c['ink']}}}"
        f".words,.tick{{fill:{c['soft']}}}.tick{{stroke:{c['plot']}}}.grid{{stroke:{c['line']}}}"
        f".safe,.region{{fill:{c['haz']};stroke:{c['haz']}}}.tube{{fill:{c['safe']}}}"
        f".box,.edited{{stroke:{c['safe']}}}.edited-dot{{fill:{c['safe']}}}"
        f".source{{stroke:{c['soft']}}}.source-dot{{stroke:{c['soft']};fill:{c['plot']}}}"
        f".origin{{stroke:{c['ink']};fill:{c['plot']}}}.gap{{stroke:{c['ink']}}}"
        f".gap-end{{fill:{c['ink']}}}.gap-text{{fill:{c['ink']};stroke:{c['plot']}}}"
    )


def plot_file(
    file: SubmissionLike,
    output: str | os.PathLike[str],
    *,
    split: SplitLike,
    sample_ids: list[str] | None = None,
    worst: int = 6,
    protocol: ProtocolLike | None = None,
) -> tuple[str, ...]:
    """Draw samples of a planning file and write the picture.

    Args:
        file: The submission: a path, bytes, an open file, a mapping, arrays or a data frame.
        output: Path ending in `.svg` or `.png`.
        split: The split with its regions, or its file, in the same forms.
        sample_ids: Which samples; without them the worst of each family, in turn.
        worst: How many of these.
        protocol: A document, the path of its TOML file, or a version; else the one that ships.

    Returns:
        The sample ids that were drawn.

    Raises:
        InvalidFileError: The file cannot be scored; the error carries every fault.
        InvalidArgumentError: A split, sample or output that cannot be used, or an extra is missing.
    """
    target = Path(output)
    if target.suffix.lower() not in (".svg", ".png"):
        raise InvalidArgumentError(
            "wrong_output", f"{target.name} is neither .svg nor .png.", "Name the output *.svg"
        )
    known = given_split(split)
    given = given_submission(file, known.name)
    scenes = Scenes(*sound_file(given, known, protocol)[:3])
    chosen = sample_ids or scenes.worst(min(worst, MAX_PANELS))
    if not chosen:
        raise InvalidArgumentError(
            "nothing_to_draw", "The file has no edited trajectory.", "Name a sample: --sample ID"
        )
    title = f"{given.name} on {known.name}"
    if not sample_ids and len(chosen) > 1:
        title += f": {len(chosen)} of the worst, in turn of each family"
    drawn = [scenes.scene(sample_id) for sample_id in chosen]
    is_png = target.suffix.lower() == ".png"
    svg = picture(drawn, title, colours=LIGHT if is_png else None)
    data = png_bytes(svg) if is_png else svg.encode("utf-8")
    write_file(target, data)
    return tuple(chosen)


def png_bytes(svg: str) -> bytes:
    """Render an SVG at twice its size.

    Raises:
        InvalidArgumentError: The extra `plot` is missing.
    """
    try:
        from resvg_py import svg_to_bytes
    except ModuleNotFoundError:
        raise extra_missing("Writing PNG needs resvg-py.", "plot", ", or write an .svg") from None
    return bytes(svg_to_bytes(svg_string=svg, zoom=PNG_ZOOM, sans_serif_family="DejaVu Sans"))
