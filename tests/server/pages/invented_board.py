"""A lively board for tests and screenshots: six invented entries, references, the paper's rows.

The invented entries exist here alone; nothing of them ships.
"""

import base64
from datetime import UTC, datetime, timedelta

from exceptiondrive_schemas.board import Board, BoardEntry, FamilyCell, FamilyHead
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.datasheet import (
    Agreement,
    Audit,
    Cell,
    Datasheet,
    Decider,
    Example,
    SplitChange,
    SplitWarning,
    Stage,
    WithdrawnSamples,
    Words,
)
from exceptiondrive_schemas.method_facts import Links
from exceptiondrive_schemas.protocol import (
    packaged_protocol,
)
from exceptiondrive_schemas.score_sheet import (
    Flag,
    PairedDifference,
    ProtocolRef,
    ReminderEffect,
)
from exceptiondrive_schemas.split import Manifest, SplitRef

PROTOCOL = packaged_protocol("1.0")
COUNTS = dict(zip([f.id for f in PROTOCOL.families], (62, 47, 59, 14, 22, 36), strict=True))
N = sum(COUNTS.values())
KEYS = ("hcc", "ur", "hpr", "cts", "cts_x", "cts_y")
MANIFEST = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="sample",
    title="Sample",
    revision="sha256:" + "3f9a" * 16,
    waypoints=6,
    time_step_s=0.5,
    sample_ids=tuple(f"s{index:04d}" for index in range(N)),
)
PIXEL = base64.b64encode(
    bytes.fromhex(
        "ffd8ffe000104a46494600010100000100010000ffdb004300080606070605080707070909080a0c140d0c0b0b0c"
        "1912130f141d1a1f1e1d1a1c1c20242e2720222c231c1c2837292c30313434341f27393d38323c2e333432ffc000"
        "0b080001000101011100ffc4001f0000010501010101010100000000000000000102030405060708090a0bffc400"
        "b5100002010303020403050504040000017d01020300041105122131410613516107227114328191a1082342b1c1"
        "1552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a63"
        "6465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6"
        "b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffda0008"
        "010100003f00fbfaffd9"
    )
)
"""A grey JPEG of one pixel."""
DATASHEET = Datasheet(
    schema_="exceptiondrive.datasheet/1",
    name="sample",
    title="Sample",
    revision=MANIFEST.revision,
    protocol="1.0",
    n_samples=N,
    n_scenes=60,
    n_controls=6,
    n_recorded=N,
    withdrawn=(WithdrawnSamples(reason="The hazard stands on the pavement.", n=2),),
    changes=SplitChange(
        previous="sha256:" + "1a" * 32,
        words="Two samples failed the audit, and three regions lay a metre too far.",
        moved=3,
        withdrawn=2,
    ),
    words=Words(
        purpose="To see whether planners heed what does not belong on the road.",
        source="Made-up scenes.",
        licence="CC BY-NC-SA 4.0",
        licence_url="https://creativecommons.org/licenses/by-nc-sa/4.0/",
        contact="the organizers",
        published="2026-11-22",
    ),
    stages=(
        Stage(id="suitable", title="The task suits the scene", n=3446, of=17850),
        Stage(id="edited", title="Edited in every view", n=3446, of=3446),
        Stage(id="accepted", title="Accepted by review and people", n=3181, of=3446),
        Stage(id="localized", title="Region proposed", n=0, of=3181),
        Stage(id="verified", title="Region verified by two people", n=0, of=0),
    ),
    families=tuple(
        Cell(id=f.id, title=f.title, candidates=850, suitable=200, accepted=180, n=COUNTS[f.id])
        for f in PROTOCOL.families
    ),
    tasks=tuple(
        Cell(id=t.id, title=t.title, candidates=850, suitable=20, accepted=18, n=12)
        for t in PROTOCOL.tasks
    ),
    audit=Audit(
        accepted=3181,
        drawn=168,
        waiting=2,
        passed=163,
        confidence=0.95,
        wilson=(0.9322, 0.9872),
        finite_population=(0.9333, 0.9869),
    ),
    agreement=Agreement(
        n=240,
        both_accepted=231,
        same_word=236,
        beyond=9,
        iou_mean=0.912,
        iou_median=0.934,
        corner_m_max=0.98,
        alpha=0.714,
    ),
    deciders=(
        Decider(
            stage="screen",
            by="vision-model",
            is_person=False,
            decisions=17850,
            prompt="sha256:" + "c4" * 32,
        ),
        Decider(stage="verify", by="person 1", is_person=True, decisions=240),
    ),
    warnings=(SplitWarning(code="unavoidable", what="no moving car avoids the region", count=4),),
    examples=(Example(caption="Lane Blockage", source=PIXEL, edited=PIXEL),) * 3,
    picture_licence="CC BY-NC 4.0",
)
"""What a workshop might have said of the small split; the shares of the funnel are the paper's."""
LONG_AGO = datetime(2020, 5, 4, 9, 30, tzinfo=UTC)
"""Before any board of a test, whatever the clock of the machine says."""
PAPER = {
    "ST-P3": (21.03, 78.11, 18.59, 1.57, 1.55, 0.24),
    "Impromptu VLA": (19.64, 78.92, 18.87, 2.20, 1.86, 0.70),
    "LightEMMA": (18.66, 79.51, 18.04, 1.68, 1.61, 0.23),
    "VAD": (13.89, 80.26, 13.47, 1.68, 1.47, 0.51),
    "AutoVLA": (10.37, 81.93, 11.26, 1.97, 1.67, 0.64),
    "OmniDrive": (9.52, 83.36, 9.84, 1.40, 1.34, 0.22),
    "DrivoR": (4.86, 92.13, 5.42, 1.25, 1.19, 0.22),
}
PAPER_FAMILIES = {
    "AutoVLA": (9.90, 12.86, 10.22, 9.78, 9.92, 9.56),
    "Impromptu VLA": (19.63, 20.28, 19.98, 20.14, 17.86, 19.95),
    "DrivoR": (4.31, 4.59, 2.61, 5.49, 3.94, 8.27),
    "ST-P3": (20.02, 19.86, 17.48, 22.92, 24.75, 21.17),
}
INVENTED = (
    ("Kestrel-2", "Halden Autonomy Lab", 61.40, 31.10, 52.71, 2.81, 2.44, 0.92, (1, 2), 3),
    ("LaneKeeper XL (bypass head, 3 s)", "Team Aurora", 58.92, 33.75, 49.02, 2.35, 1.71, 1.28,
     (1, 3), 1),
    ("brake-late", "Osprey", 57.31, 36.42, 47.90, 1.97, 1.95, 0.11, (2, 4), None),
    ("Møller–Ruiz world model", "U. Nørrebro", 49.05, 43.18, 41.33, 2.02, 1.66, 0.71, (3, 5), 4),
    ("VLA-7B zero-shot", "quiet.systems", 44.70, 47.96, 39.15, 1.12, 1.02, 0.30, (4, 6), 5),
    ("nerve", "Halden Autonomy Lab", 22.18, 74.90, 20.06, 0.04, 0.03, 0.02, (6, 6), 6),
)  # fmt: skip
SPREAD = (1.06, 0.91, 1.12, 0.74, 1.02, 1.15)
BLIND = Flag(
    code="blind_to_the_edit",
    label="Blind to the edit",
    detail="97% of the pairs differ by less than 0.05 m.",
)
STILL = Flag(
    code="stands_still",
    label="Stands still",
    detail="100% of the edited trajectories end within 0.5 m of the start.",
)

EFFECT = ReminderEffect(
    without="a0000001kq",
    without_method="Careful agent, no reminder",
    differences={
        "accuracy": PairedDifference(
            difference=0.1625, interval=(0.1, 0.23), discordant=0.4, verdict="with is better"
        ),
        "under_warning": PairedDifference(
            difference=-0.1525, interval=(-0.22, -0.09), discordant=0.4, verdict="with is better"
        ),
        "over_warning": PairedDifference(
            difference=-0.01, interval=(-0.05, 0.03), discordant=0.1, verdict="not separable"
        ),
    },
)


def values(row: tuple[float, ...]) -> dict[str, float | None]:
    scale = (100, 100, 100, 1, 1, 1)
    return {key: round(v / s, 6) for key, v, s in zip(KEYS, row, scale, strict=True)}


def counted_values(row: tuple[float, ...], progress: float | None) -> dict[str, float | None]:
    """Values as a scorer gives them that counts outcomes and progress."""
    hcc, ur = row[0] / 100, row[1] / 100
    clear, unmoved = round(hcc * 0.6, 4), round(ur * 0.3, 4)
    return {
        **values(row),
        "progress": progress,
        "clear": clear,
        "close": round(1 - ur - clear, 4),
        "hit_reacting": round(ur - unmoved, 4),
        "hit_unmoved": unmoved,
    }


def _interval(value: float, half: float) -> tuple[float, float]:
    return (round(max(0.0, value - half), 4), round(min(1.0, value + half), 4))


def _families(hcc: float, ur: float) -> dict[str, FamilyCell]:
    cells = {}
    for (family, n), spread in zip(COUNTS.items(), SPREAD, strict=True):
        value = round(min(hcc * spread, 1.0), 4)
        cells[family] = FamilyCell.model_validate(
            {
                "n": n,
                "hcc": value,
                "ur": round(min(ur, 1 - value), 4),
                "hpr": round(value * 0.9, 4),
                "intervals": {"hcc": _interval(value, 0.3 / n**0.5)},
            }
        )
    return cells


def scored(index: int, started: datetime) -> BoardEntry:
    method, team, hcc, ur, hpr, cts, cts_x, cts_y, interval, previous = INVENTED[index]
    metrics = counted_values((hcc, ur, hpr, cts, cts_x, cts_y), 0.62 + 0.05 * index)
    return BoardEntry(
        source="scored",
        rank=index + 1,
        rank_interval=interval,
        previous_rank=previous,
        submission_id=f"s{index:07d}kq",
        method=method,
        team=team,
        description="Invented for tests.",
        links=Links(paper="https://example.org/p", code="https://example.org/c" if index else None),
        submitted_at=started - timedelta(days=9 - index, hours=index),
        metrics=metrics,
        macro_family=metrics,
        micro=counted_values((hcc - 0.7, ur + 0.4, hpr - 0.5, cts, cts_x, cts_y), 0.6),
        intervals={
            "hcc": _interval(hcc / 100, 0.041 - 0.002 * index),
            "ur": _interval(ur / 100, 0.038),
            "hpr": _interval(hpr / 100, 0.03),
            "cts": (cts - 0.1, cts + 0.1),
            "progress": _interval(0.62 + 0.05 * index, 0.03),
        },
        families=_families(hcc / 100, ur / 100),
        coverage={"edited": 1.0, "source": 1.0},
        flags=(BLIND,) if method == "nerve" else (),
    )


def reference(
    method: str, row: tuple[float, ...], progress: float, flags: tuple[Flag, ...] = ()
) -> BoardEntry:
    metrics = counted_values(row, progress)
    return BoardEntry(
        source="reference",
        rank=None,
        rank_interval=None,
        submission_id=None,
        method=method,
        team="Reference",
        submitted_at=None,
        metrics=metrics,
        macro_family=metrics,
        micro=metrics,
        intervals={"hcc": _interval(metrics["hcc"] or 0, 0.03), "ur": None},
        families=_families(metrics["hcc"] or 0, metrics["ur"] or 0),
        flags=flags,
    )


def reported(method: str) -> BoardEntry:
    row = values(PAPER[method])
    families = {
        family: FamilyCell.model_validate({"n": None, "hcc": value / 100})
        for family, value in zip(COUNTS, PAPER_FAMILIES.get(method, ()), strict=False)
    }
    return BoardEntry(
        source="reported",
        rank=None,
        rank_interval=None,
        unranked_because="reported in the paper, not scored here",
        submission_id=None,
        method=method,
        team="",
        submitted_at=None,
        metrics=row,
        macro_family=row,
        micro={key: None for key in KEYS},
        intervals={},
        families=families,
        cite="exceptiondrive2026",
    )


def unscored(started: datetime) -> BoardEntry:
    nothing: dict[str, float | None] = {key: None for key in KEYS}
    return scored(5, started).model_copy(
        update={
            "rank": None,
            "rank_interval": None,
            "submission_id": "s0000009kq",
            "method": "half-a-file",
            "team": "Team Aurora",
            "unranked_because": "62.00% of the samples as edited are answered; a rank needs 99%",
            "coverage": {"edited": 0.62, "source": 1.0},
            "metrics": nothing,
            "macro_family": nothing,
            "micro": nothing,
            "intervals": {},
            "families": {},
            "flags": (),
        }
    )


def board_of(entries: tuple[BoardEntry, ...], number: int = 7) -> Board:
    return Board(
        challenge=PLANNING.id,
        phase="sample",
        split=SplitRef(name="sample", revision="sha256:" + "3f9a" * 16),
        protocol=ProtocolRef(version="1.0", digest=PROTOCOL.digest),
        headline="macro_family",
        board=number,
        published_at=datetime(2026, 11, 21, 2, 5, tzinfo=UTC),
        n_samples=N,
        confidence=0.95,
        families=tuple(
            FamilyHead(id=family.id, title=family.title, n=COUNTS[family.id])
            for family in PROTOCOL.families
        ),
        entries=entries,
    )


def lively_entries() -> tuple[BoardEntry, ...]:
    started = datetime(2026, 11, 20, 14, 0, tzinfo=UTC)
    return (
        *(scored(index, started) for index in range(len(INVENTED))),
        unscored(started),
        reference("FREEZE", (97.20, 0.0, 12.44, 3.61, 3.60, 0.02), 0.0, (STILL,)),
        reference("CONSTANT VELOCITY", (8.13, 90.02, 7.90, 0.0, 0.0, 0.0), 1.0, (BLIND,)),
        *(reported(method) for method in PAPER),
    )
