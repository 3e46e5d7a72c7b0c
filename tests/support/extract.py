"""A made extract of real driving: one split, files of six planners, and what is awkward about them.

Everybody has it: it comes from a seed, and imports nothing of this project. What the files of real
planners taught, it repeats: answers that are `null`, a third of them for one planner; planners that
stand; motion that no car can make; regions that are concave, turn either way, touch the path or
begin a hand's breadth ahead; families and scenes of very unequal size; required clearances of a sample
of its own; numbers as every JSON library writes them; samples in any order; plain files and gzip.
"""

import gzip
import json
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

Point = tuple[float, float]
Path6 = list[Point]
Answer = dict[str, Path6 | None]
Answers = dict[str, Answer]
Document = dict[str, Any]

NAME = "extract"
N_SAMPLES = 160
N_SCENES = 31
COMMON_TASKS = ("SE1", "SE2", "SE3", "SE4", "LB1", "LB2", "LB3", "LB4", "BG1", "BG2", "BG3", "BG4")
RARER_TASKS = ("RS1", "RS2", "RS3", "IC1", "IC2", "IC3")
RAREST_TASKS = ("SR1", "SR2", "SR3")
TASKS = COMMON_TASKS * 5 + RARER_TASKS * 3 + RAREST_TASKS
STEP_S = 0.5
N_STEPS = 6
FRONT_M = 3.528
"""So far ahead of the origin the car ends: no region may touch it before it moves."""


@dataclass(frozen=True)
class Extract:
    """A split with its regions, and by planner what is submitted, byte by byte."""

    split: Document
    files: dict[str, bytes]
    recorded: dict[str, Path6]
    """By sample id, what was driven in the source scene."""

    def write(self, folder: Path) -> None:
        """Write `split.json.gz` and a file of each planner."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "split.json.gz").write_bytes(gzip.compress(json.dumps(self.split).encode()))
        for planner, content in self.files.items():
            self.path(folder, planner).write_bytes(content)

    def path(self, folder: Path, planner: str) -> Path:
        """Return where `write` puts the file of a planner."""
        is_packed = self.files[planner].startswith(b"\x1f\x8b")
        return folder / (f"{planner}.json.gz" if is_packed else f"{planner}.json")


@cache
def make_extract(seed: int = 20261122) -> Extract:
    """Make the extract, once a process: nobody changes it. The same seed gives the same bytes."""
    chance = random.Random(seed)
    drives = {_sample_id(number, chance): _drive(chance) for number in range(N_SAMPLES)}
    samples = [
        _sample(number, sample_id, drive, chance)
        for number, (sample_id, drive) in enumerate(drives.items())
    ]
    split = {"schema": "exceptiondrive.split/1", "name": NAME, "title": "Made", "samples": samples}
    files = {
        planner: _file(answer(drives, chance), chance, is_packed=number % 2 == 0)
        for number, (planner, answer) in enumerate(PLANNERS.items())
    }
    return Extract(split, files, drives)


def unpacked(content: bytes) -> bytes:
    """Return the text of a file, packed or not."""
    return gzip.decompress(content) if content.startswith(b"\x1f\x8b") else content


def turned(path: Path6) -> Path6:
    """Return a path in the frame that planners often use: x to the right, y forward."""
    return [(-y, x) for x, y in path]


def in_wrong_frame(content: bytes) -> bytes:
    """Return a file with every trajectory in the frame x right, y forward."""
    document = json.loads(unpacked(content))
    for prediction in document["predictions"]:
        for key in ("source", "edited"):
            prediction[key] = prediction[key] and turned(prediction[key])
    return json.dumps(document).encode()


def varied(content: bytes, number: int) -> bytes:
    """Return a file with one waypoint moved by `number` millimetres: other bytes, another score."""
    document = json.loads(unpacked(content))
    first = next(prediction for prediction in document["predictions"] if prediction["edited"])
    first["edited"][0][1] += 0.001 * number
    return json.dumps(document).encode()


# Samples: what was driven, and where the hazard was placed.


def _sample_id(number: int, chance: random.Random) -> str:
    """As a token of nuScenes, or as a frame of a scene: with a slash."""
    if number % 2:
        return f"scene_{number // 7:04}/{number % 7:02}"
    return f"{chance.getrandbits(128):032x}"


def _drive(chance: random.Random) -> Path6:
    """What a person drove: at a steady acceleration on an arc, or waiting at a light."""
    speed_mps = max(0.0, chance.gauss(6.0, 3.5))
    acceleration_mps2, turn_rad_m = chance.gauss(0.0, 0.8), chance.gauss(0.0, 0.012)
    x_m = y_m = heading_rad = 0.0
    path = []
    for _ in range(N_STEPS):
        speed_mps = max(0.0, speed_mps + acceleration_mps2 * STEP_S)
        heading_rad += turn_rad_m * speed_mps * STEP_S
        x_m += speed_mps * STEP_S * math.cos(heading_rad)
        y_m += speed_mps * STEP_S * math.sin(heading_rad)
        path.append((round(x_m, 3), round(y_m, 3)))
    return path


def _sample(number: int, sample_id: str, drive: Path6, chance: random.Random) -> Document:
    scene = min(chance.randrange(N_SCENES), chance.randrange(N_SCENES))
    sample: Document = {
        "sample_id": sample_id,
        "scene_id": f"scene-{scene:04}",
        "task": TASKS[number % len(TASKS)],
        "region": _region(number, drive, chance),
    }
    if number % 11 == 0:
        sample["d_safe_m"] = round(chance.uniform(0.3, 4.0), 2)
    return sample


def _region(number: int, drive: Path6, chance: random.Random) -> list[list[float]]:
    """Return four corners on or beside the path; every ninth is concave, every third clockwise."""
    x_m, y_m = drive[chance.randrange(2, N_STEPS)]
    x_m, y_m = x_m + FRONT_M + chance.uniform(-1.0, 5.0), y_m + chance.gauss(0.0, 2.5)
    turn_rad, half_length_m = chance.uniform(-3.2, 3.2), chance.uniform(0.2, 2.5)
    half_width_m = chance.uniform(0.2, 1.2)
    x_m = max(x_m, FRONT_M + 0.02 + math.hypot(half_length_m, half_width_m))
    corners = [
        (half_length_m, half_width_m),
        (-half_length_m, half_width_m),
        (-half_length_m, -half_width_m),
        (half_length_m, -half_width_m),
    ]
    if number % 9 == 1:
        corners[2] = (half_length_m * 0.3, half_width_m * 0.4)
    if number % 3 == 0:
        corners.reverse()
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return [
        [round(x_m + ahead * cos - left * sin, 3), round(y_m + ahead * sin + left * cos, 3)]
        for ahead, left in corners
    ]


# Planners: from what was driven to what is submitted.


def _pairs(edit: Callable[[int, Path6, random.Random], Path6 | None]) -> Callable[..., Answers]:
    """Let a planner know the drive as its source, and answer each edited sample by `edit`."""

    def answer(drives: dict[str, Path6], chance: random.Random) -> Answers:
        return {
            sample_id: {"source": drive, "edited": edit(number, drive, chance)}
            for number, (sample_id, drive) in enumerate(drives.items())
        }

    return answer


def _braking(number: int, drive: Path6, chance: random.Random) -> Path6:
    """Shorten the drive by a share; the twin brakes alike but for a micrometre."""
    share = 0.25 + 0.05 * (number % 9)
    return [(round(x * share, 4), round(y * share * share, 4)) for x, y in drive]


def _twin(number: int, drive: Path6, chance: random.Random) -> Path6:
    path = _braking(number, drive, chance)
    return [(x, y + 1e-6) for x, y in path] if number == 5 else path


def _blind(number: int, drive: Path6, chance: random.Random) -> Path6:
    """Drive on: noise of the rendering alone."""
    return [(x + chance.gauss(0, 0.01), y + chance.gauss(0, 0.01)) for x, y in drive]


def _standing(number: int, drive: Path6, chance: random.Random) -> Path6:
    """Stand, trembling around the length of a step that keeps its heading; creep now and then."""
    if number % 5 == 0:
        return [(0.1 * step, 0.0) for step in range(1, N_STEPS + 1)]
    return [(chance.uniform(-0.06, 0.06), chance.uniform(-0.06, 0.06)) for _ in drive]


def _wild(number: int, drive: Path6, chance: random.Random) -> Path6 | None:
    """Turn on the spot, reverse, leap by nearly 30 m a step, or give no answer at all."""
    steps = range(1, N_STEPS + 1)
    kinds: tuple[Path6 | None, ...] = (
        [(3.0 * math.sin(step * 1.1), 3.0 * math.cos(step * 1.1) - 3.0) for step in steps],
        [(-1.7 * step, 0.01 * step) for step in steps],
        [(2.5 * step if step % 2 else 2.5 * step - 4.0, 0.3 * step) for step in steps],
        [(29.0 * step, chance.uniform(-3, 3)) for step in steps],
        [(x, -y) for x, y in drive],
        [(0.0, 3.0 * step) for step in steps],
    )
    return None if number == 77 else kinds[number % len(kinds)]


def _forgetful(drives: dict[str, Path6], chance: random.Random) -> Answers:
    """Leave a third without any answer, and of the rest a few without source or edited."""
    answers: Answers = {}
    for number, (sample_id, drive) in enumerate(drives.items()):
        edited = [(x, y + 0.004 * step) for step, (x, y) in enumerate(drive)]
        answer: Answer = {"source": drive, "edited": edited}
        if chance.random() < 0.33:
            answer = {"source": None, "edited": None}
        elif number % 13 == 0:
            answer["source"] = None
        answers[sample_id] = answer
    return answers


PLANNERS: dict[str, Callable[[dict[str, Path6], random.Random], Answers]] = {
    "braking": _pairs(_braking),
    "braking-twin": _pairs(_twin),
    "blind": _pairs(_blind),
    "standing": _pairs(_standing),
    "wild": _pairs(_wild),
    "forgetful": _forgetful,
}
TWINS = ("braking", "braking-twin")
"""Their published numbers are equal, so they share a rank."""
UNRANKED = "forgetful"
"""Covers fewer than 99 % of the samples."""


def _file(answers: Answers, chance: random.Random, *, is_packed: bool) -> bytes:
    """Write a file as some library would: any order, any form of a number, packed or not."""
    shuffled = list(answers.items())
    chance.shuffle(shuffled)
    predictions = ",\n".join(
        f'{{"sample_id": {json.dumps(sample_id)}, '
        + ", ".join(f'"{key}": {_path(path, chance)}' for key, path in answer.items())
        + "}"
        for sample_id, answer in shuffled
    )
    head = f'{{"schema": "exceptiondrive.planning/1", "split": "{NAME}"'
    text = f'{head}, "predictions": [{predictions}]}}\n'.encode()
    return gzip.compress(text, mtime=0) if is_packed else text


def _path(path: Path6 | None, chance: random.Random) -> str:
    if path is None:
        return "null"
    return "[" + ",".join(f"[{_number(x, chance)}, {_number(y, chance)}]" for x, y in path) + "]"


def _number(value: float, chance: random.Random) -> str:
    form = chance.randrange(6)
    if value == 0.0:
        return ("0", "-0.0", "0.000", "0e0", "-0", "0.0E+10")[form]
    exact = (repr(value), f"{value:.17g}", f"{value:.20e}", f"{value:.16E}", f"{value:.25f}")
    return (*exact, f"{value * 1e3!r}e-3")[form]
