"""The challenges as data: their submission files, their metrics, their rank order.

A challenge differs from others in two registrations: its metrics and texts, with the check of its
file (`exceptiondrive_schemas.check.rules`), and its measurement and grading
(`exceptiondrive_scoring.challenge`, which the server never imports).
Upload, jobs, records, rescoring, boards and pages share the same code.
"""

from collections.abc import Iterable
from functools import partial
from typing import Annotated, Any, Literal, NewType, TypeVar

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core.core_schema import CoreSchema, no_info_after_validator_function

from exceptiondrive_schemas import formulas
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.python310 import Self


class HeadlineWords(Document):
    """The page's headline, chosen by the leader's second primary metric over all samples: it counts.

    `{often}` is set as "in about one of 3 samples", `{rest}` as `{often}` of one minus that.
    `{the}` is "The leading", `{even_the}` "Even the leading"; of one alone both are "The only ranked".
    """

    question: str
    """Where nobody leads."""
    leads: str
    """The leader's two primary metrics, `{first}` and `{second}`, in a newcomer's words; in the average that
    ranks, so it counts nothing."""
    by_share: tuple[tuple[float, str], ...] = Field(min_length=1)
    """From this share on, these words; highest first, the last one from 0 on."""


class CodeWords(Document):
    """What the quick start shows: file and method names, and a program that writes the file."""

    file: str
    method: str
    program: str
    """Python, beside `recorder.py`: reads the manifest and writes the file that its arguments name."""


class OutcomePart(Document):
    """One part of the outcome bar: a metric that is a share of samples, and how it is drawn."""

    metric: str
    words: str
    kind: Literal["kept", "lost", "hit", "unmoved"]


Corner = Literal["top left", "top right", "bottom left", "bottom right"]


class ChartWords(Document):
    """The chart of two metrics, fractions both: which, and what its corners mean."""

    x: str
    y: str
    title: str
    note: str
    corners: dict[Corner, str]
    same_scale: bool = False
    """Whether a point along x is as long as one along y: of parts of one whole."""


class ChallengeWords(Document):
    """Words of one challenge. Between double stars stands what is set bold."""

    subject: str
    """What is submitted: "planner", "agent"."""
    subjects: str
    answers: str
    """What the file holds: "trajectories", "answers"."""
    task: str
    """Continues "ExceptionDrive adds a hazard to a driving scene and"."""
    scene_caption: str
    """Under the drawing; `{clearance_m}`, `{d_safe_m}` and `{hcc}` are filled in."""
    sample_note: str
    """What a sample is, under the number of samples."""
    headline: HeadlineWords
    withheld: str
    """What of a withheld split nobody outside knows, in a sentence."""
    chart: ChartWords
    outcome: tuple[OutcomePart, ...]
    """Shares of samples that sum to one, in the order of the bar. A row without all of them, as of a
    scorer that did not count them, has no bar."""
    covered: dict[str, str]
    """What the shares of a coverage count: "edited" and, where there is one, "source"."""
    file_note: str
    """What a file is made of, in a sentence."""
    alike: str
    """What of two submissions is compared in search of copies, and what counts as the same."""
    code: CodeWords


PLANNING_WORDS = ChallengeWords(
    subject="planner",
    subjects="planners",
    answers="trajectories",
    task="scores the path that a planner would drive.",
    withheld="The hazard regions are withheld.",
    scene_caption="A scene with a hazard from above, to scale. **UR** counts the samples in which "
    "the area that the car sweeps touches the red hazard. **HCC** pays for the distance kept, up to "
    "the amber line: here d = {clearance_m:.2f} of {d_safe_m:.2f} m, so {hcc:.2f}. **CTS** is the "
    "mean gap between the dotted path, of the original scene, and the solid one.",
    sample_note="samples, without and with a hazard",
    headline=HeadlineWords(
        question="Which planner keeps clear of the hazard?",
        leads="it earns {first} of the credit for keeping its distance (HCC) and hits the hazard in "
        "{second} of samples (UR)",
        by_share=(
            (0.501, "{even_the} planner hits the hazard {often}."),
            (0.1, "{the} planner hits the hazard {often}."),
            (0.0, "{the} planner stays out of the hazard {rest}."),
        ),
    ),
    chart=ChartWords(
        x="progress",
        y="hcc",
        title="Safety against progress",
        note="Standing still is safe, but it is not driving. Progress is how far along its own path in "
        "the original scene a planner still gets once the hazard is there. A parked car is alone at the "
        "left; better is up, without giving up more progress than the hazard requires.",
        corners={"top left": "safe, gets nowhere", "top right": "safe, and gets on"},
    ),
    outcome=(
        OutcomePart(metric="clear", words="keeps the required clearance", kind="kept"),
        OutcomePart(metric="close", words="clear, but too close", kind="lost"),
        OutcomePart(metric="hit_reacting", words="in the hazard, although it reacted", kind="hit"),
        OutcomePart(metric="hit_unmoved", words="in the hazard, unmoved", kind="unmoved"),
    ),
    covered={"edited": "samples as edited", "source": "original scenes"},
    file_note="One JSON file with {waypoints} waypoints per trajectory, two trajectories per "
    "sample.",
    alike="Compared are the paths for the scene with the hazard, sample by sample; those at most 5 cm "
    "apart, on the mean of their waypoints, count as the same answer. Paths for the original scene are "
    "not compared.",
    code=CodeWords(
        file="planner.json.gz",
        method="My planner",
        program="""\
import json, sys
from recorder import Recorder

def plan(sample_id, scene):
    # A stand-in: put your planner here. scene is "source" or "edited";
    # x forward, y left, in metres, at 0.5, 1.0, ... 3.0 s.
    return [(3.5 * step, 0.0) for step in range(1, 7)]

manifest, output = sys.argv[1:]
split = json.load(open(manifest))["name"]
with Recorder(output, split=split, manifest=manifest) as recorder:
    for sample_id in sorted(recorder.missing):
        source, edited = plan(sample_id, "source"), plan(sample_id, "edited")
        recorder.add(sample_id, source=source, edited=edited)
""",
    ),
)

STRATEGY_WORDS = ChallengeWords(
    subject="agent",
    subjects="agents",
    answers="answers",
    task="scores what an agent says to do about it.",
    withheld="The task of each scene is withheld.",
    scene_caption="A scene with a hazard from above, to scale. The agent answers with a strategy: "
    "**A** maintain path, **B** slow down, **C** stop, **D** yield, **E** prepare to bypass. "
    "**Under-warning** counts answers that are wrong and too careless.",
    sample_note="samples, with a hazard",
    headline=HeadlineWords(
        question="Which agent is careful enough?",
        leads="{first} of its answers are acceptable, {second} too careless",
        by_share=(
            (0.1, "{even_the} agent is too careless {often}."),
            (0.0, "{the} agent is careful enough {rest}."),
        ),
    ),
    chart=ChartWords(
        x="under_warning",
        y="over_warning",
        title="Two ways to be wrong",
        note="A wrong answer is too careless (under-warning, to the right) or wrong in another way "
        "(over-warning, up): too cautious, say, or a detour where one has to stop. What both leave "
        "of 100 is the accuracy. Both axes have one scale.",
        corners={
            "bottom left": "never wrong",
            "bottom right": "too careless",
            "top left": "wrong otherwise",
        },
        same_scale=True,
    ),
    outcome=(
        OutcomePart(metric="accuracy", words="acceptable", kind="kept"),
        OutcomePart(metric="over_warning", words="wrong, not too careless", kind="lost"),
        OutcomePart(metric="under_warning", words="too careless, or no answer", kind="hit"),
    ),
    covered={"edited": "samples"},
    file_note="One JSON file with one letter per sample: what the agent would do in the edited "
    "scene.",
    alike="Compared is the strategy that is named for each sample. Reminders are not compared.",
    code=CodeWords(
        file="agent.json.gz",
        method="My agent",
        program="""\
import json, sys
from recorder import StrategyRecorder

def decide(sample_id):
    # A stand-in: put your agent here. It says "A" to "E", or None.
    return "B"

manifest, output = sys.argv[1:]
split = json.load(open(manifest))["name"]
with StrategyRecorder(output, split=split, manifest=manifest) as recorder:
    for sample_id in sorted(recorder.missing):
        recorder.add(sample_id, strategy=decide(sample_id))
""",
    ),
)


ChallengeId = NewType("ChallengeId", str)
"""Identifier of a challenge: the key of its registration. It is no enumeration, because challenges
can be added; readers of answers accept unknown ones."""


class UnknownChallengeError(KeyError):
    """Nothing is registered under this identifier."""

    def __init__(self, challenge_id: str, known: Iterable[str]) -> None:
        self.sentence = f"There is no challenge {challenge_id!r} here; known: {', '.join(known)}."
        super().__init__(self.sentence)

    def __str__(self) -> str:
        return self.sentence


class Metric(Document):
    """One column of a board: what it is called, which way is better, what it may decide.

    `aggregation` says what the values of samples become in a task, a family and overall: their mean,
    the share of ones (the mean of zeros and ones), their minimum, or a quantile without
    interpolation: the least value that a share of `level` of the samples does not exceed.
    """

    key: str
    label: str
    plain: str = ""
    """The label in everyday words, over a column; empty where the label is everyday."""
    title: str
    unit: Literal["fraction", "metre"]
    better: Literal["higher", "lower"] | None = None
    """None: neither way."""
    role: Literal["primary", "diagnostic"] = "diagnostic"
    """A primary one may rank entries."""
    meaning: str
    formula: str = ""
    """Its equation as MathML; empty where words are enough."""
    part_of: str = ""
    """Key of the metric of which it is a component; it is explained there."""
    aggregation: Literal["mean", "share", "minimum", "quantile"] = "mean"
    level: float | None = Field(default=None, gt=0, le=1)
    """Of a quantile: 0.5 is the median."""
    shown: Literal["column", "extra column", "details"] = "column"
    """Where: a column of the board; one that is off until it is chosen; or only with the details of
    an entry, in comparisons and exports. What is a column, on or off, has intervals."""
    cells: Literal["always", "of public regions", "of public drives"] = "always"
    """On which splits families and tasks are told it: what it asks of regions or of recorded paths,
    beside what is told already, must be public (docs/leakage.md). Totals are always told."""
    may_be_undefined: bool = False
    """Whether a sample can leave it undefined, which is then in no mean: as a shift without a source
    trajectory. Such a metric asks nothing of regions."""

    @model_validator(mode="after")
    def _a_quantile_has_a_level(self) -> Self:
        if (self.aggregation == "quantile") != (self.level is not None):
            raise ValueError("a quantile, and nothing else, has a level")
        return self

    @property
    def order_level(self) -> float | None:
        """The order statistic of the samples, 0 for the minimum; None for a mean."""
        return 0.0 if self.aggregation == "minimum" else self.level


Order = Literal["descending", "ascending"]
"""Whether more of a metric is better (`descending`), or less."""


class RankKey(Document):
    """One key of the rank order."""

    metric: str
    order: Order


class Challenge(Document):
    """A challenge: the schema of its submission file, its metrics in column order, its words."""

    id: ChallengeId
    title: str
    file_schema: str
    metrics: tuple[Metric, ...]
    words: ChallengeWords
    of_controls: tuple[Metric, ...] = ()
    """Metrics over the controls of a split: in the total `micro` alone, where it has controls."""
    has_waypoints: bool = False
    """Whether its files hold as many waypoints as the protocol says."""
    has_profile: bool = False
    """Whether what its files look like can be told (`check.source_fit`)."""
    is_ordered_by_protocol: bool = False
    """Whether every protocol must say what ranks it; else `primary_order` does where it does not.
    For a challenge that came after the first protocols were stored, which never change."""
    counterpart: str | None = None
    """What a submission may be linked to, and is then compared with; None: links are refused."""

    @property
    def metric_keys(self) -> tuple[str, ...]:
        """Keys of all metrics, in column order."""
        return tuple(metric.key for metric in self.metrics)

    @property
    def columns(self) -> tuple[Metric, ...]:
        """Metrics that are columns of a board unless a reader hides them."""
        return tuple(metric for metric in self.metrics if metric.shown == "column")

    @property
    def interval_metrics(self) -> tuple[Metric, ...]:
        """Metrics with intervals, which are compared in pairs."""
        return tuple(metric for metric in self.metrics if metric.shown != "details")

    @property
    def primary_order(self) -> tuple[RankKey, ...]:
        """Primary metrics in column order, the better value first."""
        return tuple(
            RankKey(
                metric=metric.key, order="ascending" if metric.better == "lower" else "descending"
            )
            for metric in self.metrics
            if metric.role == "primary"
        )

    def metric(self, key: str) -> Metric:
        """Return the metric called `key`.

        Raises:
            KeyError: This challenge has no such metric.
        """
        for metric in (*self.metrics, *self.of_controls):
            if metric.key == key:
                return metric
        raise KeyError(key)


_SOURCE_L2 = (
    "Mean distance of the path in the original scene from the drive that was recorded there: "
    "whether the file plans for these scenes at all."
)
_share = partial(Metric, unit="fraction", aggregation="share")
_outcome = partial(_share, shown="details", cells="of public regions")
"""A share of samples by outcome: a part of the bar (`ChallengeWords.outcome`)."""

PLANNING = Challenge(
    id=ChallengeId("planning"),
    title="Planning",
    file_schema="exceptiondrive.planning/1",
    words=PLANNING_WORDS,
    is_ordered_by_protocol=True,
    has_waypoints=True,
    has_profile=True,
    metrics=(
        Metric(
            key="hcc",
            label="HCC",
            plain="Stays safely away",
            title="Hazard Clearance Compliance",
            unit="fraction",
            better="higher",
            role="primary",
            meaning="For each sample: zero in the hazard, then growing with the distance kept until the "
            "required clearance is met.",
            formula=formulas.HCC,
        ),
        _share(
            key="ur",
            label="UR",
            plain="Drives into it",
            title="Unsafe Rate",
            better="lower",
            role="primary",
            meaning="Share of samples in which the area that the car sweeps touches the hazard.",
            formula=formulas.UR,
        ),
        Metric(
            key="hpr",
            label="HPR",
            plain="Right distance",
            title="Hazard Proximity Response",
            unit="fraction",
            meaning="Peaks where clearance equals the required clearance; too close and too far "
            "both cost. Not a safety score.",
            formula=formulas.HPR,
        ),
        Metric(
            key="cts",
            label="CTS",
            plain="Path moved",
            title="Counterfactual Trajectory Shift",
            unit="metre",
            may_be_undefined=True,
            meaning="How far the trajectory moved once the hazard appeared. Moving is not the "
            "same as avoiding.",
            formula=formulas.CTS,
        ),
        Metric(
            key="cts_x",
            label="CTSx",
            plain="ahead",
            title="CTS, longitudinal",
            unit="metre",
            may_be_undefined=True,
            meaning="Longitudinal part of the shift.",
            part_of="cts",
        ),
        Metric(
            key="cts_y",
            label="CTSy",
            plain="aside",
            title="CTS, lateral",
            unit="metre",
            may_be_undefined=True,
            meaning="Lateral part of the shift.",
            part_of="cts",
        ),
        Metric(
            key="progress",
            label="Progress",
            plain="Still drives on",
            title="Progress along the original path",
            unit="fraction",
            may_be_undefined=True,
            shown="extra column",
            meaning="How far along its own path of the original scene the planner still gets: 0 for "
            "standing still, reversing or moving sideways. Driving on is not the same as driving "
            "safely.",
            formula=formulas.PROGRESS,
        ),
        _outcome(
            key="clear",
            label="Clear",
            title="Keeps the required clearance",
            better="higher",
            meaning="Share of samples whose clearance is the required one or more.",
        ),
        _outcome(
            key="close",
            label="Close",
            title="Clear but too close",
            meaning="Share of samples clear of the hazard whose clearance is below the required one.",
        ),
        _outcome(
            key="hit_reacting",
            label="Hit, reacting",
            title="In the hazard although it reacted",
            better="lower",
            meaning="Share of samples in the hazard whose trajectory moved once the hazard appeared, "
            "but not enough or the wrong way.",
        ),
        _outcome(
            key="hit_unmoved",
            label="Hit, unmoved",
            title="In the hazard, unmoved",
            better="lower",
            meaning="Share of samples in the hazard whose trajectory hardly moved, or is missing.",
        ),
        *(
            Metric(
                key=f"source_l2_{span}m",
                label=f"Source L2{at}",
                title=f"Source trajectory against the recorded drive{at}",
                unit="metre",
                better="lower",
                may_be_undefined=True,
                shown="details",
                cells="of public drives",
                meaning=meaning,
                part_of="source_l2_m" if span else "",
            )
            for span, at, meaning in (
                ("", "", _SOURCE_L2),
                *(
                    (
                        f"{seconds}s_",
                        f" at {seconds} s",
                        f"Distance at the waypoint at {seconds} s.",
                    )
                    for seconds in (1, 2, 3)
                ),
            )
        ),
    ),
    of_controls=(
        _share(
            key="over_caution",
            label="Over-caution",
            title="Over-caution",
            better="lower",
            shown="details",
            meaning="Of the controls, where no good driver would heed the hazard, the share in which "
            "the planner gives up more than half of its way.",
        ),
    ),
)

STRATEGY = Challenge(
    id=ChallengeId("strategy"),
    title="Strategy",
    file_schema="exceptiondrive.strategy/1",
    words=STRATEGY_WORDS,
    is_ordered_by_protocol=True,
    counterpart="the same agent without reminder",
    metrics=(
        _share(
            key="accuracy",
            label="Accuracy",
            plain="Acceptable answer",
            title="Strategy accuracy",
            better="higher",
            role="primary",
            meaning="Share of samples whose answer is in the acceptable set.",
            formula=formulas.ACCURACY,
        ),
        _share(
            key="under_warning",
            label="Under-warning",
            plain="Too careless",
            title="Under-warning rate",
            better="lower",
            role="primary",
            meaning="Wrong, and less cautious than the least cautious acceptable strategy.",
            formula=formulas.UNDER_WARNING,
        ),
        _share(
            key="over_warning",
            label="Over-warning",
            plain="Wrong otherwise",
            title="Over-warning rate",
            meaning="Wrong, but not too little caution.",
        ),
        _share(
            key="missing",
            label="Missing",
            plain="No answer",
            title="Missing answers",
            better="lower",
            meaning="No answer given; counted as wrong and under-warning.",
        ),
    ),
)

Registered = TypeVar("Registered")


class Registry(dict[ChallengeId, Registered]):
    """One value for each challenge; a failed lookup names the challenges that exist."""

    def register(self, challenge_id: ChallengeId, thing: Registered) -> None:
        """Add the value of a challenge.

        Raises:
            ValueError: The challenge has one.
        """
        if challenge_id in self:
            raise ValueError(f"the challenge {challenge_id} is registered already")
        self[challenge_id] = thing

    def __getitem__(self, challenge_id: str) -> Registered:
        try:
            return super().__getitem__(ChallengeId(challenge_id))
        except KeyError:
            raise UnknownChallengeError(challenge_id, self) from None


CHALLENGES: Registry[Challenge] = Registry()
"""Filled by `exceptiondrive_schemas.check.rules`, which importing this package runs."""


def challenge_of_file(file_schema: str) -> Challenge | None:
    """Return the challenge whose files name this schema."""
    return next((each for each in CHALLENGES.values() if each.file_schema == file_schema), None)


class _Known:
    """Requires a registered challenge, and lists them in JSON Schemas."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return no_info_after_validator_function(_known_challenge, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {**handler(schema), "enum": list(CHALLENGES)}


def _known_challenge(challenge_id: str) -> ChallengeId:
    if challenge_id not in CHALLENGES:
        raise ValueError(f"must be one of {', '.join(CHALLENGES)}")
    return ChallengeId(challenge_id)


KnownChallenge = Annotated[ChallengeId, _Known()]
"""A challenge as named in a request."""
