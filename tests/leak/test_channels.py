"""Every channel of a board alone and all of them together, held to the bound of docs/leakage.md."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.leak.channels import CHANNELS, Exact, Places, n_answers, published, tried

from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_worker.splits.store import LoadedSplit

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

DOCUMENT = Path(__file__).parents[2] / "docs" / "leakage.md"
CLEARANCES_M = np.concatenate([[0.0], np.linspace(0.005, 4.0, 400), np.linspace(4.5, 40.0, 30)])
SETTINGS = {
    "usual": {},
    "advised": {"min_samples_per_cell": 100},
    "whole per cents": {"min_samples_per_cell": 100, "percent_decimals": 0},
}


@pytest.fixture(scope="module")
def newest() -> ProtocolDocument:
    return packaged_protocol("1.1")


@pytest.fixture(scope="module")
def audited(sample_split: LoadedSplit, newest: ProtocolDocument) -> tuple["Oracle", int, Exact]:
    """The sample that weighs most in any draw of scenes: nobody is told more finely."""
    from tests.leak.oracle import Oracle

    oracle = Oracle(sample_split, newest)
    arrays = oracle.split.arrays
    weighs = [Places(oracle, sample).most_in_a_draw()[1] for sample in range(arrays.n_samples)]
    sample = int(np.argmax(weighs))
    return oracle, sample, tried(oracle, sample, CLEARANCES_M)


def under(oracle: "Oracle", changes: dict[str, int]) -> "Oracle":
    publication = oracle.protocol.publication.model_copy(update=changes)
    return replace(oracle, protocol=oracle.protocol.model_copy(update={"publication": publication}))


@pytest.fixture(scope="module")
def counted(audited: tuple["Oracle", int, Exact]) -> dict[str, dict[str, tuple[int, int]]]:
    """Setting to channel to the answers that were read, and how many there can be."""
    oracle, sample, exact = audited
    found = {}
    for setting, changes in SETTINGS.items():
        settled = under(oracle, changes)
        answers = published(exact, settled.protocol)
        places = Places(settled, sample)
        bounds = {key: 1 + n for key, n in places.of_channels().items()}
        bounds["together"] = places.together()
        assert answers.keys() == bounds.keys() == {*CHANNELS, "together"}
        found[setting] = {key: (n_answers(said), bounds[key]) for key, said in answers.items()}
    return found


def test_every_channel_and_all_together_stay_within_their_bound(
    counted: dict[str, dict[str, tuple[int, int]]],
) -> None:
    for setting, channels in counted.items():
        for channel, (n_read, bound) in channels.items():
            assert n_read <= bound, (setting, channel)
        alone = [n_read for key, (n_read, _) in channels.items() if key != "together"]
        assert channels["together"][0] >= max(alone), "together they tell more"


def test_intervals_rounded_like_their_metric_would_exceed_it(
    audited: tuple["Oracle", int, Exact], counted: dict[str, dict[str, tuple[int, int]]]
) -> None:
    """The attack: of public splits intervals keep all digits, and tell more than the means do."""
    oracle, _, exact = audited
    fine = published(exact, under(oracle, SETTINGS["advised"]).protocol, is_public=True)
    advised = counted["advised"]
    for channel in ("intervals", "discordant shares"):
        assert n_answers(fine[channel]) > advised[channel][1], channel
    assert n_answers(fine["pair intervals"]) > 5 * advised["pair intervals"][0]
    assert n_answers(fine["together"]) > 1.9 * advised["together"][0]
    said = (
        f"intervals would give {n_answers(fine['intervals'])} different answers, those of pairs "
        f"{n_answers(fine['pair intervals'])} and all together\n{n_answers(fine['together'])}:"
    )
    print(f"\n{said}")  # noqa: T201 - to be put into the document
    assert said in DOCUMENT.read_text("utf-8")


def table(counted: dict[str, dict[str, tuple[int, int]]]) -> str:
    """Return the table of docs/leakage.md."""

    def cell(n_read: int, bound: int) -> str:
        return f"{n_read} ({bound})" if bound > 1 else "1"

    def bits(n_read: int, bound: int) -> str:
        return f"{math.log2(n_read):.1f} ({math.log2(bound):.1f})"

    lines = [f"| channel | {' | '.join(SETTINGS)} |", "|---" * (1 + len(SETTINGS)) + "|"]
    for channel in counted["usual"]:
        cells = [cell(*counted[setting][channel]) for setting in SETTINGS]
        lines.append(f"| {channel} | {' | '.join(cells)} |")
    together = [bits(*counted[setting]["together"]) for setting in SETTINGS]
    lines.append(f"| bits of one sample and submission | {' | '.join(together)} |")
    return "\n".join(lines)


def test_the_document_says_what_the_audit_counts(
    counted: dict[str, dict[str, tuple[int, int]]],
) -> None:
    said = DOCUMENT.read_text("utf-8")
    found = table(counted)
    print(f"\n{found}")  # noqa: T201 - to be put into the document
    assert found in said
