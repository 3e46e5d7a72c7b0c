"""The published board: an immutable snapshot of ranked entries."""

from collections.abc import Iterator, Mapping
from datetime import datetime
from functools import cached_property
from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.api.phase_settings import BoardView, SplitPart
from exceptiondrive_schemas.base import Document, canonical_json, pieces_digest
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId, RankKey
from exceptiondrive_schemas.flags import bars_leading
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import Average
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Flag,
    Interval,
    MetricRow,
    PairedDifference,
    ProtocolRef,
    ReminderEffect,
    is_whole_percent,
)
from exceptiondrive_schemas.split import SplitRef

EntrySource = Literal["scored", "reported", "reference"]


class FamilyCell(BreakdownRow):
    """One family of one entry; `n` is None where a paper does not report it."""

    intervals: dict[str, Interval | None] = {}


class PairedComparison(Document):
    """Two entries on the same samples and the same draws; every difference is A minus B.

    Overall by metric; each family and task by the first metric of the challenge. A difference is that of the
    two published values, to the last digit; of shifts and progress, which a sample may leave undefined,
    it is over the samples that both define, as its interval is. A task's interval is rounded
    outward to whole per cents and gives its verdict; how many of its samples differ is not said.
    """

    a: str
    """Submission id of the better ranked one."""
    b: str
    """Submission id of the other."""
    overall: dict[str, PairedDifference]
    families: dict[str, PairedDifference]
    tasks: dict[str, PairedDifference] = Field(default={}, exclude_if=lambda it: not it)


class BoardEntry(Document):
    """One row of a board. Only scored entries carry a rank."""

    source: EntrySource
    rank: int | None
    """None: it does not rank; `unranked_because` says why."""
    rank_interval: tuple[int, int] | None
    """Best and worst rank that sampling of scenes leaves open."""
    previous_rank: int | None = None
    """On the board that was shown before, where it ranked there."""
    unranked_because: str | None = None
    unranked_flags: tuple[str, ...] = Field(default=(), exclude_if=lambda it: not it)
    """Codes of the flags for which it takes no rank. It stands below the ranked entries, in the
    order that it would have; left out where there are none."""
    submission_id: str | None
    """Its page is `/entries/ID`; None of rows that nobody submitted."""
    method: str
    team: str
    """Name of the team, or its pseudonym in an anonymous phase."""
    description: str = ""
    links: Links = Links()
    submitted_at: datetime | None
    metrics: MetricRow
    """The average that ranks here (`headline`): metric key to value. Shares from 0 to 1; those of
    distances, as `cts` and `source_l2_m`, in metres; None where undefined."""
    micro: MetricRow
    """Mean over all samples."""
    macro_family: MetricRow
    """Mean over the families, each counting the same."""
    intervals: dict[str, Interval | None]
    """Metric key to lower and upper end, of `metrics`."""
    families: dict[str, FamilyCell]
    """Family id to its number of samples and metrics."""
    coverage: dict[str, float | None] = {}
    """Share of the samples that are answered, from 0 to 1."""
    flags: tuple[Flag, ...] = ()
    cite: str | None = None
    """Where a reported row is found."""
    reminder_effect: ReminderEffect | None = Field(default=None, exclude_if=lambda it: it is None)
    """Left out where there is none: such an entry reads as it did before there were links."""
    is_late: bool = Field(default=False, exclude_if=lambda it: not it)
    """It came after the deadline: on the late view alone."""

    @property
    def may_lead(self) -> bool:
        """Whether it may be named as the best here: ranked, without a flag that bars leading."""
        barred = self.flags and bars_leading(flag.code for flag in self.flags)
        return self.rank is not None and not barred

    def has_fine_intervals(self, challenge: str) -> bool:
        """Whether a share's interval (a family's if it has none) has an end that is no whole per cent."""
        rows = [self] if any(self.intervals.values()) else self.families.values()
        found = (
            row.intervals.get(metric.key)
            for row in rows
            for metric in CHALLENGES[challenge].metrics
            if metric.unit == "fraction"
        )
        return any(each is not None and not all(map(is_whole_percent, each)) for each in found)


class BoardLeader(Document):
    """Who led a board, and the value of the first metric of the challenge."""

    submission_id: str
    method: str
    team: str
    value: float


class EntryNews(Document):
    """What became of an entry since the board that was shown before."""

    submission_id: str
    method: str
    team: str
    rank: int | None
    """On the newer of the two boards that it stands on."""
    before: float | None
    """The first metric of the challenge, on the board before; None of an entry that came in. Of a new run, that of
    the run whose place it took."""
    after: float | None
    """The same on this board; None of an entry that left."""
    is_new: bool = False
    is_new_run: bool = False
    """It took the place of an earlier run of the same method, which is not told apart."""
    has_left: bool = False


class BoardNews(Document):
    """Entries that came in, left, or have another value than on the board shown before.

    Of two boards under one protocol and split revision: of others, the comparison of the update
    tells every entry.
    """

    entries: tuple[EntryNews, ...] = ()
    n_more: int = 0
    """How many more there are than are named."""


class FamilyHead(Document):
    """A family column: its title and how many samples it has on this split."""

    id: str
    title: str
    n: int
    n_scenes: int | None = Field(default=None, exclude_if=lambda it: it is None)
    """In how many scenes these lie, told where that is fewer than intervals take."""


class Board(Document):
    """A whole board. Its digest is its strong ETag."""

    challenge: ChallengeId
    phase: str
    split: SplitRef
    protocol: ProtocolRef
    headline: Average
    """Which average ranks; `metrics` of an entry tells it."""
    board: int
    """Number of the board within its phase: its permanent address is
    `/api/v1/boards/PHASE/NUMBER`."""
    published_at: datetime
    n_samples: int
    """Samples that count."""
    confidence: float
    """Of all intervals, such as 0.95."""
    interval_method: str = (
        "expanded percentile bootstrap over scenes, the same draws for every entry; "
        "Wilson's for a share that is 0 in every draw, or 1 in every draw"
    )
    """How `intervals` and rank intervals are found; draws and seed stand in the protocol."""
    families: tuple[FamilyHead, ...]
    entries: tuple[BoardEntry, ...]
    """Ranked entries first, best first, unless the request sorts them otherwise."""
    comparisons: tuple[PairedComparison, ...] = Field(default=(), exclude_if=lambda it: not it)
    """Every two of the best ranked entries, the better ranked first; submission ids. Of a withheld split,
    of different teams alone."""
    view: BoardView = Field(default="main", exclude_if=lambda it: it == "main")
    """`late` ranks late entries among the others, and moves no rank of the board."""
    part: SplitPart | None = Field(default=None, exclude_if=lambda it: it is None)
    """Which part of the split counts; left out where all samples do."""
    min_scenes: int | None = Field(default=None, exclude_if=lambda it: it is None)
    """Told where scenes are fewer than the intervals of `metrics` take, of the mean of families those of
    one family: no entry has any, nor a range of ranks."""

    @cached_property
    def has_fine_intervals(self) -> bool:
        """Whether an interval of a share is finer than whole per cents, as on no withheld split."""
        return any(entry.has_fine_intervals(self.challenge) for entry in self.entries)

    @cached_property
    def leader(self) -> BoardEntry | None:
        """The best ranked entry that may be named as the best; None if there is none.

        Of equal ranks, the first one listed.
        """
        fit = (entry for entry in self.entries if entry.may_lead)
        return min(fit, key=lambda entry: entry.rank or 0, default=None)

    def contenders(self, first: RankKey, place: int = 1) -> tuple[BoardEntry, ...]:
        """Return the entries whose rank intervals reach a place, the best first.

        Entries that a comparison puts behind the leader in the metric that ranks first are left
        out: on a withheld split rank intervals are wider than that. So are entries without a
        comparison with the leader that rank below one of those.
        """
        sign = 1 if first.order == "descending" else -1
        leader = self.leader.submission_id if self.leader else None
        compared = {pair.b: pair for pair in self.comparisons if pair.a == leader}
        behind = {
            name
            for name, pair in compared.items()
            if (found := pair.overall.get(first.metric)) is not None
            and found.interval is not None
            and min(sign * end for end in found.interval) > 0
        }
        ranks = [each.rank or 0 for each in self.entries if each.submission_id in behind]
        last = min(ranks, default=len(self.entries))

        def is_behind(entry: BoardEntry) -> bool:
            if entry.submission_id in compared:
                return entry.submission_id in behind
            return (entry.rank or 0) > last

        return tuple(
            entry
            for entry in self.entries
            if entry.rank_interval is not None
            and entry.rank_interval[0] <= place
            and not is_behind(entry)
        )

    @cached_property
    def entries_by_submission(self) -> Mapping[str, BoardEntry]:
        """The entries that are submissions, by their ids."""
        return {entry.submission_id: entry for entry in self.entries if entry.submission_id}

    @cached_property
    def content_digest(self) -> str:
        """Digest of the content, independent of number and date."""
        return pieces_digest(self.canonical_pieces("board", "published_at"))

    def canonical_pieces(self, *left_out: str) -> Iterator[bytes]:
        """Yield the canonical JSON of the board, without some fields, entry by entry.

        Building it at once would take many times its size in memory.
        """
        frame = self.model_copy(update={"entries": ()}).model_dump(mode="json", by_alias=True)
        for name in left_out:
            del frame[name]
        # no text contains these bytes: its quotes are escaped
        before, _, after = canonical_json(frame).partition(b'"entries":[]')
        yield before + b'"entries":['
        for number, entry in enumerate(self.entries):
            yield (b"," if number else b"") + canonical_json(entry)
        yield b"]" + after
