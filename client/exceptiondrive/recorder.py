"""Write ExceptionDrive submission files from a planner's loop.

One file, standard library only, Python 3.6 or newer: copy it into your planner's repository, or
import it from the `exceptiondrive` package.

    from recorder import Recorder

    with Recorder("planner.json.gz", split="nuscenes-test") as recorder:
        for sample in samples:
            if sample.id in recorder:      # already there from a run that died: go on
                continue
            recorder.add(sample.id, source=plan(sample.source), edited=plan(sample.edited))

A trajectory is six waypoints `[x, y]` in metres at t = 0.5 ... 3.0 s, x forward, y left, origin at
the rear axle at t = 0; a list, a tuple, a numpy array or a tensor. `None` means that the planner
gave none (standing still is a trajectory: six times `[0, 0]`).

Every call of `add` appends one line to `<path>.journal` at once. When the `with` block ends
well, the journal becomes the submission file in one step and goes away. When the planner dies,
the journal stays, and the next `Recorder` of the same path goes on from it.
Processes side by side take a path each; `exceptiondrive convert` makes one file of theirs. Of strategies
one process records the answers of all.
"""

import contextlib
import gzip
import io
import json
import math
import os
from typing import Any, Dict, Iterator, List, Optional, Set, Type, TypeVar, Union

WAYPOINTS = 6
STRATEGIES = ("A", "B", "C", "D", "E")
REMINDER_KEYS = (
    "hazard_present",
    "hazard_type",
    "relative_location",
    "risk_level",
    "evidence",
    "safety_constraint",
    "recommended_strategy",
)

Path = Union[str, "os.PathLike[str]"]
Self = TypeVar("Self", bound="Journal")

try:
    from exceptiondrive.errors import RecorderError as RecorderError
except ImportError:  # copied into a planner's repository

    class RecorderError(ValueError):  # type: ignore[no-redef]
        """A sample, or the whole recording, cannot become a valid file; the message says why."""


class Journal:
    """Predictions of one file, kept line by line until the file is written."""

    schema = ""
    side_by_side = (
        "give each a path of its own, and make one file of them with `exceptiondrive convert`, which "
        "also reads"
    )
    """What processes do that would record to one path."""

    def __init__(self, path: Path, split: str, manifest: Any = None) -> None:
        """Open a recording, or go on with the one that a dead run left behind.

        Args:
            path: The submission file to write; ends in `.gz` to be compressed.
            split: Name of the split, as the manifest has it.
            manifest: The split's manifest (`exceptiondrive manifest PHASE -o FILE`): its path, what
                it holds, or what `Client.manifest` gives. When given, unknown samples are refused at once, and missing ones at the end.

        Raises:
            RecorderError: The manifest or the journal belongs to something else, or cannot be opened.
        """
        if not isinstance(path, (str, os.PathLike)):
            raise RecorderError(f"the submission file is named by a path, not by {path!r}")
        if not isinstance(split, str):
            raise RecorderError(f"a split is named by its name in the manifest, not by {split!r}")
        self.path = os.fspath(path)
        self.split = split
        self.journal_path = self.path + ".journal"
        self._expected: Set[str] = set()
        if manifest is not None:
            self._expected = _manifest_ids(manifest, split)
        self._predictions: Dict[str, Dict[str, Any]] = {}
        try:
            self._resume()
            self._stream = open(self.journal_path, "a", encoding="utf-8", newline="\n")
        except (OSError, UnicodeError) as error:
            raise RecorderError(f"{self.journal_path} cannot be written: {error}")
        self._size_bytes = self._stream.tell()
        if self._size_bytes == 0:
            try:
                self._append(self._header_line())
            except RecorderError:
                self._stream.close()
                raise

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], *_: object) -> None:
        try:
            if kind is None:
                self.write()
        finally:
            self.close()

    def __contains__(self, sample_id: object) -> bool:
        return sample_id in self._predictions

    def __len__(self) -> int:
        return len(self._predictions)

    def __repr__(self) -> str:
        left = f", {len(self.missing)} missing" if self._expected else ""
        return f"<{type(self).__name__} of {self.path}: {len(self)} recorded{left}>"

    @property
    def missing(self) -> Set[str]:
        """Samples of the manifest that are not recorded yet; empty without a manifest."""
        return self._expected - set(self._predictions)

    def write(self) -> str:
        """Write the submission file in one step, drop the journal, and return the path.

        Raises:
            RecorderError: Nothing was recorded, samples of the manifest are missing, or the file
                cannot be written.
        """
        if not self._predictions:
            raise RecorderError("nothing was recorded: call add() for every sample first")
        missing = sorted(self.missing)
        if missing:
            raise RecorderError(
                f"{len(missing)} samples of split {self.split!r} are missing, the first: "
                f"{', '.join(missing[:5])}. Add them (with None where the planner gives nothing); "
                f"what is recorded stays in {self.journal_path}"
            )
        self._require_alone()
        document = dict(self._header_line(), predictions=list(self._predictions.values()))
        try:
            _write_in_one_step(self.path, document)
        except OSError as error:
            raise RecorderError(
                f"{self.path} cannot be written: {error}; what is recorded stays in "
                f"{self.journal_path}"
            )
        self.close()
        os.remove(self.journal_path)
        return self.path

    def close(self) -> None:
        """Stop recording and keep the journal, to go on later."""
        with self._os_errors_told():
            self._stream.close()

    def _take_prediction(self, prediction: Dict[str, Any]) -> None:
        sample_id = prediction["sample_id"]
        if not isinstance(sample_id, str) or not 1 <= len(sample_id) <= 128:
            raise RecorderError(f"sample_id must be text of 1 to 128 characters: {sample_id!r}")
        if sample_id in self._predictions:
            raise RecorderError(
                f"{sample_id} is already recorded; skip it with "
                "`if sample_id in recorder: continue`"
            )
        if self._expected and sample_id not in self._expected:
            raise RecorderError(f"{sample_id}: no such sample in split {self.split!r}")
        self._append(prediction)
        self._predictions[sample_id] = prediction

    def _header_line(self) -> Dict[str, Any]:
        return {"schema": self.schema, "split": self.split}

    def _append(self, value: Dict[str, Any]) -> None:
        if self._stream.closed:
            raise RecorderError(
                f"the recording of {self.path} is closed; open another at the same path to go on"
            )
        try:
            line = json.dumps(value, allow_nan=False) + "\n"
        except (TypeError, ValueError) as error:
            raise RecorderError(
                f"{value['sample_id']}: JSON cannot hold what was given: {error}"
            ) from None
        with self._os_errors_told():
            self._stream.write(line)
            self._stream.flush()
        self._size_bytes += len(line)
        self._require_alone()

    def _require_alone(self) -> None:
        """Refuse that several processes record to one path: the last would leave its own samples alone."""
        if self._stream.closed:
            return
        size_bytes = os.fstat(self._stream.fileno()).st_size
        if size_bytes == self._size_bytes and os.path.exists(self.journal_path):
            return
        raise RecorderError(
            f"another process records to {self.path}, too: {self.side_by_side} {self.journal_path}"
        )

    @contextlib.contextmanager
    def _os_errors_told(self) -> Iterator[None]:
        """Say of a full disk that what was recorded is not lost."""
        try:
            yield
        except OSError as error:
            raise RecorderError(
                f"{self.journal_path} cannot be written: {error}; the samples before stay in it, "
                "and the next run goes on from there"
            )

    def _resume(self) -> None:
        """Take over what a dead run recorded; drop the line that it did not finish."""
        if not os.path.exists(self.journal_path):
            return
        with open(self.journal_path, "r+b") as journal:
            data = journal.read()
            whole = data[: data.rfind(b"\n") + 1]
            journal.truncate(len(whole))
        lines = [self._parse(line) for line in whole.splitlines()]
        if lines and lines[0] != self._header_line():
            raise RecorderError(
                f"{self.journal_path} belongs to another recording ({lines[0]}); "
                "remove it, or record to another path"
            )
        samples = [line for line in lines if "sample_id" in line]
        self._predictions.update((line["sample_id"], line) for line in samples)

    def _parse(self, line: bytes) -> Dict[str, Any]:
        try:
            value = json.loads(line.decode("utf-8"))
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, dict) or not {"schema", "sample_id"} & set(value):
            raise RecorderError(
                f"{self.journal_path} is damaged at {line[:60]!r}: repair or remove it"
            )
        return value


class Recorder(Journal):
    """Records trajectory pairs of the planning challenge."""

    schema = "exceptiondrive.planning/1"

    def add(self, sample_id: str, source: Any, edited: Any) -> None:
        """Record the trajectories that the planner gave for the source and the edited input.

        Args:
            sample_id: Id of the sample.
            source: Six waypoints `[x, y]`, metres, shape (6, 2), or None.
            edited: The same, for the edited input.

        Raises:
            RecorderError: Wrong number of waypoints, wrong shape, or a value that is not finite.
        """
        self._take_prediction(
            {
                "sample_id": sample_id,
                "source": _trajectory(source, f"{sample_id}: source"),
                "edited": _trajectory(edited, f"{sample_id}: edited"),
            }
        )


class StrategyRecorder(Journal):
    """Records answers of the strategy challenge."""

    schema = "exceptiondrive.strategy/1"
    side_by_side = "let one process record the answers of all; what this one recorded stands in"

    def add(
        self, sample_id: str, strategy: Optional[str], reminder: Optional[Dict[str, Any]] = None
    ) -> None:
        """Record the chosen strategy, and the reminder record where there is one.

        Args:
            sample_id: Id of the sample.
            strategy: One of A, B, C, D, E, or None.
            reminder: Any of the keys in `REMINDER_KEYS`.

        Raises:
            RecorderError: Unknown strategy or reminder key, a value that JSON cannot hold or, where
                `exceptiondrive` is installed, one that its check refuses; only which hazard types there
                are is left to `exceptiondrive check`, which knows the protocol.
        """
        is_known = isinstance(strategy, str) and strategy in STRATEGIES
        if strategy is not None and not is_known:
            raise RecorderError(
                f"{sample_id}: strategy must be one of {', '.join(STRATEGIES)} or None, "
                f"not {strategy!r}"
            )
        prediction: Dict[str, Any] = {"sample_id": sample_id, "strategy": strategy}
        if reminder is not None:
            if not isinstance(reminder, dict):
                raise RecorderError(f"{sample_id}: reminder must be a dict or None, not {reminder!r}")
            unknown = sorted(str(key) for key in set(reminder) - set(REMINDER_KEYS))
            if unknown:
                raise RecorderError(
                    f"{sample_id}: unknown reminder key {', '.join(unknown)}; "
                    f"known are {', '.join(REMINDER_KEYS)}"
                )
            prediction["reminder"] = {key: _as_lists(value) for key, value in reminder.items()}
            _require_sound(prediction)
        self._take_prediction(prediction)


def _require_sound(prediction: Dict[str, Any]) -> None:
    """Refuse what the check of the file would refuse hours later."""
    try:
        from exceptiondrive.checking import faults_of_strategy
    except ImportError:  # copied into a planner's repository
        return
    try:
        faults = faults_of_strategy(prediction)
    except TypeError:  # JSON cannot hold it: that is told when it is written
        return
    if faults:
        raise RecorderError(f"{prediction['sample_id']}: {'; '.join(faults)}")


def _trajectory(value: Any, where: str) -> Optional[List[List[float]]]:
    """Return six `[x, y]` pairs of plain floats, or None."""
    value = _as_lists(value)
    if value is None:
        return None
    if not isinstance(value, (list, tuple)):
        raise RecorderError(f"{where} must be a list of waypoints or None, not {value!r}")
    if len(value) != WAYPOINTS:
        hint = ""
        if len(value) == WAYPOINTS + 1:
            hint = "; leave out the point at t = 0, the first is at 0.5 s"
        elif len(value) > WAYPOINTS:
            hint = "; take those at 0.5, 1.0, ... 3.0 s: at 10 a second trajectory[4::5][:6]"
        elif len(value) == 1:
            hint = "; take the one trajectory out of its batch: trajectory[0]"
        elif len(value) == 2 and hasattr(_as_lists(value[0]), "__len__") and len(value[0]) == WAYPOINTS:
            hint = "; a row of x and one of y: trajectory.T"
        raise RecorderError(f"{where} needs exactly {WAYPOINTS} waypoints, got {len(value)}{hint}")
    return [_waypoint(point, f"{where}[{i}]") for i, point in enumerate(value)]


def _waypoint(point: Any, where: str) -> List[float]:
    point = _as_lists(point)
    if not isinstance(point, (list, tuple)):
        raise RecorderError(f"{where} must be [x, y], got {point!r}")
    if len(point) != 2:
        hint = "; leave out the heading: trajectory[:, :2]" if len(point) == 3 else ""
        raise RecorderError(f"{where} must be [x, y], got {point!r}{hint}")
    return [_coordinate(_as_lists(number), where) for number in point]


def _coordinate(number: Any, where: str) -> float:
    if isinstance(number, (bool, str, bytes)) or not hasattr(number, "__float__"):
        raise RecorderError(f"{where} must hold numbers, got {number!r}")
    try:
        number = float(number)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise RecorderError(
            f"{where} is not finite ({number}); record None where the planner failed"
        )
    return float(number)


def _as_lists(value: Any) -> Any:
    """Turn arrays, tensors and their scalars into lists and numbers."""
    if not hasattr(value, "tolist") and hasattr(value, "__array__"):
        value = value.__array__()
    return value.tolist() if hasattr(value, "tolist") else value


def _manifest_ids(given: Any, split: str) -> Set[str]:
    """Return the sample ids of a manifest and make sure that it is the right one."""
    path, manifest = "this", given
    if hasattr(given, "model_dump"):
        manifest = given.model_dump()
    elif not isinstance(given, dict):
        try:
            path = os.fspath(given)
            with open(path, encoding="utf-8") as stream:
                manifest = json.load(stream)
        except (OSError, TypeError, ValueError, RecursionError) as error:
            raise RecorderError(f"the manifest {given!r} cannot be read: {error}")
    if not isinstance(manifest, dict) or not manifest.get("sample_ids"):
        raise RecorderError(f"{path} is not a manifest: it has no sample_ids")
    if manifest.get("name") != split:
        raise RecorderError(f"{path} is the manifest of {manifest.get('name')!r}, not of {split!r}")
    if manifest.get("waypoints", WAYPOINTS) != WAYPOINTS:
        raise RecorderError(
            f"{path} asks for {manifest['waypoints']} waypoints, this recorder writes {WAYPOINTS}"
        )
    return set(manifest["sample_ids"])


def _write_in_one_step(path: str, document: Dict[str, Any]) -> None:
    """Write beside the target and rename: a reader sees the old file, or the whole new one.

    Behind a symlink its target is replaced; what is no regular file, as a pipe, is written into.
    """
    data = json.dumps(document, allow_nan=False, separators=(",", ":")).encode("utf-8")
    if path.endswith(".gz"):
        buffer = io.BytesIO()
        with gzip.GzipFile(filename="", mode="wb", fileobj=buffer, mtime=0) as stream:
            stream.write(data)
        data = buffer.getvalue()
    if os.path.exists(path) and not os.path.isfile(path):
        with open(path, "wb") as pipe:
            pipe.write(data)
        return
    path = os.path.realpath(path)
    part_path = path + ".part"
    try:
        with open(part_path, "wb") as part:
            part.write(data)
            part.flush()
            os.fsync(part.fileno())
        os.replace(part_path, path)
    finally:
        if os.path.exists(part_path):
            os.remove(part_path)
