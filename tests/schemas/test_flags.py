"""Flags, which protocol ranks in spite of which, and who may be named as the best."""

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.coverage import too_little_covered
from exceptiondrive_schemas.flags import FLAGS, bars_leading
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import (
    NEWEST,
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.published import example_text
from exceptiondrive_schemas.score_sheet import Coverage, Flag
from exceptiondrive_schemas.split import Manifest

Path = list[list[float]]
Pair = tuple[Path, Path]
DRIVE: Path = [[1.5 * t, 0.0] for t in range(1, 7)]
STANDS: Path = [[0.0, 0.0]] * 6
TOLD_OF_A_FILE: Mapping[str, Callable[[Path], Pair]] = {
    "stands_still": lambda drive: (drive, STANDS),
    "source_stands_still": lambda drive: (STANDS, drive),
    "impossible_motion": lambda drive: (
        drive,
        [[x, 9.0 * (-1) ** i] for i, (x, _) in enumerate(drive)],
    ),
    "reverses": lambda drive: (drive, [[-x, y] for x, y in drive]),
    "blind_to_the_edit": lambda drive: (drive, drive),
    "off_course": lambda drive: ([[x, x / 2] for x, _ in drive], drive),
    "hardly_moves": lambda drive: (drive, [[x / 20, y] for x, y in drive]),
    "same_answer": lambda drive: (drive, DRIVE),
}
"""Source and edited trajectory, of the drive that was recorded, as the planner of each flag makes them."""
NEED_THE_REGIONS = {"over_cautious"}
"""Which samples are controls is withheld."""


def test_protocol_1_1_measures_and_grades_as_1_0_does() -> None:
    old, new = packaged_protocol("1.0"), packaged_protocol(NEWEST)
    assert new.version == "1.1"
    assert new.geometry_digest == old.geometry_digest
    assert new.grading_digest == old.grading_digest
    assert new.ranking_digest != old.ranking_digest
    assert new.digest == "sha256:5d5d161332b270aec38504d2b00242c4416782ab87d6013fca4955e877a8a658"


def test_1_0_ranks_in_spite_of_all_flags_and_1_1_of_one() -> None:
    assert packaged_protocol("1.0").ranking.unranked_flags == ()
    assert set(packaged_protocol("1.1").ranking.unranked_flags) == {
        *("stands_still", "source_stands_still", "impossible_motion", "reverses"),
        *("off_course", "hardly_moves", "over_cautious", "same_answer"),
    }


@pytest.mark.parametrize(
    ("codes", "problem"),
    [('["stand_still"]', "no flag is called 'stand_still'"),
     ('["reverses", "reverses"]', "must differ from one another")],
)  # fmt: skip
def test_flags_that_take_a_rank_are_known_and_stand_once(codes: str, problem: str) -> None:
    toml = re.sub(r"(?s)unranked_flags = \[.*?\n\]", f"unranked_flags = {codes}",
                  packaged_protocol_toml("1.1"))  # fmt: skip
    with pytest.raises(ProtocolError, match=problem):
        parse_protocol(toml)


def test_a_check_tells_every_flag_that_a_file_tells() -> None:
    assert {*TOLD_OF_A_FILE, *NEED_THE_REGIONS} == set(FLAGS)


@pytest.mark.parametrize("code", TOLD_OF_A_FILE)
def test_a_check_tells_a_flag_before_an_upload(code: str, manifest: Manifest) -> None:
    protocol = packaged_protocol(NEWEST)
    ranking = protocol.ranking.model_copy(update={"unranked_flags": tuple(FLAGS)})
    drives = {
        f"s-{number:03}": [[x * (2 + number / 15), y] for x, y in DRIVE] for number in range(30)
    }
    pairs = {key: TOLD_OF_A_FILE[code](drive) for key, drive in drives.items()}
    document: dict[str, Any] = {
        "schema": "exceptiondrive.planning/1",
        "split": manifest.name,
        "predictions": [
            {"sample_id": key, "source": source, "edited": edited}
            for key, (source, edited) in pairs.items()
        ],
    }
    report = check(
        json.dumps(document).encode(),
        protocol=protocol.model_copy(update={"ranking": ranking}),
        manifest=manifest.model_copy(update={"recorded": drives, "sample_ids": tuple(drives)}),
    ).report
    assert report.faults == ()
    assert f"flagged {FLAGS[code].label}: " in (report.unranked_because or "")


@pytest.mark.parametrize(
    ("letters", "unranked_flags", "because"),
    [
        ("C" * 20 + "A", ("same_answer",), "flagged Same answer: 95.2% are C"),
        ("C" * 20 + "A", (), None),
        ("C" * 19 + "A", ("same_answer",), None),
        ("C" * 19, ("same_answer",), None),
        (
            "ABCDE" * 4 + "-",
            ("same_answer",),
            "95.24% of the samples are answered; a rank needs 99%",
        ),
    ],
)
def test_a_check_tells_of_one_strategy_for_nearly_all_and_of_too_few_answers(
    letters: str, unranked_flags: tuple[str, ...], because: str | None, manifest: Manifest
) -> None:
    protocol = packaged_protocol(NEWEST)
    ranking = protocol.ranking.model_copy(update={"unranked_flags": unranked_flags})
    answers = {f"s-{n:03}": None if each == "-" else each for n, each in enumerate(letters)}
    document = {
        "schema": "exceptiondrive.strategy/1",
        "split": manifest.name,
        "predictions": [{"sample_id": key, "strategy": letter} for key, letter in answers.items()],
    }
    report = check(
        json.dumps(document).encode(),
        protocol=protocol.model_copy(update={"ranking": ranking}),
        manifest=manifest.model_copy(update={"sample_ids": tuple(answers)}),
        challenge=STRATEGY.id,
    ).report
    assert report.faults == ()
    assert report.unranked_because == because


def test_a_flag_and_a_challenge_of_a_newer_server_are_read_and_such_a_flag_bars_leading() -> None:
    document = json.loads(packaged_protocol("1.1").model_dump_json(by_alias=True))
    document["ranking"]["unranked_flags"].append("drives_by_night")
    document["ranking"]["order"]["night_driving"] = [{"metric": "glare", "order": "ascending"}]
    read = ProtocolDocument.read(json.dumps(document))
    assert "drives_by_night" in read.ranking.unranked_flags
    assert "night_driving" in read.ranking.order
    assert bars_leading(["drives_by_night"])
    assert not bars_leading(["blind_to_the_edit"])
    assert not bars_leading([])


def ranked(*entries: tuple[int | None, tuple[str, ...]]) -> Board:
    """A board of entries, each with its rank and its flags."""
    board = Board.model_validate_json(example_text("board"))
    rows = tuple(
        board.entries[0].model_copy(
            update={
                "method": f"entry {number}",
                "rank": rank,
                "flags": tuple(Flag(code=code, label=code, detail="") for code in codes),
            }
        )
        for number, (rank, codes) in enumerate(entries)
    )
    return board.model_copy(update={"entries": (*rows, *board.entries[1:])})


def test_the_leader_is_the_best_ranked_entry_that_no_flag_bars() -> None:
    first = ranked((1, ("stands_still",)), (2, ("blind_to_the_edit",)), (3, ()), (None, ()))
    assert first.leader is not None
    assert first.leader.method == "entry 1"
    assert ranked((1, ("reverses",)), (None, ())).leader is None
    equal = ranked((1, ()), (1, ()))
    assert equal.leader is not None
    assert equal.leader.method == "entry 0"


def test_coverage_is_exact_where_numbers_are_told() -> None:
    told = Coverage(edited=0.99, source=1.0, n_edited=296, n_source=299)
    assert told.exact_shares(299) == {"edited": 296 / 299, "source": 1.0}
    assert Coverage(edited=0.99).exact_shares(299) == {"edited": 0.99}
    assert Coverage(edited=0.99).model_dump() == {"edited": 0.99, "source": None}


@pytest.mark.parametrize(
    ("share", "limit", "said"),
    [
        (0.196, 0.2, "19.6%"),
        (0.1949, 0.2, "19%"),
        (0.9504, 0.95, "95.04%"),
        (0.0504, 0.05, "5.04%"),
        (0.13, 0.125, "13%"),
        (0.5 + 1e-9, 0.5, "more than 50%"),
    ],
)
def test_a_share_past_a_limit_shows_on_which_side_of_it_it_lies(
    share: float, limit: float, said: str
) -> None:
    assert share_past(share, limit) == said


@pytest.mark.parametrize(
    ("share", "least", "said"),
    [
        (0.75, 0.99, "75.00% of the samples are answered; a rank needs 99%"),
        (0.99, 0.995, "99.00% of the samples are answered; a rank needs 99.5%"),
        (0.995 - 1e-9, 0.995, "less than 99.5% of the samples are answered; a rank needs 99.5%"),
    ],
)
def test_the_least_share_is_said_as_the_protocol_has_it(
    share: float, least: float, said: str
) -> None:
    assert too_little_covered({"edited": "samples"}, {"edited": share}, least) == said
