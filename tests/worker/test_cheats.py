"""Cheats and mistakes on a live board: what ranks under 1.0, what under 1.1, and what `check` says.

The table that comes of it stands in docs/trust.md.
"""

import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support import cheats, realdata
from tests.support.cheats import CHEATS, MISTAKES, OF_CONTROLS_ALONE, File
from tests.support.worker import worker_settings
from tests.worker.world import World

from exceptiondrive_records.operations.invariants import broken_boards
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
    packaged_protocol,
    packaged_protocol_toml,
)
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
from exceptiondrive_worker.sample.planners import PLANNERS, predictions
from exceptiondrive_worker.sample.scenes import SEED, sample_scenes, sample_split
from exceptiondrive_worker.splits.store import LoadedSplit, load_split, read_split

VERSIONS = ("1.0", "1.1")
COPY = "copy of another team"
TRUST = Path(__file__).parents[2] / "docs" / "trust.md"
UNPARSED = ("gpt-4.1", "gpt-4o")
"""Give too few answers to rank under any protocol; a missing one counts as one that stands."""
HONEST = "Late Braker"
"""Whose file is made a cheat of: it sees hazards late and brakes for them."""


@dataclass(frozen=True)
class Outcome:
    """What became of one file: its rows by protocol, and what `check` says of it."""

    rows: Mapping[str, BoardEntry]
    report: CheckReport

    @property
    def flags(self) -> tuple[str, ...]:
        return tuple(flag.code for flag in self.rows["1.1"].flags)

    @property
    def named(self) -> tuple[str, ...]:
        """What `check` finds in the file: faults, and what it looks like."""
        profile = self.report.profile
        return (
            *(str(group.code) for group in self.report.faults),
            *(profile.warnings if profile else ()),
        )


def honest_file(planner: int, split: Split, families: Mapping[str, int]) -> File:
    answers = predictions(PLANNERS[planner], sample_scenes(), SEED)
    missing = [[np.nan] * 2] * 6
    source, edited = (
        np.array([getattr(each, key) or missing for each in answers], dtype=float)
        for key in ("source", "edited")
    )
    return File(source, edited, np.array([families[each.sample_id] for each in answers]))


class Contest:
    """One split, a phase under each protocol, and every file in both."""

    def __init__(self, world: World, split: Split, entries: Mapping[str, File]) -> None:
        self.world, self.entries = world, entries
        self.manifest = Manifest.of(split, packaged_protocol("1.1").geometry)
        ids = self.manifest.sample_ids
        self.files = {
            name: json.dumps(cheats.document(file, ids, split.name)).encode()
            for name, file in entries.items()
        }
        for version in VERSIONS:
            with world.database.write() as session:
                add_protocol(session, packaged_protocol_toml(version), "test")
            world.add_phase(split, phase_of(version), protocol=version)
            for number, (name, data) in enumerate(self.files.items()):
                if self.report(name).is_valid:
                    where = {"phase_id": phase_of(version), "team": f"team-{number}"}
                    world.score(data, method=name, **where)
        self.boards = {version: world.build_board(phase_of(version)) for version in VERSIONS}

    def report(self, name: str) -> CheckReport:
        protocol = packaged_protocol("1.1")
        return check(self.files[name], manifest=self.manifest, protocol=protocol).report

    def outcome(self, name: str) -> Outcome:
        rows = {
            version: row
            for version, board in self.boards.items()
            for row in board.entries
            if row.method == name
        }
        return Outcome(rows, self.report(name))

    def table(self) -> str:
        """The evidence, as it stands in docs/trust.md."""
        lines = [
            "| file | HCC | rank under 1.0 | flags | rank under 1.1 | `check` |",
            "|" + "---|" * 6,
        ]
        for name in self.entries:
            one = self.outcome(name)
            said = "; ".join(text.split(":")[0] for text in one.named) or "\u2013"
            if not one.rows:
                lines.append(f"| {name} | \u2013 | refused | \u2013 | refused | {said} |")
                continue
            old, new = (one.rows[version] for version in VERSIONS)
            flags = ", ".join(flag.label for flag in new.flags) or "\u2013"
            hcc = 100 * (new.metrics["hcc"] or 0)
            ranks = [str(row.rank or "listed") for row in (old, new)]
            lines.append(f"| {name} | {hcc:.2f} | {ranks[0]} | {flags} | {ranks[1]} | {said} |")
        return "\n".join(lines)


def phase_of(version: str) -> str:
    return f"under-{version.replace('.', '-')}"


def with_cheats(honest: Mapping[str, File], base: str) -> dict[str, File]:
    """The honest files, and what is made of one of them."""
    file = honest[base]
    made = {name: change(file) for name, change in {**CHEATS, **MISTAKES}.items()}
    return {**honest, **made, COPY: replace(file, edited=file.edited + 0.001)}


@pytest.fixture(scope="module")
def contest(tmp_path_factory: pytest.TempPathFactory, migrated_sqlite: Path) -> Any:
    folder = tmp_path_factory.mktemp("cheats")
    database = folder / "records.sqlite3"
    database.write_bytes(migrated_sqlite.read_bytes())
    world = World(worker_settings(folder, f"sqlite:///{database}"))
    split, taxonomy = sample_split(), packaged_protocol("1.1").taxonomy
    order = [family.id for family in taxonomy.families]
    families = {
        each.sample_id: order.index(taxonomy.task(each.task).family) for each in split.samples
    }
    honest = {
        planner.method: honest_file(number, split, families)
        for number, planner in enumerate(PLANNERS)
    }
    made = Contest(world, split, with_cheats(honest, HONEST))
    yield made
    world.close()


@pytest.mark.parametrize("name", CHEATS)
def test_no_trivial_file_ranks_under_1_1(contest: Contest, name: str) -> None:
    row = contest.outcome(name).rows["1.1"]
    assert row.rank is None
    assert row.unranked_flags
    assert str(row.unranked_because).startswith("flagged ")


@pytest.mark.parametrize("name", MISTAKES)
def test_every_mistake_is_named_by_check_or_flagged(contest: Contest, name: str) -> None:
    outcome = contest.outcome(name)
    assert outcome.named or outcome.flags
    assert outcome.named, "with public recorded paths, `check` names every one of these"


def test_check_tells_before_what_the_scorer_flags_without_a_region(contest: Contest) -> None:
    told_of = set()
    for name in contest.entries:
        outcome = contest.outcome(name)
        if not outcome.report.is_valid:
            continue
        said = outcome.report.unranked_because or ""
        for code in ("impossible_motion", "reverses"):
            assert (FLAGS[code].label in said) == (code in outcome.flags), (name, code, said)
            told_of |= {code} & set(outcome.flags)
        if FLAGS["hardly_moves"].label in said:
            told_of.add("hardly_moves")
            assert "hardly_moves" in outcome.flags, (name, said)
    assert told_of == {"impossible_motion", "reverses", "hardly_moves"}


def test_standing_still_leads_under_1_0_and_nothing_under_1_1(contest: Contest) -> None:
    old = {row.method: row.rank for row in contest.boards["1.0"].entries}
    assert old["zeros in edited scenes"] == old["back 0.51 m"] == 1
    assert all(board.leader is not None for board in contest.boards.values())
    assert {board.leader.method for board in contest.boards.values() if board.leader} <= {
        *(planner.method for planner in PLANNERS),
        "mirrored",  # ranks by right of its numbers, and is named by `check`
    }


def test_all_honest_planners_rank_under_both(contest: Contest) -> None:
    for planner in PLANNERS:
        outcome = contest.outcome(planner.method)
        assert outcome.flags == ()
        assert all(row.rank is not None for row in outcome.rows.values())
        assert outcome.named == ()


def test_metrics_are_the_same_under_both(contest: Contest) -> None:
    for name in contest.entries:
        rows = contest.outcome(name).rows
        assert not rows or rows["1.0"].metrics == rows["1.1"].metrics


def test_a_copy_stands_in_the_similarity_report(contest: Contest) -> None:
    with contest.world.database.read() as session:
        report = similarity_report(session, phase_of("1.1"))
    assert {COPY, HONEST} in [{pair.first.method, pair.second.method} for pair in report.pairs]


def test_nothing_is_wrong_with_such_boards(contest: Contest) -> None:
    with contest.world.database.read() as session:
        assert list(broken_boards(session)) == []


def test_the_table_of_the_docs_is_what_comes_of_it(contest: Contest) -> None:
    table = contest.table()
    assert table in TRUST.read_text("utf-8"), f"docs/trust.md should say:\n{table}"


def test_standing_in_both_inputs_of_half_the_scenes_gains_until_a_protocol_flags_it() -> None:
    protocol = packaged_protocol("1.1")
    loaded = load_split(sample_split(), protocol)
    assert loaded.rows is not None
    families = dict.fromkeys(loaded.manifest.sample_ids, 0)
    honest = honest_file([each.method for each in PLANNERS].index(HONEST), sample_split(), families)
    honest = replace(honest, source=honest.source[loaded.rows], edited=honest.edited[loaded.rows])
    stands = (np.arange(len(loaded.rows)) % 25 < 12)[:, None, None]
    half = honest.both(lambda paths: np.where(stands, 0.0, paths))
    assert [round(hcc(each, loaded), 3) for each in (honest, half)] == [0.267, 0.634]
    assert barring_flags(half, loaded) == set()
    section = protocol.plausibility.model_copy(update={"flag_source_stationary": 0.2})
    stricter = protocol.model_copy(update={"plausibility": section})
    assert barring_flags(half, loaded, stricter) == {"source_stands_still"}
    assert barring_flags(honest, loaded, stricter) == set()


def test_an_agent_that_nearly_always_stops_is_right_in_most_samples_and_not_flagged() -> None:
    protocol, scoring = packaged_protocol("1.1"), scoring_of(STRATEGY.id)
    assert all("C" in task.acceptable for task in protocol.tasks)
    loaded = load_split(sample_split(), protocol)
    ids = loaded.manifest.sample_ids
    answers = [
        {"sample_id": key, "strategy": "C" if number % 12 else "B"}
        for number, key in enumerate(ids)
    ]
    document = {"schema": STRATEGY.file_schema, "split": "sample", "predictions": answers}
    checked = check(json.dumps(document).encode(), manifest=loaded.manifest, protocol=protocol)
    assert checked.document is not None
    measured = scoring.measure(
        scoring.columns(checked.document, loaded.counted_ids), loaded.arrays, protocol.geometry
    )
    sheet = exact_sheet(scoring, measured, loaded.arrays, loaded.manifest.ref, protocol)
    assert round(sheet.macro_family["accuracy"] or 0, 3) == 0.947
    assert sheet.plausibility.flags == ()


# The same on files of real planners, where they are: flags from the sheet alone.


def real_files(name: str) -> tuple[LoadedSplit, dict[str, File]]:
    """A split of real scenes, with the recorded paths where they are known, and its files."""
    realdata.require()
    split = read_split(realdata.split_path(name))
    found = {
        method: read_answers(realdata.file_path(name, method)) for method in realdata.PLANNERS[name]
    }
    if "recorded-human" in found:
        drives = {
            key: tuple((x, y) for x, y in each["source"])
            for key, each in found["recorded-human"].items()
        }
        samples = tuple(
            each.model_copy(update={"recorded": drives[each.sample_id]}) for each in split.samples
        )
        split = split.model_copy(update={"samples": samples})
    loaded = load_split(split, packaged_protocol("1.1"))
    missing = [[np.nan] * 2] * 6

    def paths(by_id: Mapping[str, Any], side: str) -> cheats.Array:
        rows = [by_id[key][side] or missing for key in loaded.manifest.sample_ids]
        return np.array(rows, dtype=float)

    return loaded, {
        method: File(paths(by_id, "source"), paths(by_id, "edited"), loaded.arrays.family_index)
        for method, by_id in found.items()
    }


def read_answers(path: Path) -> dict[str, Any]:
    document = json.loads(gzip.decompress(path.read_bytes()))
    return {each["sample_id"]: each for each in document["predictions"]}


def measured(file: File, loaded: LoadedSplit) -> Columns:
    columns = {key: np.ascontiguousarray(getattr(file, key)) for key in ("source", "edited")}
    geometry = packaged_protocol("1.1").geometry
    return scoring_of(PLANNING.id).measure(columns, loaded.arrays, geometry)


def hcc(file: File, loaded: LoadedSplit) -> float:
    scoring, ref = scoring_of(PLANNING.id), loaded.manifest.ref
    protocol = packaged_protocol("1.1")
    sheet = exact_sheet(scoring, measured(file, loaded), loaded.arrays, ref, protocol)
    return sheet.macro_family["hcc"] or 0.0


def barring_flags(
    file: File, loaded: LoadedSplit, protocol: ProtocolDocument | None = None
) -> set[str]:
    protocol = protocol or packaged_protocol("1.1")
    columns = measured(file, loaded)
    flags = scoring_of(PLANNING.id).plausibility(columns, loaded.arrays, protocol).flags
    return {flag.code for flag in flags} & set(protocol.ranking.unranked_flags)


@pytest.mark.parametrize("name", realdata.PLANNERS)
def test_real_planners_keep_their_rank_and_cheats_made_of_them_have_none(name: str) -> None:
    loaded, files = real_files(name)
    standing = {method: barring_flags(file, loaded) for method, file in files.items()}
    parsed = {method: flags for method, flags in standing.items() if method not in UNPARSED}
    assert not any(parsed.values()), parsed
    base = files["recorded-human" if "recorded-human" in files else "cosmos"]
    for cheat, change in CHEATS.items():
        if cheat not in OF_CONTROLS_ALONE:  # these splits have no controls
            assert barring_flags(change(base), loaded), cheat
