"""Checks a submission file: all faults in one pass, or its content ready for scoring."""

import difflib
import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.challenges import (
    CHALLENGES,
    PLANNING,
    STRATEGY,
    ChallengeId,
    challenge_of_file,
)
from exceptiondrive_schemas.check.answers import CheckedDocument
from exceptiondrive_schemas.check.fault_list import (
    MAX_SHOWN_CHARACTERS,
    FaultList,
    Path,
    escaped,
    kind,
    quoted,
)
from exceptiondrive_schemas.check.inflate import (
    CONVERTIBLE,
    MAX_INFLATED_BYTES,
    MAX_UPLOAD_BYTES,
    UnreadableFileError,
    inflate,
)
from exceptiondrive_schemas.check.json_stream import (
    JsonStream,
    JsonStreamError,
    RepeatedKeys,
    elements,
    members,
    skip,
)
from exceptiondrive_schemas.check.planning_columns import planning_columns
from exceptiondrive_schemas.check.planning_rules import SIDES_MISSING, PlanningRules
from exceptiondrive_schemas.check.rules import RULES, PredictionRules, challenge_by_key
from exceptiondrive_schemas.check.sample_ids import SampleIds
from exceptiondrive_schemas.check.trajectory_forms import is_number
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.file_profile import CONVERT, FileProfile
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SPLIT_NAME_PATTERN, Manifest

OTHER_DOCUMENTS: Mapping[str, str] = {
    "exceptiondrive.split/1": "a split file, which says what is scored",
    "exceptiondrive.manifest/1": "the manifest, which lists the samples to answer",
    "exceptiondrive.receipt/1": "a receipt",
}
"""Documents of this project that are no submissions, by their schema."""


def check_schema(
    value: object, wanted: ChallengeId | None, faults: FaultList
) -> ChallengeId | None:
    """Check the value of `schema`; return the challenge that the file names, if it exists."""
    named = _challenge_of(value)
    if named is not None and wanted in (None, named):
        return named
    schemas = [each.file_schema for key, each in CHALLENGES.items() if wanted in (None, key)]
    hint = None
    if named is not None and wanted is not None:
        hint = f"this is a {named} file, and a {wanted} file is wanted"
    elif isinstance(value, str) and value in OTHER_DOCUMENTS:
        what = OTHER_DOCUMENTS[value]
        faults.say(
            FaultCode.WRONG_SCHEMA, f"The file is {what}: hand in what the planner answered."
        )
    elif isinstance(value, str) and _is_newer(value):
        hint = "a newer form: take the newest client, from the server's page /client/"
    elif wanted != STRATEGY.id:
        hint = f"no form of ours; {CONVERT}` writes {quoted(PLANNING.file_schema)}"
    faults.add(
        FaultCode.WRONG_SCHEMA if isinstance(value, str) else FaultCode.WRONG_TYPE,
        ("schema",),
        expected=" or ".join(quoted(schema) for schema in schemas),
        got=quoted(value) if isinstance(value, str) else kind(value),
        hint=hint,
    )
    return named


def _is_newer(schema: str) -> bool:
    """Whether it is one of this project's forms with a higher number."""
    name, _, number = schema.partition("/")
    ours = {each.file_schema.partition("/")[0] for each in CHALLENGES.values()}
    return name in ours and number.isdecimal() and int(number[:6]) > 1


def find_challenge(stream: JsonStream) -> ChallengeId | None:
    """Look for `schema` after the predictions, whose rules depend on it."""
    try:
        for key in members(stream):
            if key == "schema":
                return _challenge_of(stream.value())
            skip(stream)
    except JsonStreamError:
        return None
    return None


def _challenge_of(value: object) -> ChallengeId | None:
    named = challenge_of_file(value) if isinstance(value, str) else None
    return named.id if named else None


def check_split_name(value: object, manifest: Manifest | None, faults: FaultList) -> None:
    """Check the value of `split`: the manifest's name, or any legal name without a manifest."""
    expected = quoted(manifest.name) if manifest else "a split name such as nuscenes-test"
    if not isinstance(value, str):
        hint = convert_advice(manifest)
        faults.add(FaultCode.WRONG_TYPE, ("split",), expected=expected, got=kind(value), hint=hint)
    elif not is_split_name(value, manifest):
        faults.add(FaultCode.WRONG_SPLIT, ("split",), expected=expected, got=quoted(value))


def is_split_name(value: str, manifest: Manifest | None) -> bool:
    """Whether it is the name of the manifest's split, or any legal one without a manifest."""
    if manifest is not None:
        return value == manifest.name
    return re.fullmatch(SPLIT_NAME_PATTERN, value) is not None


def report_repeated_keys(value: Any, path: Path, faults: FaultList) -> None:
    """Report the repeated keys of a value, however deep; escaped spellings are equal."""
    places: list[tuple[Path, Any]] = [(path, value)]
    while places:
        path, value = places.pop()
        if isinstance(value, RepeatedKeys):
            for key in value.repeated:
                got = f"{quoted(key)} more than once"
                faults.add(FaultCode.DUPLICATE_KEY, path, expected="every key once", got=got)
        if isinstance(value, dict):
            places += [((*path, key), each) for key, each in value.items()]
        elif isinstance(value, list):
            places += [((*path, index), each) for index, each in enumerate(value)]


ROOT_KEYS = ("schema", "split", "predictions")
OUR_KEYS = ("sample_id", "source", "edited", "strategy")
"""Keys of predictions."""
A_COMMENT = "looks like a comment: JSON has none, remove it"
CLOSING = ('"]', '"}')
AFTER_A_COMMA = (
    "a value",
    "a key in double quotes",
    "no comma before the end of an object",
    "no comma before the end of a list",
)
"""What is expected after a comma that stands before a closing bracket."""
COMMENTS = ('"//', '"/*', '"#')
MAX_HEADER_BYTES = 1024
CSV_DELIMITERS: Mapping[bytes, str] = {b",": "commas", b";": "semicolons", b"\t": "tabs"}
CSV_COLUMNS = ("sample_id", "trajectory", "step", "x_m", "y_m")
"""Columns of the CSV files that `exceptiondrive convert` reads."""
MIN_CSV_DELIMITERS = 2
MIN_IDS_AS_KEYS = 2
"""With so many objects under unknown keys, and none under a known one, the keys are sample ids."""
OTHER_NAMES: Mapping[str, tuple[str, ...]] = {
    "sample_id": ("id", "token", "sample", "sample_token"),
    "source": ("src", "original", "clean", "before", "trajectory", "prediction", "pred"),
    "edited": ("edit", "counterfactual", "hazard", "after", "target"),
    "strategy": ("answer", "action", "decision"),
}
BARE_LIST = re.compile(rb"\s*(?:\[\s*){1,2}\{")
"""The beginning of a list of predictions, also if `cat` joined several files."""
ROOT_OF_JSON = re.compile(rb"^[ \t]*\{\s*\"(?:schema|split|predictions)\"", re.MULTILINE)


def convert_advice(manifest: Manifest | None) -> str:
    """Say how a file that names no split is converted to a submission."""
    name = manifest.name if manifest else "NAME"
    return f"{CONVERT} --split {name}` makes a submission of it"


def two_runs_advice(manifest: Manifest | None) -> str:
    """Say how two runs of a planner, on source and edited inputs, are combined to a submission."""
    name = manifest.name if manifest else "NAME"
    return (
        "with that on the edited inputs it becomes a submission: `exceptiondrive convert "
        f"--source-run FILE --edited-run FILE --split {name}`"
    )


def meant_key(written: str, absent: Collection[str]) -> str | None:
    """Return the missing key that was probably meant."""
    word = written.lower()
    for key in absent:
        if word in OTHER_NAMES.get(key, ()) or key in word:
            return key
    near = difflib.get_close_matches(word[:MAX_SHOWN_CHARACTERS], sorted(absent), n=1)
    return near[0] if near else None


def _is_of_predictions(value: object) -> bool:
    """Whether it is a prediction, or holds predictions under one of our keys."""
    return isinstance(value, Mapping) and (
        "predictions" in value or any(map(challenge_by_key, value))
    )


def _is_of_points(value: object) -> bool:
    """Whether a list that begins with this value may be a trajectory."""
    return is_number(value) or isinstance(value, list)


class _TooManyFaultsError(Exception):
    """There are too many faults to count more."""


class SubmissionReader:
    """One reading of one file.

    `challenge` and `split` are what the file names; the split is shortened and escaped.
    """

    def __init__(
        self,
        data: bytes,
        *,
        protocol: ProtocolDocument,
        manifest: Manifest | None,
        challenge: ChallengeId | None,
        faults: FaultList,
        foretells_rank: bool,
    ) -> None:
        self._data = data
        self._stream = JsonStream(data)
        self._protocol = protocol
        self._manifest = manifest
        self._foretells_rank = foretells_rank
        self._wanted = (manifest and manifest.challenge) or challenge
        self._ids = SampleIds(manifest, faults)
        self._rules: PredictionRules | None = None
        self._one_by_one: dict[str, Any] = {}
        self._answers: Mapping[str, Any] = self._one_by_one
        self._seen: set[str] = set()
        self._reading: Path = ()
        self._n_ids_as_keys = 0
        self._n_trajectories = 0
        self._wrapped_in: list[str] = []
        self._has_columns = False
        self._is_of_another_form = False
        self._absent: Counter[str] = Counter()
        self.faults = faults
        self._refuse = faults.add
        self.challenge: ChallengeId | None = None
        self.split: str | None = None
        self.n_predictions: int | None = None
        self.notes: list[str] = []
        self.profile: FileProfile | None = None
        self.unranked_because: str | None = None

    def read(self) -> CheckedDocument | None:
        """Read the file; return its content if it is sound."""
        if not self._read_sound():
            is_complete = self._read_all()
            if is_complete:
                self._report_missing_keys()
            self._ids.finish(self.n_predictions if is_complete else None)
        if self._rules is not None:
            self.profile = self._rules.finish(self._answers, self._manifest)
        self._tell_one_cause()
        return self._sound_document()

    def _read_sound(self) -> bool:
        """Read a planning file on the fast path, without places; return whether that worked."""
        columns = planning_columns(self._data, self._protocol.geometry.waypoints)
        if columns is None or self._wanted not in (None, PLANNING.id):
            return False
        if not is_split_name(columns.split, self._manifest):
            return False
        rules = PlanningRules(self._protocol, self.faults)
        answers = rules.take(columns) if self._ids.are_sound(columns.sample_ids) else None
        if answers is None:
            return False
        self._rules, self._answers = rules, answers
        self.challenge, self.split, self.n_predictions = PLANNING.id, columns.split, len(answers)
        return True

    def _tell_one_cause(self) -> None:
        """Remove faults that are only consequences of another one."""
        if self._ids.are_of_another_split and self.faults.has(FaultCode.WRONG_SPLIT):
            self.faults.forget(FaultCode.UNKNOWN_SAMPLE)
        for key, n_absent in self._absent.items():
            if n_absent == self.n_predictions and key in SIDES_MISSING:
                sentence = f"No prediction has the key {quoted(key)}, {SIDES_MISSING[key]}."
                self.faults.say(FaultCode.MISSING_KEY, sentence)
        if self._is_of_another_form:
            self.faults.forget(
                FaultCode.UNKNOWN_KEY,
                FaultCode.MISSING_KEY,
                FaultCode.DUPLICATE_KEY,
                FaultCode.MISSING_SAMPLE,
            )

    def _read_all(self) -> bool:
        try:
            return self._read_root()
        except JsonStreamError as error:
            hint = self._form_hint(error)
            self._refuse(error.code, self._reading, error.expected, error.got, hint=hint)
            self.notes.append("Reading stopped there: what follows was not checked.")
        except _TooManyFaultsError:
            self.notes.append("Reading stopped after too many faults; the counts are incomplete.")
        return False

    def _read_root(self) -> bool:
        first = self._stream.peek()
        if first != "{" and self._refuse_log():
            return False
        if first == "":
            self.faults.add(
                FaultCode.EMPTY_FILE, (), expected="a JSON document", got="blanks alone"
            )
            return False
        if first == "[":
            expected = "an object with the key `schema`"
            is_bare = BARE_LIST.match(self._data) is not None
            hint = (
                f"looks like a bare list of predictions; {self._convert_hint}" if is_bare else None
            )
            self._refuse(FaultCode.WRONG_TYPE, (), expected, "a list", hint=hint)
            return False
        for key in members(self._stream):
            self._read_member(key)
        self._reading = ()
        if self._stream.peek():
            follows = self._stream.not_json("the end of the file")
            is_object = self._stream.peek() == "{"
            form = "several files in one" if "predictions" in self._seen else "JSON lines"
            self._is_of_another_form |= is_object
            self._refuse(
                FaultCode.TRAILING_DATA,
                (),
                follows.expected,
                follows.got,
                hint=f"looks like {form}; {self._convert_hint}"
                if is_object
                else "remove what stands behind the last }",
            )
        elif not self._seen and (self._n_ids_as_keys or self._wrapped_in):
            self._refuse_other_form()
        return True

    def _refuse_log(self) -> bool:
        """Report other lines before the JSON object, if there are any."""
        begins = ROOT_OF_JSON.search(self._data)
        if begins is None or self._data[: begins.start()].strip() == b"[":
            return False
        lines = counted(self._data.count(b"\n", 0, begins.start()), "line")
        before = self._data[: begins.start()].split()[0]
        hint = f"looks like {lines} of a log: remove what stands before the JSON"
        if f'"{before.decode(errors="replace")}'.startswith(COMMENTS):
            hint = A_COMMENT
        expected = "a JSON object from the first line on"
        self._refuse(FaultCode.NOT_JSON, (), expected, f"{lines} of other text", hint=hint)
        return True

    def _refuse_other_form(self) -> None:
        """Describe a document without any known key, in place of its many faults."""
        hint = f"looks like another form of it; {self._convert_hint}"
        if len(self._wrapped_in) == 1:
            hint = "write what is under it alone into the file"
            got = f"everything under the key {quoted(self._wrapped_in[0])}"
        elif self._n_ids_as_keys >= MIN_IDS_AS_KEYS:
            got = f"an object with {counted(self._n_ids_as_keys, 'value')} under other keys"
            got += ": sample ids, or columns"
            if self._has_columns:
                hint = "write a list of predictions, one object a sample"
        else:
            return
        self._is_of_another_form = True
        expected = "an object with the keys schema, split and predictions"
        if self._n_trajectories == self._n_ids_as_keys >= MIN_IDS_AS_KEYS:
            got = f"an object with {counted(self._n_trajectories, 'trajectory', 'trajectories')} by id"
            hint = f"looks like one run of a planner; {two_runs_advice(self._manifest)}"
        self._refuse(FaultCode.WRONG_TYPE, (), expected, got, hint=hint)

    def _read_member(self, key: str) -> None:
        self._stop_when_full()
        self._reading = (key,)
        if key in self._seen:
            self._refuse(FaultCode.DUPLICATE_KEY, (), "every key once", f"{quoted(key)} again")
            skip(self._stream)
        elif key == "predictions":
            self._seen.add(key)
            self._read_predictions()
        elif key in ROOT_KEYS:
            self._seen.add(key)
            self._read_name(key)
        else:
            expected = f"only {', '.join(ROOT_KEYS)}"
            self._refuse(FaultCode.UNKNOWN_KEY, (key,), expected, quoted(key))
            self._look_into(key)

    def _look_into(self, key: str) -> None:
        """Skip the value of an unknown key, and note whether it may be the whole file."""
        first = self._stream.peek()
        if first not in ("{", "["):
            self._stream.value()
            return
        self._n_ids_as_keys += 1
        is_column = key in ("sample_id", "sample_ids") or (key in OUR_KEYS and first == "{")
        self._has_columns |= is_column
        if first == "[":
            listed: list[Any] = []

            def look(at: str | int, value: Any) -> None:
                self._report_repeated(value, (key, at))
                if at == 0:
                    listed.append(value)

            skip(self._stream, look)
            self._n_trajectories += key not in OUR_KEYS and any(map(_is_of_points, listed))
            self._wrapped_in.append(key)
            return
        is_looked_at = False
        firsts: list[Any] = []
        for inner in members(self._stream):
            if inner == "predictions":
                firsts.append({inner: None})
            if inner == "predictions" or is_looked_at or self._stream.peek() != "{":
                skip(self._stream, lambda at, value: firsts.append(value) if at == 0 else None)
                continue
            value, is_looked_at = self._stream.value(), True
            self._report_repeated(value, (key, inner))
            firsts.append(value)
        if any(map(_is_of_predictions, firsts)):
            self._wrapped_in.append(key)

    def _read_name(self, key: str) -> None:
        value = self._stream.value()
        self._report_repeated(value, (key,))
        if key == "schema":
            self.challenge = check_schema(value, self._wanted, self.faults)
            self._is_of_another_form |= isinstance(value, str) and value in OTHER_DOCUMENTS
        else:
            self.split = escaped(value) if isinstance(value, str) else None
            check_split_name(value, self._manifest, self.faults)

    def _read_predictions(self) -> None:
        if self._stream.peek() != "[":
            self._refuse_predictions()
            return
        self.n_predictions = 0
        for index in elements(self._stream):
            self._stop_when_full()
            self._reading = ("predictions", index)
            value = self._stream.value()
            self._report_repeated(value, self._reading)
            self._read_prediction(value, index)
            self.n_predictions = index + 1

    def _refuse_predictions(self) -> None:
        is_object = self._stream.peek() == "{"
        value = None if is_object else self._stream.value()
        got = "an object" if is_object else kind(value)
        hint = None
        if is_object:
            hint = f"write a list; the sample id stands inside each prediction: {CONVERT}` does"
        self.faults.add(
            FaultCode.WRONG_TYPE, ("predictions",), expected="a list", got=got, hint=hint
        )
        if is_object:
            skip(self._stream)

    def _read_prediction(self, value: Any, index: int) -> None:
        path: Path = ("predictions", index)
        if not isinstance(value, dict):
            hint = None
            if isinstance(value, list) and value and isinstance(value[0], dict):
                hint = f"write all predictions into one list: {CONVERT}` does"
            self._refuse(FaultCode.WRONG_TYPE, path, "an object", kind(value), hint=hint)
            return
        rules = self._rules or self._choose_rules(value)
        stated = value.get("sample_id")
        sample_id = self._ids.admit(stated, index) if "sample_id" in value else None
        shown_id = sample_id or (escaped(stated) if isinstance(stated, str) else None)
        if value.keys() != rules.required_keys:
            self._check_keys(value, rules, path, shown_id)
        answer = rules.answer(value, path, shown_id)
        if sample_id is not None:
            self._one_by_one[sample_id] = answer

    def _check_keys(
        self, value: dict[str, Any], rules: PredictionRules, path: Path, sample_id: str | None
    ) -> None:
        absent = rules.required_keys - value.keys()
        known = rules.required_keys | rules.optional_keys
        for key in sorted(value.keys() - known):
            meant = meant_key(key, absent)
            absent = absent - {meant}
            expected = f"only {', '.join(sorted(known))}"
            hint = f"did you mean {quoted(meant)}?" if meant else None
            self._refuse(
                FaultCode.UNKNOWN_KEY, (*path, key), expected, quoted(key), sample_id, hint
            )
        for key in sorted(absent):
            self._absent[key] += 1
            self._refuse(FaultCode.MISSING_KEY, path, f"the key {quoted(key)}", "none", sample_id)

    def _choose_rules(self, prediction: dict[str, Any]) -> PredictionRules:
        challenge = self.challenge or self._wanted
        if "schema" not in self._seen:
            challenge = find_challenge(JsonStream(self._data)) or challenge
        for key in prediction:
            challenge = challenge or challenge_by_key(key)
        self._rules = RULES[challenge or PLANNING.id](self._protocol, self.faults)
        return self._rules

    def _report_missing_keys(self) -> None:
        for key in ROOT_KEYS:
            if key not in self._seen:
                hint = None
                if key != "predictions" and type(self._rules) is RULES[PLANNING.id]:
                    hint = self._convert_hint
                if key == "predictions" and len(self._wrapped_in) == 1:
                    hint = f"are they under {quoted(self._wrapped_in[0])}? Call it predictions"
                self._refuse(FaultCode.MISSING_KEY, (), f"the key {quoted(key)}", "none", hint=hint)

    def _report_repeated(self, value: Any, path: Path) -> None:
        if self._stream.has_repeated_keys:
            report_repeated_keys(value, path, self.faults)

    def _stop_when_full(self) -> None:
        if self.faults.is_full:
            raise _TooManyFaultsError

    def _sound_document(self) -> CheckedDocument | None:
        if not self.faults.is_empty or self.split is None or self.challenge is None:
            return None
        rules = self._rules or RULES[self.challenge](self._protocol, self.faults)
        self.notes += rules.notes(len(self._answers), self.profile)
        if self._foretells_rank:
            self.unranked_because = rules.unranked_because(len(self._answers), self.profile)
        return rules.document(self.split, self._answers)

    @property
    def _convert_hint(self) -> str:
        return convert_advice(self._manifest)

    def _form_hint(self, error: JsonStreamError) -> str | None:
        """Say what a file that is not JSON probably is."""
        if error.code is not FaultCode.NOT_JSON:
            return None
        if error.got.startswith(COMMENTS):
            return A_COMMENT
        if error.got.startswith(CLOSING) and error.expected in AFTER_A_COMMA:
            return "a comma stands in front of this bracket: remove it"
        if self._data.lstrip().startswith((b"{", b"[")):
            is_cut = not self._data.rstrip().endswith((b"}", b"]"))
            return "it stops before its end; was the copy cut off?" if is_cut else None
        if self._data.startswith((b'"{', b'"[')):
            return "JSON within a JSON text: write the object itself"
        first_line = self._data[:MAX_HEADER_BYTES].splitlines()[0]
        for delimiter, name in CSV_DELIMITERS.items():
            if first_line.count(delimiter) < MIN_CSV_DELIMITERS:
                continue
            header = {
                word.strip(b'" ').decode(errors="replace") for word in first_line.split(delimiter)
            }
            if absent := [column for column in CSV_COLUMNS if column not in header]:
                return (
                    f"looks like CSV with {name}, without {', '.join(absent)} in its first line: write "
                    f"one waypoint a row under {','.join(CSV_COLUMNS)}, which convert reads"
                )
            return f"looks like CSV with {name}; {self._convert_hint}"
        return None


UTF8_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True)
class Checked:
    """The outcome of a check: the report, and the file's content, None if anything is wrong."""

    report: CheckReport
    document: CheckedDocument | None


def check(
    data: bytes,
    *,
    protocol: ProtocolDocument,
    manifest: Manifest | None = None,
    challenge: ChallengeId | None = None,
    max_upload_bytes: int = MAX_UPLOAD_BYTES,
    max_inflated_bytes: int = MAX_INFLATED_BYTES,
    foretells_rank: bool = True,
) -> Checked:
    """Check a submission file and return its content.

    Raises nothing for any content of the file, uses at most a few times its inflated size of
    memory, and reads it once.

    Args:
        data: The file, plain JSON or gzip.
        protocol: Gives waypoints, bounds, tasks and the frame check.
        manifest: Sample ids of the split; without it ids are only checked for duplicates.
        challenge: The challenge that the file must be for if the manifest names none; None: any.
        max_upload_bytes: Most bytes of the file itself.
        max_inflated_bytes: Most bytes of JSON in it.
        foretells_rank: Whether to say why it would not be ranked; needless if a score follows.
    """
    faults = FaultList()
    wanted = (manifest and manifest.challenge) or challenge
    faults.is_convertible = wanted != STRATEGY.id
    try:
        text = inflate(
            data, max_upload_bytes=max_upload_bytes, max_inflated_bytes=max_inflated_bytes
        )
    except UnreadableFileError as error:
        hint = convert_advice(manifest) if error.got in CONVERTIBLE else None
        faults.add(error.code, (), expected=error.expected, got=error.got, hint=hint)
        return Checked(_report_of(data, faults), None)
    if b'"strategy"' in text and b'"edited"' not in text:  # conversion cannot help
        faults.is_convertible = False
    reader = SubmissionReader(
        _without_byte_order_mark(text, faults),
        protocol=protocol,
        manifest=manifest,
        challenge=challenge,
        faults=faults,
        foretells_rank=foretells_rank,
    )
    document = reader.read()
    return Checked(_report_of(data, faults, reader), document)


def _without_byte_order_mark(text: bytes, faults: FaultList) -> bytes:
    if not text.startswith(UTF8_BYTE_ORDER_MARK):
        return text
    faults.add(
        FaultCode.BYTE_ORDER_MARK,
        (),
        expected="JSON from the first byte on",
        got="EF BB BF",
        hint=f"{CONVERT}` writes it without",
    )
    return text[len(UTF8_BYTE_ORDER_MARK) :]


def _report_of(
    data: bytes, faults: FaultList, reader: SubmissionReader | None = None
) -> CheckReport:
    return CheckReport(
        challenge=reader.challenge if reader else None,
        split=reader.split if reader else None,
        n_predictions=reader.n_predictions if reader else None,
        digest=bytes_digest(data),
        size_bytes=len(data),
        faults=faults.groups(
            reader.n_predictions if reader else None,
            is_of_planner=not (reader and reader.profile and reader.profile.mend),
        ),
        notes=tuple(reader.notes) if reader else (),
        profile=reader.profile if reader else None,
        unranked_because=reader.unranked_because if reader else None,
    )
