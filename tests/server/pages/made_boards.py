"""Boards whose numbers hang together: every entry has scenes of its own, and all follows from them."""

from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import combinations, count
from typing import Any

from hypothesis import strategies as st
from tests.server.pages.invented_board import COUNTS, MANIFEST, PROTOCOL, N

from exceptiondrive_schemas.board import (
    Board,
    BoardEntry,
    EntrySource,
    FamilyCell,
    FamilyHead,
    PairedComparison,
)
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, ChallengeId
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.reported import reported_entries
from exceptiondrive_schemas.score_sheet import (
    ClearanceCurve,
    Flag,
    Interval,
    MetricRow,
    PairedDifference,
    ProtocolRef,
    ScoreSheet,
)

AT = datetime(2026, 11, 20, tzinfo=UTC)
NEWER = Flag(code="of_a_newer_scorer", label="Seen later", detail="Not known here.")
_numbers = count()
shares = st.integers(0, 100).map(lambda points: points / 100)


def _counts(draw: Any, n_parts: int) -> dict[str, list[int]]:
    """How the scenes of each family fall into the parts: anyhow, or all but one scene alike."""
    alike = draw(st.sampled_from([None, None, None, 0, n_parts - 1]))
    if alike is None:
        cuts = {
            family: sorted(draw(st.tuples(*[st.integers(0, n)] * (n_parts - 1))))
            for family, n in COUNTS.items()
        }
        return {
            family: [b - a for a, b in zip([0, *ends], [*ends, COUNTS[family]], strict=True)]
            for family, ends in cuts.items()
        }
    counts = {
        family: [n * (part == alike) for part in range(n_parts)] for family, n in COUNTS.items()
    }
    one = counts[next(iter(COUNTS))]
    one[alike], one[n_parts - 1 - alike] = one[alike] - 1, 1
    return counts


def _values(draw: Any, challenge: Challenge, counts: list[int]) -> MetricRow:
    """The metrics of one family, whose scenes fall into the parts of the outcome bar."""
    parts, n = [part.metric for part in challenge.words.outcome], sum(counts)
    values: MetricRow = {key: number / n for key, number in zip(parts, counts, strict=True)}
    if "clear" in values:
        clear, close, reacting, unmoved = (number / n for number in counts)
        values["hcc"] = clear + close * draw(st.sampled_from([0.2, 0.5, 0.9]))
        values |= {"ur": reacting + unmoved, "progress": draw(shares)}
    return values


def _mean(rows: Mapping[str, MetricRow], weights: Mapping[str, float]) -> MetricRow:
    total = sum(weights.values())
    keys = next(iter(rows.values()))
    return {
        key: round(sum((rows[f][key] or 0) * weights[f] for f in rows) / total, 4) for key in keys
    }


def _around(draw: Any, value: float | None) -> Interval | None:
    half = draw(st.sampled_from([None, 0.01, 0.05, 0.2]))
    if half is None or value is None:
        return None
    return (round(max(0.0, value - half), 4), round(min(1.0, value + half), 4))


def _entry(draw: Any, challenge: Challenge, source: EntrySource, has_intervals: bool) -> BoardEntry:
    number = next(_numbers)
    counts = _counts(draw, len(challenge.words.outcome))
    rows = {family: _values(draw, challenge, counts[family]) for family in COUNTS}
    micro, macro = _mean(rows, COUNTS), _mean(rows, dict.fromkeys(COUNTS, 1))
    if draw(st.booleans()):  # as an older scorer gives it, or without a source to go along
        drop = draw(st.sampled_from(["clear", "progress"])) if "clear" in micro else ""
        for row in (micro, macro, *rows.values()):
            row.pop(drop, None)
    codes = draw(
        st.lists(
            st.sampled_from(["stands_still", "blind_to_the_edit", "reverses", ""]),
            max_size=2,
            unique=True,
        )
    )
    flags = [FLAGS[code] if code else NEWER for code in codes]
    first = challenge.metrics[0].key
    ends = {key: _around(draw, value) for key, value in macro.items()} if has_intervals else {}
    return BoardEntry(
        source=source,
        rank=None,
        rank_interval=None,
        submission_id=f"m{number:07d}kq",
        method=f"Planner{number:05d}x",
        team="Makers",
        submitted_at=AT,
        metrics=macro,
        macro_family=macro,
        micro=micro,
        intervals=ends,
        families={
            family: FamilyCell.model_validate({
                "n": COUNTS[family],
                **{key: None if value is None else round(value, 4) for key, value in row.items()},
                "intervals": {first: _around(draw, row[first])},
            })
            for family, row in rows.items()
        },
        coverage={"edited": 1.0},
        flags=tuple(
            Flag(code=flag.code, label=flag.label, detail="In so many scenes.") for flag in flags
        ),
    )  # fmt: skip


def _difference(draw: Any, a: BoardEntry, b: BoardEntry, value: float) -> PairedDifference:
    low, high = sorted((draw(st.integers(-30, 30)) / 100, draw(st.integers(-30, 30)) / 100))
    is_known = draw(st.integers(0, 5)) > 0
    better = a if low > 0 else b
    verdict = f"{better.method} is better" if low > 0 or high < 0 else "not separable on this split"
    return PairedDifference(
        difference=round(value, 4),
        interval=(low, high) if is_known else None,
        discordant=0.5,
        verdict=verdict if is_known else "no interval",
    )


def _pair(draw: Any, challenge: Challenge, a: BoardEntry, b: BoardEntry) -> PairedComparison:
    first, second = (metric.key for metric in challenge.metrics[:2])
    return PairedComparison(
        a=a.submission_id or "",
        b=b.submission_id or "",
        overall={
            key: _difference(draw, a, b, (a.metrics[key] or 0) - (b.metrics[key] or 0))
            for key in (first, second)
        },
        families={family: _difference(draw, a, b, 0.0) for family in COUNTS},
    )


def with_curve(sheet: ScoreSheet, entry: BoardEntry) -> ScoreSheet:
    """Give a sheet a clearance curve that fits its entry, where outcomes were counted."""
    if "clear" not in entry.metrics:
        return sheet

    def points(row: MetricRow) -> tuple[float, ...]:
        start, full = 1 - (row["ur"] or 0.0), row["clear"] or 0.0
        return (start, (start + full) / 2, full, full / 2, 0.0)

    curve = ClearanceCurve(step=0.5, micro=points(entry.micro), macro_family=points(entry.metrics))
    return sheet.model_copy(update={"clearance_curve": curve})


@st.composite
def made_boards(draw: Any, challenge_id: ChallengeId, phase: str) -> Board:
    """A board of some scored entries, references and the paper's rows."""
    challenge = CHALLENGES[challenge_id]
    first, second = (metric.key for metric in challenge.metrics[:2])
    has_intervals, lists_flags = draw(st.booleans()), draw(st.booleans())
    scored = [
        _entry(draw, challenge, "scored", has_intervals) for _ in range(draw(st.integers(0, 6)))
    ]
    scored.sort(key=lambda e: (-(e.metrics[first] or 0), e.metrics[second] or 0))
    listed = [e for e in scored if lists_flags and any(f.code == "stands_still" for f in e.flags)]
    ranked: list[BoardEntry] = []
    values: list[tuple[float | None, float | None]] = []
    for place, entry in enumerate([e for e in scored if e not in listed], 1):
        value = (entry.metrics[first], entry.metrics[second])
        rank = ranked[-1].rank if values and values[-1] == value else place
        ends = (draw(st.integers(1, rank or 1)), draw(st.integers(rank or 1, len(scored))))
        update = {"rank": rank, "rank_interval": ends if has_intervals else None}
        ranked.append(entry.model_copy(update=update))
        values.append(value)
    because = draw(
        st.sampled_from(
            [
                {
                    "unranked_flags": ("stands_still",),
                    "unranked_because": "flagged: it stands still",
                },
                {"unranked_because": "66.67% of the samples are answered; a rank needs 99%"},
            ]
        )
    )
    references = [_entry(draw, challenge, "reference", has_intervals) for _ in range(2)]
    pairs = combinations(ranked[:3], 2) if draw(st.booleans()) else ()
    return Board(
        challenge=challenge_id,
        phase=phase,
        split=MANIFEST.ref,
        protocol=ProtocolRef(version="1.0", digest=PROTOCOL.digest),
        headline="macro_family",
        board=1,
        published_at=AT,
        n_samples=N,
        confidence=0.95,
        families=tuple(
            FamilyHead(id=family.id, title=family.title, n=COUNTS[family.id])
            for family in PROTOCOL.families
        ),
        entries=(
            *ranked,
            *(entry.model_copy(update=because) for entry in listed),
            *references,
            *reported_entries(challenge_id, "macro_family"),
        ),
        comparisons=tuple(_pair(draw, challenge, a, b) for a, b in pairs),
        min_scenes=None if has_intervals else 10,
    )
