"""Commands about scenes."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_build.cli import WorkshopFolder
from exceptiondrive_build.scenes.generated import make_scenes
from exceptiondrive_build.scenes.read_in import read_in
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_schemas.printable import counted

scenes = typer.Typer(
    rich_markup_mode=None,
    no_args_is_help=True,
    help="Make a set of scenes, or read one into a workshop.",
)


@scenes.command()
def make(
    folder: Path,
    n_scenes: Annotated[int, typer.Option("--scenes", min=1)] = 3,
    n_samples: Annotated[int, typer.Option("--samples", min=7, help="Of each scene.")] = 8,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    width_px: Annotated[int, typer.Option("--width", min=64, help="Of the pictures.")] = 480,
) -> None:
    """Make up a set in nuScenes form: flat roads, seen by six cameras that are true to them."""
    make_scenes(folder, n_scenes=n_scenes, n_samples=n_samples, seed=seed, width_px=width_px)
    typer.echo(f"{folder}: {n_scenes} scenes of {n_samples} keyframes, six views each")


@scenes.command()
def read(
    source: Annotated[
        Path, typer.Argument(help="A nuScenes folder, or a file of keyframes, one a line.")
    ],
    workshop: WorkshopFolder = Path(),
    per_scene: Annotated[
        int, typer.Option(min=1, help="Keyframes of each scene, spread evenly.")
    ] = 1,
    version: Annotated[
        str | None, typer.Option(help="Which tables, such as v1.0-trainval.")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Let keyframes go of which something was decided.")
    ] = False,
) -> None:
    """Read scenes into the workshop, in the place of those that stand in it.

    Calibration, recorded paths and the pictures are copied. Keyframes of which something was decided
    do not go unless you say --replace.
    """
    with Workshop(workshop) as shop:
        keyframes, n_left_out, n_gone = read_in(
            shop, source, per_scene=per_scene, version=version, replace=replace
        )
        n_tasks = len(shop.tasks)
    n_scenes = len({keyframe.scene_id for keyframe in keyframes})
    typer.echo(
        f"{counted(len(keyframes), 'keyframe')} of {counted(n_scenes, 'scene')}; with "
        f"{counted(n_tasks, 'task')} {counted(len(keyframes) * n_tasks, 'combination')}"
    )
    pictures = Counter(
        image for keyframe in keyframes for image in {camera.image for camera in keyframe.cameras}
    )
    n_repeated = sum(n > 1 for n in pictures.values())
    if n_repeated:
        typer.echo(
            f"{n_repeated} of the pictures stand in several keyframes: what is one keyframe under several "
            "names is asked about, and counts, as often"
        )
    if n_left_out:
        typer.echo(
            f"left out of these scenes: {counted(n_left_out, 'further keyframe')}; --per-scene N takes N "
            "of each"
        )
    if n_gone:
        typer.echo(f"gone, or with other pictures: {counted(n_gone, 'keyframe')} that stood here")
