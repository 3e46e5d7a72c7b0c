"""The score sheet: totals and breakdown of one scoring run, all that may ever be published."""

from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, WithJsonSchema

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import ChallengeId, Metric
from exceptiondrive_schemas.printable import decimal_text
from exceptiondrive_schemas.protocol import Average, ProtocolDocument, PublicationSection
from exceptiondrive_schemas.python310 import Self
from exceptiondrive_schemas.split import SplitRef

REMINDER = "reminder"
"""The extra row with the scores of reminder records; only for files that have some."""
HEADLINE: Average = "macro_family"
"""The aggregate that is shown if no protocol names one."""

MetricRow = dict[str, float | None]
"""Metric key to value: fractions, CTS in metres, undefined = None."""
METRIC_ROW = TypeAdapter(MetricRow)
RowValue = Annotated[
    float | Any | None,
    Field(union_mode="left_to_right"),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "null"}]}),
]
"""Value of a metric; or, in a row of a newer server, any other value."""

Interval = tuple[float, float]


def is_whole_percent(share: float) -> bool:
    """Whether a share needs no decimals as a percentage."""
    return abs(share - round(share, 2)) < 1e-8


class ProtocolRef(Document):
    """Which protocol, by version and digest."""

    version: str
    digest: str

    @classmethod
    def of(cls, protocol: ProtocolDocument) -> Self:
        """Return the reference of a document."""
        return cls(version=protocol.version, digest=protocol.digest)


class Coverage(Document):
    """Share of samples that carry an answer, and their exact numbers.

    A sheet of before there were numbers leaves them out.
    """

    edited: float
    """From 0 to 1."""
    source: float | None = None
    n_edited: int | None = Field(default=None, exclude_if=lambda it: it is None)
    n_source: int | None = Field(default=None, exclude_if=lambda it: it is None)

    def exact_shares(self, n: int) -> dict[str, float]:
        """Share by side of the n samples: from exact numbers if given, else as rounded."""
        told = {"edited": (self.n_edited, self.edited), "source": (self.n_source, self.source)}
        shares = {
            side: share if count is None else count / n for side, (count, share) in told.items()
        }
        return {side: share for side, share in shares.items() if share is not None}


class Flag(Document):
    """A visible mark on an entry, with the sentence that explains it."""

    code: str
    label: str
    detail: str


class Plausibility(Document):
    """Shares published beside the score, never folded into it (docs/protocol.md section 5)."""

    shares: dict[str, float | None]
    """From 0 to 1; None where undefined."""
    flags: tuple[Flag, ...] = ()


class ClearanceCurve(Document):
    """Share of samples that keep at least a multiple of the required clearance.

    Point k stands for k times `step` of the required clearance. The first is the share clear of the
    hazard, 1 - UR; the area up to 1 is HCC, as exactly as the step allows (docs/protocol.md).
    """

    step: float
    micro: tuple[float, ...]
    macro_family: tuple[float, ...]


class BreakdownRow(Document):
    """One family or task: `n` and the metrics, flat: `{"n": 12, "hcc": 0.4, ...}`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, RowValue]

    n: int | None

    @classmethod
    def of(cls, n: int | None, metrics: MetricRow) -> Self:
        """Return the row of `n` samples with these metrics."""
        return cls.model_validate({"n": n, **METRIC_ROW.validate_python(metrics)})

    @property
    def metrics(self) -> MetricRow:
        """Metric key to value."""
        return {
            key: value
            for key, value in self.__pydantic_extra__.items()
            if value is None or isinstance(value, float)
        }


class ScoreSheet(Document):
    """Totals, families and tasks of one (submission, protocol version, split revision)."""

    challenge: ChallengeId
    protocol: ProtocolRef
    split: SplitRef
    scorer_version: str
    n: int
    """Samples that count."""
    coverage: Coverage
    micro: MetricRow
    """Mean over all samples: metric key to value. Shares from 0 to 1; those of distances, as `cts`
    and `source_l2_m`, in metres; None where undefined."""
    macro_family: MetricRow
    """The same, as the mean over the families, each counting the same."""
    families: dict[str, BreakdownRow]
    """By id of the family."""
    tasks: dict[str, BreakdownRow]
    """By id of the task."""
    plausibility: Plausibility
    extra: dict[str, MetricRow] = {}
    """Further named rows: sensitivity to d_safe, confusion, reminder scores."""
    clearance_curve: ClearanceCurve | None = Field(default=None, exclude_if=lambda it: it is None)
    """Left out where the challenge has none or the protocol does not publish it."""

    @property
    def has_reminders(self) -> bool:
        """Whether reminder records came with the answers."""
        return REMINDER in self.extra

    def average(self, name: Average) -> MetricRow:
        """Return the totals of one of the two averages, by the protocol's name for it."""
        return self.micro if name == "micro" else self.macro_family


def metric_text(
    metric: Metric, value: float | None, publication: PublicationSection | None = None
) -> str:
    """Format a fraction or metres as the board shows it, by default with two digits.

    It is first rounded like a board's sheets: 0.64375 minus a tiny error is 64.37 %.
    """
    if value is None:
        return "-"
    if metric.unit == "fraction":
        decimals = publication.percent_decimals if publication else 2
        return decimal_text(100 * round(value, decimals + 2), decimals)
    decimals = publication.metre_decimals if publication else 2
    return decimal_text(round(value, decimals), decimals)


def text_with_unit(
    metric: Metric, value: float, publication: PublicationSection | None = None
) -> str:
    """Format a value for running text: `65.47 %`, `1.20 m`."""
    unit = "%" if metric.unit == "fraction" else "m"
    return f"{metric_text(metric, value, publication)} {unit}"


class PairedDifference(Document):
    """With the reminder minus without it, in one metric, sample by sample.

    `discordant` is the share of the samples in which the two answers differ in this metric.
    """

    difference: float | None
    interval: Interval | None
    """Of the difference, at the confidence of the board; None: it has none."""
    discordant: float | None
    verdict: str
    """In words, with the names of methods. A program goes by `interval`: where it is null or holds 0 the two
    are not told apart, else the first has the higher value above 0 and the lower one below."""


class ReminderEffect(Document):
    """What the reminder changed: an entry against the linked submission without reminder."""

    without: str
    without_method: str
    differences: dict[str, PairedDifference]

    @property
    def by_metric(self) -> MetricRow:
        """The differences without their intervals."""
        return {key: paired.difference for key, paired in self.differences.items()}
