"""Further rows of a score sheet, as `evaluate` prints them."""

from collections.abc import Mapping

from rich.console import Console

from exceptiondrive.cli.file_tables import sheet_view
from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    MetricRow,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_server.web.numbers import fixed

ROW: MetricRow = {"accuracy": 0.5, "under_warning": 0.25, "over_warning": 0.25, "missing": 0.0}


def printed(
    extra: dict[str, MetricRow],
    families: Mapping[str, BreakdownRow] = {},
    protocol: ProtocolDocument | None = None,
    shares: Mapping[str, float | None] = {},
) -> list[str]:
    sheet = ScoreSheet(
        challenge=STRATEGY.id,
        protocol=ProtocolRef(version="1.0", digest="sha256:0"),
        split=SplitRef(name="tiny", revision="sha256:1"),
        scorer_version="1",
        n=4,
        coverage=Coverage(edited=1.0),
        micro=ROW,
        macro_family=ROW,
        families=dict(families),
        tasks={},
        plausibility=Plausibility(shares=dict(shares)),
        extra=extra,
    )
    console = Console(width=160)
    with console.capture() as capture:
        for part in sheet_view(sheet, protocol):
            console.print(part)
    return [" ".join(line.split()) for line in capture.get().splitlines()]


def test_confusion_is_printed_as_counts_and_reminder_scores_as_shares() -> None:
    lines = printed(
        {
            "confusion_CD": {"n": 3.0, "A": 1.0, "C": 2.0},
            "confusion_C": {"n": 1.0, "A": 1.0, "C": 0.0},
            "reminder": {"n": 3.0, "given": 1.0, "presence_recall": None},
        }
    )
    start = lines.index("n A C")
    assert lines[start + 1 : start + 3] == ["confusion C 1 1 0", "confusion CD 3 1 2"]
    assert lines[start + 3 : start + 5] == ["n given presence recall", "reminder 3 100.00% none"]


def test_answers_without_a_source_are_not_called_edited() -> None:
    assert "answers given: 100.00%" in printed({})


def test_shares_of_plausibility_are_rounded_as_on_the_page_of_an_entry() -> None:
    for share in (0.0625, 0.4715, 0.06254999, 0.0):
        page = fixed(100 * round(share, 4), 1)
        assert f"plausibility: blind {page}%" in printed({}, shares={"blind": share})
    assert "plausibility: blind 6.3%" in printed({}, shares={"blind": 0.0625})


def test_a_family_that_is_not_told_is_explained() -> None:
    withheld = BreakdownRow.of(48, dict.fromkeys(ROW))
    families = {"large": BreakdownRow.of(400, ROW), "small": withheld}
    lines = printed({}, families)
    assert lines.index("small 48 - - - -") < lines.index(
        "-: families or tasks of too few samples are not told, but for their number"
    )
    rules = packaged_protocol("1.1-withheld")
    told = "-: families or tasks of fewer than 100 samples are not told, but for their number"
    assert told in printed({}, families, rules)
    assert not [line for line in printed({}, {"large": families["large"]}, rules) if "told" in line]
    none_there = {"empty": BreakdownRow.of(0, dict.fromkeys(ROW))}
    assert not [line for line in printed({}, none_there, rules) if "told" in line]


def test_a_sheet_of_this_machine_and_a_kept_one_are_printed_alike() -> None:
    """Kept sheets come sorted by key."""
    rows: dict[str, MetricRow] = {
        "confusion_CD": {"n": 3.0, "A": 1.0, "C": 2.0, "missing": 0.0},
        "confusion_C": {"n": 1.0, "A": 1.0, "C": 0.0, "missing": 0.0},
        "reminder": {"given": 1.0, "presence_recall": 0.5, "presence_precision": 0.5},
    }
    shares = {"same_answer": 0.5, "blind": 0.25}
    kept = {key: dict(sorted(row.items())) for key, row in sorted(rows.items())}
    assert printed(rows, shares=shares) == printed(kept, shares=dict(sorted(shares.items())))
