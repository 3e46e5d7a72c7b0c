"""Read the output formats of common planners: one run of trajectories by token.

A submission needs two runs of a planner, on the source and on the edited inputs. Every form is that
of the planner's published code. Pickles are never loaded: where a planner writes one, the docs have
a line that dumps it as JSON, on the machine and in the environment that wrote it.
"""

import ast
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from os.path import isdir
from pathlib import Path
from typing import Any

from exceptiondrive.conversion import RawPair, Waypoints
from exceptiondrive.errors import InvalidArgumentError, reason_of
from exceptiondrive.pair_files import (
    NPZ_MAGIC,
    OnForm,
    points_of,
    read_arrays,
    read_bytes,
    read_text,
    whole_number,
)
from exceptiondrive.waypoint_rows import fault, with_unique_keys
from exceptiondrive_schemas.check.transformations import summed

Tokens = Iterator[tuple[str, Waypoints | None]]


@dataclass(frozen=True)
class PlannerForm:
    """What a planner writes, and what brings it into the frame of a submission.

    Attributes:
        read: Yields token and trajectory of one file, None where the planner failed.
        rotate_deg: As in `ConversionPlan`.
        time_step_s: Between two waypoints; None where the files or the user say it.
    """

    read: Callable[[Path, int | None, OnForm], Tokens]
    rotate_deg: int = 0
    time_step_s: float | None = 0.5


def read_runs(
    form: PlannerForm,
    source: Sequence[Path],
    edited: Sequence[Path],
    mode: int | None,
    on_form: OnForm = lambda _: None,
) -> tuple[RawPair, ...]:
    """Read a run on the source inputs and one on the edited inputs as pairs.

    Args:
        form: What the planner writes.
        source: Files of the run on the source inputs; folders are searched for JSON.
        edited: Files of the run on the edited inputs.
        mode: Which trajectory to take where a list of several stands, from 0.
        on_form: Told of each form of a trajectory that had to be read as waypoints.

    Returns:
        A pair for every token of either run, null where a run has none.

    Raises:
        InvalidArgumentError: A file cannot be read, or a token occurs twice in a run.
    """
    runs = [_read_run(form, paths, mode, on_form) for paths in (source, edited)]
    tokens = dict.fromkeys([*runs[0], *runs[1]])
    return tuple(RawPair(token, runs[0].get(token), runs[1].get(token)) for token in tokens)


def _read_run(
    form: PlannerForm, paths: Sequence[Path], mode: int | None, on_form: OnForm
) -> dict[str, Waypoints | None]:
    run: dict[str, Waypoints | None] = {}
    for path in paths:
        for file in sorted(path.rglob("*.json")) if isdir(path) else [path]:
            for token, points in form.read(file, mode, on_form):
                if token in run:
                    raise fault(file, f"{token} occurs twice.")
                run[token] = points
    return run


def _read_object(path: Path, data: bytes | None = None) -> dict[str, Any]:
    """Return the object in a file, of what was read of it where that is at hand."""
    text = read_text(path, read_bytes(path) if data is None else data)
    try:
        document = json.loads(
            text, object_pairs_hook=with_unique_keys(path), parse_int=whole_number
        )
    except (ValueError, RecursionError) as error:
        raise fault(path, f"is not JSON: {reason_of(error)}.") from None
    if not isinstance(document, dict):
        raise fault(path, "must be a JSON object by token.")
    return document


def _read_list(path: Path, key: str) -> list[Any]:
    found = _read_object(path).get(key, [])
    if not isinstance(found, list):
        raise fault(path, f"{key} must be a list.")
    return found


def read_trajectories(path: Path, mode: int | None, on_form: OnForm) -> Tokens:
    """Read `{token: [[x, y], ...]}`, or NPZ with `token` (N) and `trajectory` (N, T, 2 or 3).

    As JSON it is the dump of `pred_trajs_dict.pkl`, which Agent-Driver writes (USC-GVL/Agent-Driver
    @ 3ea566e, README.md line 95) and GPT-Driver too (PointsCoder/GPT-Driver @ 6294144,
    gpt-driver/test.py lines 81 and 105): x to the right, y forward (gpt-driver/prompt_message.py
    line 8). UniAD's `planning_traj` (OpenDriveLab/UniAD @ dd161b2, projects/mmdet3d_plugin/uniad/
    apis/test.py line 99) is one mode of positions, for they are added up (dense_heads/
    planning_head.py line 191), in the frame of the lidar (datasets/data_utils/trajectory_api.py
    lines 226 to 257). ST-P3's `final_traj` (OpenDriveLab/ST-P3 @ 6b11e13, evaluate.py lines 123 to
    137) has a heading too and its x to the right (stp3/datas/NuscenesData.py lines 505 to 532).
    """
    data = read_bytes(path)
    if data.startswith(NPZ_MAGIC):
        tokens, trajectories = read_arrays(path, data, "token", "trajectory")
        for token, points in zip(tokens, trajectories, strict=True):
            yield str(token), points_of(path, str(token), points, mode, on_form)
        return
    for token, points in _read_object(path, data).items():
        yield token, points_of(path, token, points, mode, on_form)


def read_vad(path: Path, mode: int | None, on_form: OnForm) -> Tokens:
    """Read `{token: {"ego_fut_preds": (3, 6, 2), "ego_fut_cmd": three flags}}`.

    VAD keeps a mode of increments per command, and takes the one of the command, added up
    (hustvl/VAD @ 1688c4b, projects/mmdet3d_plugin/VAD/VAD.py lines 390, 391, 420 to 425), in the
    frame of the lidar, x to the right (tools/data_converter/vad_nuscenes_converter.py lines 431 to
    459). It writes them as `plan_results` of `results_nusc.pkl` (hustvl/VAD @ 0a20dc7, projects/
    mmdet3d_plugin/datasets/nuscenes_vad_dataset.py, lines 1476 and 1553).
    """
    for token, result in _read_object(path).items():
        try:
            modes, commands = result["ego_fut_preds"], _flattened(result["ego_fut_cmd"])
            (chosen,) = [mode] if mode is not None else _places_of_most(commands)
            increments = modes[chosen]
        except (TypeError, KeyError, IndexError, ValueError):
            raise fault(
                path,
                f"{token} needs ego_fut_preds and ego_fut_cmd: a mode for each flag, and one flag set.",
            ) from None
        if mode is not None:
            on_form(f"mode {mode} of {len(modes)}")
        points = points_of(path, token, increments, None)
        if points and all(len(point) > 1 for point in points):  # others add up to nothing
            points = tuple(summed([(x, y) for x, y, *_ in points]))
        yield token, points


def _places_of_most(numbers: list[float]) -> list[int]:
    return [place for place, number in enumerate(numbers) if number == max(numbers)]


def _flattened(value: Any) -> list[float]:
    return (
        [each for part in value for each in _flattened(part)]
        if isinstance(value, list)
        else [value]
    )


def read_bench2drive(path: Path, mode: int | None, on_form: OnForm) -> Tokens:
    """Read one `meta/NNNN.json` of a Bench2Drive agent; its token is the name of the file.

    UniAD's and VAD's agents write positions as `plan` (Thinklab-SJTU/Bench2DriveZoo @ 10a2e5d,
    team_code/uniad_b2d_agent.py lines 394 and 412, team_code/vad_b2d_agent.py lines 393 to 412 and
    440), x to the right and y forward (`lidar2ego` there), half a second apart
    (team_code/pid_controller.py lines 58 and 59).
    """
    yield path.stem, points_of(path, path.stem, _read_object(path).get("plan"), mode, on_form)


def read_lightemma(path: Path, mode: int | None, on_form: OnForm) -> Tokens:
    """Read the scene files of LightEMMA: speeds and curvatures as the model said them.

    HerrWangkv/LightEMMA @ 657da27: `frames` with `sample_token` and `pred_actions_str` (predict.py
    lines 246 to 269), a list of six pairs or no answer (utils.py lines 17 to 37), driven from the
    ego pose, x forward and y left (utils.py lines 172 to 192). Its runs in CARLA write `actions` and
    name a frame by its image (predict_and_eval_carla.py lines 186 to 191).
    """
    for frame in _read_list(path, "frames"):
        try:
            token = frame.get("sample_token") or Path(frame["image_name"]).stem
            inference = frame["inference"]
            said = inference["pred_actions_str" if "pred_actions_str" in inference else "actions"]
        except (AttributeError, KeyError, TypeError):
            raise fault(
                path, "needs frames with a token and an inference with pred_actions_str or actions."
            ) from None
        points = _drive_controls(said)
        if points is None:
            on_form(f"answers that are no {N_ACTIONS} pairs of speed and curvature as null")
        yield str(token), points


N_ACTIONS = 6
ACTIONS_STEP_S = 0.5


def _drive_controls(said: Any) -> Waypoints | None:
    """Drive pairs of speed in m/s and curvature in 1/m; None where they are no six pairs."""
    try:
        pairs = ast.literal_eval(said) if isinstance(said, str) else said
        actions = [(float(speed), float(curvature)) for speed, curvature in pairs]
        return _path_of(actions) if len(actions) == N_ACTIONS else None
    except (ValueError, TypeError, OverflowError, SyntaxError, MemoryError, RecursionError):
        return None


def _path_of(actions: Sequence[tuple[float, float]]) -> Waypoints:
    x = y = heading_rad = 0.0
    points = []
    for speed_mps, curvature in actions:
        x += speed_mps * math.cos(heading_rad) * ACTIONS_STEP_S
        y += speed_mps * math.sin(heading_rad) * ACTIONS_STEP_S
        heading_rad += curvature * speed_mps * ACTIONS_STEP_S
        points.append((x, y))
    return tuple(points)


def read_navsim(path: Path, mode: int | None, on_form: OnForm) -> Tokens:
    """Read `{token: {"poses": [[x, y, heading], ...]}}`, the dump of a NAVSIM submission.

    A submission maps tokens to `Trajectory` (autonomousvision/navsim @ 0a380a9,
    navsim/planning/script/run_create_submission_pickle.py lines 59 to 64 and 116), poses of x, y and
    heading in the local frame (navsim/common/dataclasses.py lines 280 to 291), which is that of the
    rear axle (navsim/evaluate/pdm_score.py line 39). Its sampling is the agent's own, half a second
    over 4 s by default, a tenth for planners of nuPlan: say it with --time-step-s.
    """
    for token, trajectory in _read_object(path).items():
        poses = trajectory.get("poses") if isinstance(trajectory, dict) else trajectory
        yield token, points_of(path, token, poses, mode, on_form)


def read_waymo(path: Path, mode: int | None, on_form: OnForm) -> Tokens:
    """Read a submission of Waymo's end-to-end challenge as JSON, by protobuf's `MessageToJson`.

    waymo-open-dataset of Waymo @ 508fb26, src/waymo_open_dataset/protos/
    end_to_end_driving_submission.proto lines 25 to 44: +x forward, +y left, 20 waypoints at 4 Hz, the first at 0.25 s.
    """
    for frame in _read_list(path, "predictions"):
        try:
            token = frame.get("frameName") or frame["frame_name"]
            at = frame["trajectory"]
            xs, ys = at.get("posX") or at["pos_x"], at.get("posY") or at["pos_y"]
            points = [list(point) for point in zip(xs, ys, strict=True)]
        except (AttributeError, KeyError, TypeError, ValueError):
            raise fault(
                path, "needs predictions with frameName and a trajectory of as many posX as posY."
            ) from None
        yield str(token), points_of(path, str(token), points, mode, on_form)


FORMS: dict[str, PlannerForm] = {
    "trajectories": PlannerForm(read_trajectories, time_step_s=None),
    "uniad": PlannerForm(read_trajectories, rotate_deg=-90),
    "st-p3": PlannerForm(read_trajectories, rotate_deg=-90),
    "agent-driver": PlannerForm(read_trajectories, rotate_deg=-90),
    "vad": PlannerForm(read_vad, rotate_deg=-90),
    "bench2drive": PlannerForm(read_bench2drive, rotate_deg=-90),
    "lightemma": PlannerForm(read_lightemma),
    "navsim": PlannerForm(read_navsim, time_step_s=None),
    "waymo": PlannerForm(read_waymo, time_step_s=0.25),
}


def planner_form(name: str) -> PlannerForm:
    """Return the form of a planner's files.

    Raises:
        InvalidArgumentError: No such form.
    """
    try:
        return FORMS[name]
    except KeyError:
        raise InvalidArgumentError(
            "wrong_option", f"--from must be one of {', '.join(FORMS)}."
        ) from None
