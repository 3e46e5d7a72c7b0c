"""From files to a picture file: SVG, or PNG by a renderer in a wheel of its own."""

import os
from pathlib import Path

from exceptiondrive.checking import manifest_of, read_file
from exceptiondrive.errors import InvalidArgumentError, InvalidFileError
from exceptiondrive.evaluation import read_split, require_numpy
from exceptiondrive.plot.picture import LIGHT, picture
from exceptiondrive.plot.scenes import Scenes
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.protocol import Protocol, packaged_protocol
from exceptiondrive_schemas.split import Split

MAX_PANELS = 60
PNG_ZOOM = 2


def plot_file(
    file: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    split: str | os.PathLike[str] | Split,
    sample_ids: list[str] | None = None,
    worst: int = 6,
    protocol: Protocol | None = None,
) -> tuple[str, ...]:
    """Draw samples of a planning file and write the picture.

    Args:
        file: Path of the submission file.
        output: Path ending in `.svg` or `.png`.
        split: The split with its regions, or the path of its file.
        sample_ids: Which samples; without them the worst.
        worst: How many of the worst.
        protocol: Protocol; without it the one that ships with the client.

    Returns:
        The sample ids that were drawn.

    Raises:
        InvalidFileError: The file cannot be scored; the error carries every fault.
        InvalidArgumentError: A split, sample or output that cannot be used, or an extra is missing.
    """
    require_numpy()
    target = Path(output)
    _require_known_suffix(target)
    split = split if isinstance(split, Split) else read_split(split)
    protocol = protocol or packaged_protocol()
    checked = check(read_file(file), protocol=protocol, manifest=manifest_of(split, protocol))
    if checked.document is None:
        raise InvalidFileError(checked.report)
    scenes = Scenes(checked.document, split, protocol)
    chosen = sample_ids or scenes.worst(min(worst, MAX_PANELS))
    if not chosen:
        raise InvalidArgumentError(
            "nothing_to_draw", "The file has no edited trajectory.", "Name a sample: --sample ID"
        )
    title = f"{Path(file).name} on {split.name}"
    title += f": the worst {len(chosen)}" if not sample_ids and len(chosen) > 1 else ""
    drawn = [scenes.scene(sample_id) for sample_id in chosen]
    is_png = target.suffix.lower() == ".png"
    svg = picture(drawn, title, colours=LIGHT if is_png else None)
    data = png_bytes(svg) if is_png else svg.encode("utf-8")
    target.write_bytes(data)
    return tuple(chosen)


def png_bytes(svg: str) -> bytes:
    """Render an SVG at twice its size.

    Raises:
        InvalidArgumentError: The extra `plot` is missing.
    """
    try:
        from resvg_py import svg_to_bytes
    except ModuleNotFoundError:
        raise InvalidArgumentError(
            "extra_missing",
            "Writing PNG needs resvg-py.",
            'Run: pip install "exceptiondrive[plot]", or write an .svg',
        ) from None
    return bytes(svg_to_bytes(svg_string=svg, zoom=PNG_ZOOM, sans_serif_family="DejaVu Sans"))


def _require_known_suffix(path: Path) -> None:
    if path.suffix.lower() not in (".svg", ".png"):
        raise InvalidArgumentError(
            "wrong_output", f"{path.name} is neither .svg nor .png.", "Name the output *.svg"
        )
