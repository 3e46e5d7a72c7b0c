"""Freezing: same decisions, same bytes; revisions keep their samples; regions stay in."""

import gzip
import json
import random
import re
import shutil
import subprocess
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from tests.build.deciding import PEOPLE, decisions, record
from tests.build.shop import make_shop
from tests.support.documents import planning_file
from typer.testing import CliRunner, Result

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.cli import app
from exceptiondrive_build.freezing import commands
from exceptiondrive_build.freezing.croissant import croissant
from exceptiondrive_build.freezing.datasheet_text import markdown_of
from exceptiondrive_build.freezing.freeze import gzipped, pictures
from exceptiondrive_build.inspection import draw
from exceptiondrive_build.numbers import is_verified
from exceptiondrive_build.records import Kind, Record
from exceptiondrive_build.values import Corners, Edited, Inspected, Verified
from exceptiondrive_build.workshop import RECORDS, Workshop
from exceptiondrive_schemas.datasheet import Datasheet, Words
from exceptiondrive_schemas.protocol import NEWEST, PACKAGED_PROTOCOLS
from exceptiondrive_schemas.split import Split
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_worker.splits.store import load_split, read_split

Run = Callable[..., Result]
WITHHELD = {"split.json.gz", "provenance.jsonl"}


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workshop whose candidates, 21 tasks of two scenes, all wait for two readers."""
    folder = make_shop(tmp_path_factory.mktemp("made"), n_scenes=2, draw=10, width_px=160)
    settings = folder / "workshop.toml"
    text = settings.read_text().replace('licence = ""  ', 'licence = "CC0"  ', 1)
    settings.write_text(text.replace('purpose = ""', 'purpose = "To be tested."'))
    return folder


@pytest.fixture
def shop(read: Path, tmp_path: Path) -> Path:
    """The same with every region verified by two people but three, and five edits inspected."""
    folder = Path(shutil.copytree(read, tmp_path / "shop"))
    with Workshop(folder) as workshop:
        workshop.records.append(*decisions(workshop))
    return folder


def run(*command: str | Path) -> Result:
    return CliRunner().invoke(app, [str(part) for part in command])


def set_freeze(shop: Path, before: str, after: str) -> None:
    file = shop / "workshop.toml"
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after, 1))


def test_pictures_lie_beside_the_split_where_the_settings_and_a_licence_say_so(shop: Path) -> None:
    assert "pictures" not in frozen(shop, "without")
    set_freeze(shop, "pictures = false", "pictures = true")
    out = shop / "frozen" / "with"
    assert run("freeze", out, "--workshop", shop).exit_code == 0
    counted = {sample.sample_id for sample in read_split(out / "split.json.gz").counted}
    both = {f"{key}.{shows}.jpg" for key in counted for shows in ("source", "edited")}
    assert {path.name for path in (out / "pictures").iterdir()} == both
    key = min(counted)
    with (
        Image.open(out / "pictures" / f"{key}.source.jpg") as source,
        Image.open(out / "pictures" / f"{key}.edited.jpg") as edited,
    ):
        assert source.format == edited.format == "JPEG"
        assert source.size == edited.size
        assert source.tobytes() != edited.tobytes()


def test_without_a_licence_no_pictures_are_put_there(shop: Path) -> None:
    set_freeze(shop, "pictures = false", "pictures = true")
    set_freeze(shop, 'licence = "CC0"', 'licence = ""')
    result = run("freeze", shop / "frozen" / "none", "--workshop", shop)
    assert result.exit_code == 2
    assert "there is no licence to" in result.output
    assert not (shop / "frozen" / "none").exists()


def frozen(shop: Path, name: str, *options: str | Path) -> dict[str, bytes]:
    out = shop / "frozen" / name
    result = run("freeze", out, "--workshop", shop, *options)
    assert result.exit_code == 0, result.output
    return {path.name: path.read_bytes() for path in sorted(out.iterdir())}


def split_of(files: dict[str, bytes]) -> Split:
    return Split.model_validate_json(gzip.decompress(files["split.json.gz"]))


def test_what_is_accepted_and_verified_is_in_the_split(shop: Path) -> None:
    files = frozen(shop, "1")
    split = split_of(files)
    assert split.name == "made-2027"
    assert len(split.samples) == 42 - 3 - 1, "three were rejected by readers, one by inspection"
    assert all(sample.recorded is not None for sample in split.samples)
    with Workshop(shop) as workshop:
        load_split(split, workshop.protocol)
        known = walk(workshop)
        for sample in split.samples:
            assert sample.task == known[sample.sample_id].task.id
            assert sample.scene_id == known[sample.sample_id].keyframe.scene_id


def test_the_datasheet_counts_every_stage(shop: Path) -> None:
    sheet = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"])
    assert [(stage.id, stage.n, stage.of) for stage in sheet.stages] == [
        ("suitable", 42, 42),
        ("edited", 42, 42),
        ("accepted", 41, 42),
        ("localized", 41, 41),
        ("verified", 38, 41),
        ("frozen", 38, 38),
    ]
    assert sheet.n_samples == sum(cell.n for cell in sheet.families) == 38
    assert sheet.n_scenes == 2
    assert sheet.agreement is not None
    assert (sheet.agreement.n, sheet.agreement.beyond, sheet.agreement.alpha) == (42, 0, 1.0)
    assert sheet.audit is not None
    assert (sheet.audit.accepted, sheet.audit.drawn, sheet.audit.passed) == (42, 5, 4)
    by = {(each.stage, each.by): each.decisions for each in sheet.deciders}
    assert by["verify", "person 1"] == by["verify", "person 2"] == 42
    assert by["screen", "vision-model"] == 42
    assert "canary" not in sheet.model_dump_json()
    assert {found.code for found in sheet.warnings} >= {"few_scenes", "standing_still_suffices"}


def test_the_same_decisions_give_the_same_bytes(read: Path, tmp_path: Path) -> None:
    """In another order, at another time, in bits, with some taken back and taken again."""
    contents = []
    for seed in (1, 2):
        folder = Path(shutil.copytree(read, tmp_path / str(seed)))
        with Workshop(folder) as workshop:
            records = [read_otherwise(it, by=PEOPLE[1]) for it in decisions(workshop)]
            random.Random(seed).shuffle(records)
            for each in records:
                workshop.records.append(each)
            if seed == 2:
                (kept,) = workshop.records.append(
                    records[0].model_copy(update={"at": "2020-01-01"})
                )
                undo = kept.model_copy(update={"value": None, "supersedes": kept.id, "id": None})
                workshop.records.append(undo)
                scenes = folder / "scenes.jsonl"
                scenes.write_text("\n".join(reversed(scenes.read_text().splitlines())))
        contents.append(frozen(folder, "1", "--auxiliary"))
    assert contents[0] == contents[1]
    assert set(contents[0]) == WITHHELD | {
        ".gitignore",
        "manifest.json",
        "datasheet.json",
        "datasheet.md",
        "datasheet.html",
        "croissant.json",
        "made-2027-auxiliary.json.gz",
    }


def read_otherwise(decided: Record, by: str) -> Record:
    """The reading of one person moved by some centimetres, its list of corners begun elsewhere."""
    value = decided.value or {}
    if decided.by.person != by or not value.get("corners"):
        return decided
    first, *rest = ([x + 0.07, y + 0.03] for x, y in value["corners"])
    return decided.model_copy(update={"value": value | {"corners": [*rest, first]}})


def test_what_is_frozen_is_left_out_of_the_repository_that_it_stands_in(
    shop: Path, tmp_path: Path
) -> None:
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    assert run("freeze", tmp_path / "f27", "--workshop", shop).exit_code == 0
    (tmp_path / "report.svg").write_text("")
    status = ["git", "-C", str(tmp_path), "status", "--porcelain"]
    told = subprocess.run(status, capture_output=True, text=True, check=True)
    assert told.stdout == "?? report.svg\n"


def test_no_corner_leaves_but_in_the_split_file(shop: Path) -> None:
    """Corners are numbers that occur nowhere else, so each can be looked for in every byte."""
    canary = 13.271828
    with Workshop(shop) as workshop:
        candidate = next(it for it in walk(workshop).values() if it.is_accepted)
        corners: Corners = ((canary, -1.5), (canary, 1.5), (16.5, 1.5), (16.5, -1.5))
        workshop.records.append(
            *(
                record(
                    Kind.VERIFY,
                    candidate.sample_id,
                    person,
                    candidate.pictures,
                    Verified(accepted=True, corners=corners),
                )
                for person in PEOPLE
            )
        )
    settings = shop / "workshop.toml"
    named = f'examples = ["{candidate.sample_id}"]'
    settings.write_text(settings.read_text().replace("examples = []", named))
    files = frozen(shop, "1", "--auxiliary")
    assert str(canary) in gzip.decompress(files.pop("split.json.gz")).decode()
    regions = re.compile(rb'"region|"corners|13\.271828')
    for name, content in files.items():
        text = gzip.decompress(content) if name.endswith(".gz") else content
        if name == "made-2027-auxiliary.json.gz":
            assert str(canary).encode() not in text, "it is in the benchmark, not here"
        else:
            assert regions.search(text) is None, name
    published = b"".join(content for name, content in files.items() if name not in WITHHELD)
    assert b"ada-canary" not in published
    sheet = Datasheet.model_validate_json(files["datasheet.json"])
    (example,) = sheet.examples
    assert sheet.picture_licence == "CC0"
    assert b"<p>Licence of the pictures: CC0.</p>" in files["datasheet.html"]
    assert example.caption == "", "a picture of a sample does not tell its family"
    assert example.source[:2] == example.edited[:2] == b"\xff\xd8"
    manifest = json.loads(files["manifest.json"])
    assert set(manifest) == {
        "schema", "name", "title", "revision", "waypoints", "time_step_s", "sample_ids"
    }  # fmt: skip


def test_pictures_need_a_licence(shop: Path) -> None:
    settings = shop / "workshop.toml"
    with Workshop(shop) as workshop:
        sample_id = next(iter(walk(workshop)))
    text = settings.read_text().replace('licence = "CC0"', 'licence = ""')
    settings.write_text(text.replace("examples = []", f'examples = ["{sample_id}"]'))
    result = run("freeze", shop / "out", "--workshop", shop)
    assert (result.exit_code, "no licence" in result.output) == (2, True)
    assert not (shop / "out").exists()


def test_croissant_is_valid_and_reads_the_sample_ids(shop: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import mlcroissant  # type: ignore[import-untyped]  # it warns when imported

        frozen(shop, "1")
        dataset = mlcroissant.Dataset(jsonld=shop / "frozen" / "1" / "croissant.json")
        rows = [row["samples/sample_id"].decode() for row in dataset.records("samples")]
    split = read_split(shop / "frozen" / "1" / "split.json.gz")
    assert sorted(rows) == sorted(sample.sample_id for sample in split.samples)


def test_croissant_says_what_the_organizers_do_and_leaves_out_what_they_do_not(shop: Path) -> None:
    sheet = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"])

    def told(**words: str) -> dict[str, Any]:
        said = sheet.model_copy(update={"words": Words(**words)})
        document = json.loads(croissant(said, {"manifest.json": b"{}"}))
        return {key: document.get(key) for key in ("description", "license", "url")}

    title, url = sheet.title, "https://example.org/licence"
    assert told() == {"description": title, "license": None, "url": None}
    assert told(licence="CC0", url=url) == {"description": title, "license": "CC0", "url": url}
    assert told(purpose="To be tested.", licence="CC0", licence_url=url) == {
        "description": "To be tested.",
        "license": url,
        "url": None,
    }


def test_the_datasheet_in_words_has_a_line_of_each_family(shop: Path) -> None:
    sheet = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"])
    lines = markdown_of(sheet).splitlines()
    for family in sheet.families:
        counts = (family.candidates, family.suitable, family.accepted, family.n)
        told = " | ".join([family.id, family.title, *map(str, counts)])
        assert any(line.startswith(f"| {told} | ") for line in lines)


def test_a_person_is_numbered_once_however_spelled(shop: Path) -> None:
    with Workshop(shop) as workshop:
        candidate = next(it for it in walk(workshop).values() if not it.inspections)
        word = Inspected(passed=True)
        told = record(
            Kind.INSPECT, candidate.sample_id, PEOPLE[0].upper(), candidate.pictures, word
        )
        workshop.records.append(told)
    sheet = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"])
    by_people = [(it.stage, it.by, it.decisions) for it in sheet.deciders if it.is_person]
    assert by_people == [
        ("inspect", "person 1", 6),
        ("verify", "person 1", 42),
        ("verify", "person 2", 42),
    ]


# Revisions.


def withdraw(shop: Path, sample_ids: Sequence[str], *options: str) -> Result:
    return run(
        "withdraw", *sample_ids, "--workshop", shop, "--reason", "On the pavement.", "--by", "ada",
        *options,
    )  # fmt: skip


def test_people_are_numbered_anew_in_each_revision_and_are_said_to_be(shop: Path) -> None:
    """Ada, whose name comes first, has withdrawn a sample since."""
    previous = shop / "frozen" / "1" / "split.json.gz"
    first = frozen(shop, "1")
    withdraw(shop, [split_of(first).samples[0].sample_id])
    later = frozen(shop, "2", "--previous", previous, "--words", "One failed.")
    for files, by in ((first, {"person 1", "person 2"}), (later, {"person 2", "person 3"})):
        sheet = Datasheet.model_validate_json(files["datasheet.json"])
        assert {it.by for it in sheet.deciders if it.stage == "verify"} == by
        assert b"People are numbered anew in each revision." in files["datasheet.md"]


def test_a_later_revision_keeps_its_samples_and_says_what_changed(shop: Path) -> None:
    first = split_of(frozen(shop, "1"))
    ids = [sample.sample_id for sample in first.samples]
    assert withdraw(shop, ids[:2]).exit_code == 0
    with Workshop(shop) as workshop:
        moved = walk(workshop)[ids[5]]
        x, y = moved_by = (0.3, 0.2)
        corners = tuple((a + x, b + y) for a, b in first.samples[5].region)
        words = Verified.model_validate({"accepted": True, "corners": corners}, strict=False)
        workshop.records.append(
            *(record(Kind.VERIFY, ids[5], p, moved.pictures, words) for p in PEOPLE)
        )
        assert moved_by
    previous = shop / "frozen" / "1" / "split.json.gz"
    files = frozen(shop, "2", "--previous", previous, "--words", "Two failed the audit.")
    second, sheet = split_of(files), Datasheet.model_validate_json(files["datasheet.json"])
    assert [sample.sample_id for sample in second.samples] == ids
    assert [sample.sample_id for sample in second.samples if sample.withdrawn] == ids[:2]
    assert second.samples[0].withdrawn == "On the pavement."
    assert second.revision != first.revision
    assert sheet.changes is not None
    assert sheet.changes.model_dump() == {
        "previous": first.revision,
        "words": "Two failed the audit.",
        "moved": 1,
        "withdrawn": 2,
        "restored": 0,
        "drives": 0,
        "marks": 0,
    }
    assert (sheet.n_samples, sheet.n_withdrawn, sheet.n_recorded) == (36, 2, 36)
    counts = "the region of 1 sample changes; 2 samples withdrawn: files still answer, none counts."
    assert counts in files["datasheet.md"].decode()
    assert sheet.withdrawn[0].reason == "On the pavement."
    for name in ("datasheet.md", "datasheet.html"):
        assert "Two failed the audit." in files[name].decode()


def test_a_revision_keeps_what_only_the_file_of_the_one_before_says(shop: Path) -> None:
    """Parts, clearances and drives that somebody put into it; a part that is lost would be scored."""
    scenes = shop / "scenes.jsonl"
    first, *rest = [json.loads(line) for line in scenes.read_text().splitlines()]
    bare = {key: value for key, value in first.items() if key != "recorded"}
    scenes.write_text("\n".join(map(json.dumps, [bare, *rest])))
    split = split_of(frozen(shop, "1"))
    drive = tuple((2.0 * step, 0.0) for step in range(1, 7))
    own = {"d_safe_m": 0.5, "acceptable": (Strategy.C, Strategy.D)}
    parted = split.model_copy(
        update={
            "samples": tuple(
                it.model_copy(
                    update=own
                    | {"part": "public" if n % 3 else "private", "recorded": it.recorded or drive}
                )
                for n, it in enumerate(split.samples)
            )
        }
    )
    assert drive in {it.recorded for it in parted.samples}
    previous = shop / "parted.json.gz"
    previous.write_bytes(gzipped(parted))
    withdraw(shop, [parted.samples[0].sample_id])
    later = split_of(frozen(shop, "2", "--previous", previous, "--words", "One failed."))
    gone = later.samples[0].model_copy(update={"withdrawn": None})
    assert (gone, *later.samples[1:]) == parted.samples


def test_drives_and_control_marks_that_change_are_told(shop: Path) -> None:
    first = split_of(frozen(shop, "1"))
    previous = shop / "frozen" / "1" / "split.json.gz"
    set_freeze(shop, "controls = []", f'controls = ["{first.samples[0].sample_id}"]')
    set_freeze(shop, "recorded_is_public = false", "recorded_is_public = true")
    command = ("freeze", shop / "frozen" / "2", "-w", shop, "--previous", previous)
    told = run(*command, "--words", "Marked.").output
    n = len(first.samples)
    assert f"warning drives_become_public ({n}): the previous revision withholds" in told
    set_freeze(shop, "recorded = true", "recorded = false")
    files = frozen(shop, "3", "--previous", previous, "--words", "Marked.")
    assert (
        "; ".join(
            (f"the recorded drive of {n} samples changed", "the control mark of 1 sample changed")
        )
        in files["datasheet.md"].decode()
    )
    again = ("freeze", shop / "frozen" / "4", "-w", shop, "--previous")
    later = run(*again, shop / "frozen" / "2" / "split.json.gz", "--words", "Nothing.").output
    assert "drives_become_public" not in later


@pytest.mark.parametrize("file", ["tasks.toml", "workshop.toml"])
def test_samples_decided_under_other_words_or_by_another_model_keep_their_place(
    shop: Path, file: str
) -> None:
    """A typo in the words of tasks is mended: nothing is wrong with their samples."""
    frozen(shop, "1")
    path = shop / file
    before = path.read_text()
    old, new = {
        "tasks.toml": ('suitable = "', 'suitable = "here '),
        "workshop.toml": ('model = "vision-model"', 'model = "other-model"'),
    }[file]
    assert old in before
    path.write_text(before.replace(old, new))
    previous = shop / "frozen" / "1" / "split.json.gz"
    command = ("freeze", shop / "2", "-w", shop, "--previous", previous, "--words", "Nothing.")
    told = run(*command)
    assert told.exit_code == 2
    assert "that were decided with other words, models or settings" in told.output
    assert "Put back what workshop.toml, tasks.toml and prompts/ said" in told.output
    assert "withdraw" not in told.output.lower()
    path.write_text(before)
    assert run(*command).exit_code == 0


def test_regions_that_lie_wrong_are_verified_again_by_command(shop: Path) -> None:
    first = split_of(frozen(shop, "1"))
    ids = [sample.sample_id for sample in first.samples]
    command = ("reopen", ids[3], ids[5], ids[5], "--workshop", shop, "--by", "ada")
    refused = run(*command, "nobody")
    assert (refused.exit_code, "(1): nobody." in refused.stderr) == (2, True)
    result = run(*command)
    assert (result.exit_code, result.output.split(";")[0]) == (0, "reopened: 2")
    assert run(*command).exit_code == 2, "nobody has read them since"
    previous = shop / "frozen" / "1" / "split.json.gz"
    options = ("--workshop", shop, "--previous", previous, "--words", "Two lay wrong.")
    told = run("freeze", shop / "frozen" / "2", *options)
    assert told.exit_code == 2
    assert f"(2): {ids[3]}, {ids[5]}." in told.stderr
    assert "Have them inspected and verified: exceptiondrive-build review; or with" in told.stderr
    with Workshop(shop) as workshop:
        known = walk(workshop)
        assert known[ids[3]].verifications == known[ids[5]].verifications == ()
        for place, key in enumerate((ids[3], ids[5])):
            region = tuple((x + 0.5, y + 0.1 * place) for x, y in first.samples[0].region)
            word = Verified.model_validate({"accepted": True, "corners": region}, strict=False)
            workshop.records.append(
                *(record(Kind.VERIFY, key, p, known[key].pictures, word) for p in PEOPLE)
            )
    assert run("freeze", shop / "frozen" / "2", *options).exit_code == 0
    moved = zip(first.samples, read_split(shop / "frozen/2/split.json.gz").samples, strict=True)
    assert [a.sample_id for a, b in moved if a.region != b.region] == [ids[3], ids[5]]


def test_a_previous_revision_that_is_not_as_it_was_frozen_is_refused(shop: Path) -> None:
    first = split_of(frozen(shop, "1"))
    sample, *rest = first.samples
    other_task = sample.model_copy(update={"task": "XX"})
    for samples in ((*first.samples, sample), (other_task, *rest)):
        edited = shop / "edited.json.gz"
        edited.write_bytes(gzipped(first.model_copy(update={"samples": samples})))
        out = shop / "frozen" / "2"
        result = run("freeze", out, "-w", shop, "--previous", edited, "--words", "Nothing.")
        assert result.exit_code == 2
        assert f"twice, or with another task (1): {sample.sample_id}." in result.stderr
        assert not out.exists()
    half = (sample.model_copy(update={"part": "public"}), *rest)
    edited.write_bytes(gzipped(first.model_copy(update={"samples": half})))
    result = run("freeze", out, "-w", shop, "--previous", edited, "--words", "Nothing.")
    assert "samples of no part, though others have one" in result.stderr
    assert "Verify these regions" not in result.stderr, "it is no fault of regions"


def test_a_tag_in_a_makers_words_is_read_as_text(shop: Path) -> None:
    previous = shop / "frozen" / "1" / "split.json.gz"
    withdraw(shop, [split_of(frozen(shop, "1")).samples[0].sample_id])
    files = frozen(shop, "2", "--previous", previous, "--words", "<script>1 < 2 & 3</script>")
    for name in ("datasheet.md", "datasheet.html"):
        text = files[name].decode()
        assert "&lt;script&gt;1 &lt; 2 &amp; 3&lt;/script&gt;" in text, name


def test_restored_samples_count_again(shop: Path) -> None:
    first = split_of(frozen(shop, "1"))
    ids = [sample.sample_id for sample in first.samples]
    withdraw(shop, ids[:2])
    assert withdraw(shop, ids[:1], "--restore").exit_code == 0
    previous = shop / "frozen" / "1" / "split.json.gz"
    second = split_of(frozen(shop, "2", "--previous", previous, "--words", "One failed."))
    assert [sample.sample_id for sample in second.samples if sample.withdrawn] == ids[1:2]
    assert withdraw(shop, ids[:1], "--restore").exit_code == 2, "it is not withdrawn"
    without = run("withdraw", ids[2], "--workshop", shop, "--by", "ada")
    assert (without.exit_code, "Give a reason" in without.output) == (2, True)
    assert run("withdraw", ids[1], "--workshop", shop, "--by", "ada", "--restore").exit_code == 0
    assert withdraw(shop, ["nobody"]).exit_code == 2


def test_a_revision_tells_how_many_withdrawn_samples_count_again(shop: Path) -> None:
    ids = [sample.sample_id for sample in split_of(frozen(shop, "1")).samples]
    withdraw(shop, ids[:2])
    first, second = (shop / "frozen" / name / "split.json.gz" for name in ("1", "2"))
    frozen(shop, "2", "--previous", first, "--words", "Two failed.")
    withdraw(shop, ids[:1], "--restore")
    files = frozen(shop, "3", "--previous", second, "--words", "One failed by mistake.")
    changes = Datasheet.model_validate_json(files["datasheet.json"]).changes
    assert changes is not None
    assert (changes.moved, changes.withdrawn, changes.restored) == (0, 0, 1)
    assert changes.counts == ("1 sample restored: counted again",)
    assert (
        f"Since revision {changes.previous}: {changes.counts[0]}." in files["datasheet.md"].decode()
    )


def test_a_revision_in_which_one_sample_of_a_family_changes_alone_is_warned_of(shop: Path) -> None:
    """On a withheld split the two boards tell its value (docs/leakage.md)."""
    samples = split_of(frozen(shop, "1")).samples
    families = defaultdict(list)
    with Workshop(shop) as workshop:
        taxonomy = workshop.protocol.taxonomy
    for sample in samples:
        families[taxonomy.task(sample.task).family].append(sample.sample_id)
    (first, alone), (second, together) = list(families.items())[:2]
    titles = {family.id: family.title for family in taxonomy.families}
    withdraw(shop, [alone[0], *together[:2]])
    to_1 = (
        "--workshop",
        shop,
        "--previous",
        shop / "frozen" / "1" / "split.json.gz",
        "--words",
        "x",
    )
    told = run("freeze", shop / "frozen" / "2", *to_1).output
    assert f"warning changed_alone (1): one sample alone changes in {titles[first]}; on a" in told
    withdraw(shop, alone[1:2])
    assert "changed_alone" not in run("freeze", shop / "frozen" / "3", *to_1).output
    withdraw(shop, together[:1], "--restore")
    to_3 = (*to_1[:3], shop / "frozen" / "3" / "split.json.gz", *to_1[4:])
    told = run("freeze", shop / "frozen" / "4", *to_3).output
    assert f"one sample alone changes in {titles[second]}; on a" in told


def test_a_sample_that_changes_alone_in_its_part_is_warned_of(shop: Path) -> None:
    """A board counts the part: of two that change it tells the one that is of it."""
    samples = split_of(frozen(shop, "1")).samples
    with Workshop(shop) as workshop:
        taxonomy = workshop.protocol.taxonomy
    family = taxonomy.task(samples[0].task).family
    ids = [it.sample_id for it in samples if taxonomy.task(it.task).family == family][:4]
    set_freeze(shop, "public_part = []", f"public_part = {json.dumps(ids[:2])}")
    frozen(shop, "2")
    to_2 = ("-w", shop, "--previous", shop / "frozen" / "2" / "split.json.gz", "--words", "x")
    withdraw(shop, ids[1:3])
    (title,) = (it.title for it in taxonomy.families if it.id == family)
    assert (
        "warning changed_alone (2): one sample alone changes in "
        f"{title} (public part), {title} (private part); on a"
    ) in run("freeze", shop / "frozen" / "3", *to_2).output
    withdraw(shop, [ids[3]])
    told = run("freeze", shop / "frozen" / "4", *to_2).output
    assert f"warning changed_alone (1): one sample alone changes in {title} (public part);" in told


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--reason", "", "Give a reason of at most 500 characters."),
        ("--reason", " \n", "Give a reason"),
        ("--reason", "x" * 501, "Give a reason"),
        ("--by", "", "Give a name of at most 64 characters."),
        ("--by", " ", "Give a name"),
        ("--by", "x" * 65, "Give a name"),
    ],
)
def test_a_withdrawal_has_a_reason_and_a_name(
    shop: Path, option: str, value: str, said: str
) -> None:
    (sample, *_) = split_of(frozen(shop, "1")).samples
    result = withdraw(shop, [sample.sample_id], option, value)
    assert (result.exit_code, said in result.output) == (2, True)
    with Workshop(shop) as workshop:
        assert workshop.current(Kind.WITHDRAW) == {}


def test_a_sample_may_not_go_missing_from_a_revision(shop: Path) -> None:
    """Rejected since, and not withdrawn: files of teams answer it, so somebody has to say so."""
    first = split_of(frozen(shop, "1"))
    sample_id = first.samples[3].sample_id
    with Workshop(shop) as workshop:
        pictures = walk(workshop)[sample_id].pictures
        workshop.records.append(
            record(Kind.INSPECT, sample_id, "ada", pictures, Inspected(passed=False))
        )
    previous = shop / "frozen" / "1" / "split.json.gz"
    command = ("freeze", shop / "frozen" / "2", "--workshop", shop, "--previous", previous)
    result = run(*command, "--words", "One failed.")
    assert result.exit_code == 2
    assert f"not accepted and verified any more (1): {sample_id}" in result.output
    assert "exceptiondrive-build withdraw" in result.output
    withdraw(shop, [sample_id])
    assert "says in words" in run(*command).output
    assert run(*command, "--words", "One failed.").exit_code == 0


def test_samples_whose_scenes_are_gone_are_named_with_their_cure(shop: Path) -> None:
    """`withdraw` does not know them: only their scenes bring them back."""
    frozen(shop, "1")
    scenes = shop / "scenes.jsonl"
    scenes.write_text(scenes.read_text().split("\n")[0])
    previous = shop / "frozen" / "1" / "split.json.gz"
    command = ("freeze", shop / "frozen" / "2", "--workshop", shop, "--previous", previous)
    result = run(*command, "--words", "One scene is gone.")
    assert result.exit_code == 2
    assert "whose scene or task is not in the workshop any more" in result.output
    assert "exceptiondrive-build scenes read SOURCE" in result.output


def test_a_region_whose_list_begins_elsewhere_in_the_file_before_has_not_changed(
    shop: Path,
) -> None:
    first = split_of(frozen(shop, "1"))
    previous = shop / "frozen" / "1" / "split.json.gz"
    turned = (
        it.model_copy(update={"region": (*it.region[1:], it.region[0])}) for it in first.samples
    )
    before = first.model_copy(update={"samples": tuple(turned)})
    previous.write_bytes(gzipped(before))
    later = frozen(shop, "2", "--previous", previous, "--words", "Nothing.")
    assert split_of(later) == before


def test_what_was_accepted_since_waits_for_the_next_split(read: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(read, tmp_path / "shop"))
    with Workshop(folder) as workshop:
        records = decisions(workshop)
        workshop.records.append(*records[:40])
    first = split_of(frozen(folder, "1"))
    with Workshop(folder) as workshop:
        workshop.records.append(*records[40:])
    previous = folder / "frozen" / "1" / "split.json.gz"
    second = split_of(frozen(folder, "2", "--previous", previous, "--words", "Nothing."))
    assert [it.sample_id for it in second.samples] == [it.sample_id for it in first.samples]
    assert len(split_of(frozen(folder, "whole")).samples) > len(second.samples)
    again = run("freeze", folder / "3", "-w", folder, "--previous", previous, "--words", "Nothing.")
    assert "warning nothing_changed: the split is the previous revision itself" in again.output
    assert withdraw(folder, [first.samples[0].sample_id]).exit_code == 0
    other = run(
        "freeze", folder / "4", "-w", folder, "--previous", previous, "--words", "One less."
    )
    assert "nothing_changed" not in other.output


def test_a_revision_counts_no_candidate_of_the_next_split(shop: Path) -> None:
    """A scene is read in for the next split: the datasheet of this one tells how this one was made."""
    scenes = shop / "scenes.jsonl"
    both = scenes.read_text()
    scenes.write_text(both.split("\n")[0])
    first = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"])
    assert first.stages[0].of == 21
    scenes.write_text(both)
    folder = shop / "frozen" / "1"
    withdraw(shop, [read_split(folder / "split.json.gz").samples[0].sample_id])
    told = ("--previous", folder / "split.json.gz", "--words", "One failed.")
    later = Datasheet.model_validate_json(frozen(shop, "2", *told)["datasheet.json"])
    how = {"audit", "agreement", "deciders"}
    assert later.model_dump(include=how) == first.model_dump(include=how)
    assert later.stages[:-1] == first.stages[:-1]
    assert later.stages[-1].n == later.n_samples == first.n_samples - 1
    for before, after in ((first.families, later.families), (first.tasks, later.tasks)):
        assert [it.candidates for it in after] == [it.candidates for it in before]
        assert sum(it.n for it in after) == later.n_samples
    (folder / "datasheet.json").unlink()
    result = run("freeze", shop / "frozen" / "3", "-w", shop, *told)
    assert "warning no_datasheet_before: " in result.output
    without = Datasheet.model_validate_json((shop / "frozen" / "3" / "datasheet.json").read_bytes())
    assert without.stages[0].of == 42


def test_a_region_verified_since_is_of_the_next_split_and_counted_in_its_datasheet_alone(
    shop: Path,
) -> None:
    """One region waited for its second reader when the split was frozen."""
    with Workshop(shop) as workshop:
        limits = workshop.settings.verify
        late = next(
            it for it in walk(workshop).values() if is_verified(it, limits) and it.is_accepted
        )
        reading = late.verifications[-1]
        workshop.records.append(
            reading.model_copy(update={"value": None, "supersedes": reading.id})
        )
    first = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"])
    previous = shop / "frozen" / "1" / "split.json.gz"
    with Workshop(shop) as workshop:
        workshop.records.append(reading)
    withdraw(shop, [read_split(previous).samples[0].sample_id])
    told = ("--previous", previous, "--words", "One failed.")
    later = Datasheet.model_validate_json(frozen(shop, "2", *told)["datasheet.json"])
    assert (later.stages[:-1], later.agreement) == (first.stages[:-1], first.agreement)
    assert later.stages[-1].n == later.n_samples == first.n_samples - 1


def test_an_audit_of_mid_season_is_told_by_the_next_revision(shop: Path) -> None:
    before = Datasheet.model_validate_json(frozen(shop, "1")["datasheet.json"]).audit
    assert before is not None
    assert (before.drawn, before.waiting) == (5, 5)
    with Workshop(shop) as workshop:
        candidates = walk(workshop)
        drawn = draw(candidates, workshop.settings.inspect)
        left = next(candidates[key] for key in drawn if candidates[key].inspected is None)
        word = Inspected(passed=True)
        workshop.records.append(record(Kind.INSPECT, left.sample_id, "ada", left.pictures, word))
    previous = shop / "frozen" / "1" / "split.json.gz"
    files = frozen(shop, "2", "--previous", previous, "--words", "One more was looked at.")
    after = Datasheet.model_validate_json(files["datasheet.json"]).audit
    assert after is not None
    assert (after.drawn, after.waiting) == (6, 4)
    assert "4 more were drawn, and wait to be looked at." in files["datasheet.md"].decode()


def test_controls_are_marked_and_counted_apart(shop: Path) -> None:
    ids = [sample.sample_id for sample in split_of(frozen(shop, "1")).samples]
    settings = shop / "workshop.toml"
    text = settings.read_text()
    settings.write_text(text.replace("controls = []", f'controls = ["{ids[0]}"]'))
    files = frozen(shop, "2")
    assert [it.sample_id for it in split_of(files).controls] == ids[:1]
    sheet = Datasheet.model_validate_json(files["datasheet.json"])
    assert (sheet.n_samples, sheet.n_controls) == (37, 1)
    settings.write_text(text.replace("controls = []", 'controls = ["nobody"]'))
    result = run("freeze", shop / "frozen" / "3", "--workshop", shop)
    assert (
        result.exit_code,
        "Controls in workshop.toml that are not verified (1): nobody" in result.output,
    ) == (2, True)


def test_samples_are_parted_as_the_settings_say_and_stay_so(shop: Path) -> None:
    ids = [sample.sample_id for sample in split_of(frozen(shop, "1")).samples]
    set_freeze(shop, "public_part = []", f"public_part = {json.dumps(ids[:10])}")
    first = split_of(frozen(shop, "2"))
    assert [it.sample_id for it in first.samples if it.part == "public"] == ids[:10]
    assert {it.part for it in first.samples} == {"public", "private"}
    set_freeze(shop, f'public_part = ["{ids[0]}"', f'public_part = ["{ids[20]}"')
    withdraw(shop, ids[:1])
    previous = shop / "frozen" / "2" / "split.json.gz"
    to_2 = ("--previous", previous, "--words", "One failed.")
    later = split_of(frozen(shop, "3", *to_2))
    assert [it.part for it in later.samples] == [it.part for it in first.samples]
    redrawn = run("freeze", shop / "frozen" / "6", "-w", shop, *to_2).output
    assert "warning parts_stay (2): samples of another part than `public_part` says" in redrawn
    assert "parts_stay" not in run("freeze", shop / "frozen" / "7", "-w", shop).output
    assert run("freeze", shop / "frozen" / "4", "-w", shop, "--auxiliary").exit_code == 0
    set_freeze(shop, f'public_part = ["{ids[20]}"', 'public_part = ["nobody"')
    told = run("freeze", shop / "frozen" / "5", "-w", shop)
    assert "Public samples in workshop.toml that are not verified (1): nobody" in told.output


def test_a_control_that_is_withdrawn_keeps_nothing_from_being_frozen(shop: Path) -> None:
    ids = [sample.sample_id for sample in split_of(frozen(shop, "1")).samples]
    set_freeze(shop, "controls = []", f'controls = ["{ids[0]}"]')
    previous = shop / "frozen" / "2" / "split.json.gz"
    frozen(shop, "2")
    assert withdraw(shop, ids[:1]).exit_code == 0
    assert run("lint", "--workshop", shop).exit_code == 0
    assert ids[0] not in [it.sample_id for it in split_of(frozen(shop, "whole")).samples]
    later = split_of(frozen(shop, "3", "--previous", previous, "--words", "One is withdrawn."))
    assert [it.sample_id for it in later.samples if it.withdrawn] == ids[:1]


# What goes wrong.


def test_a_frozen_folder_is_never_written_over(shop: Path) -> None:
    frozen(shop, "1")
    result = run("freeze", shop / "frozen" / "1", "--workshop", shop)
    assert (result.exit_code, "never written over" in result.output) == (2, True)


def test_what_a_broken_freeze_left_is_not_in_the_next(shop: Path) -> None:
    """A process was killed: its half folder lies there, with a picture of what is withdrawn since."""
    set_freeze(shop, "pictures = false", "pictures = true")
    pictures = shop / "frozen" / "1.part" / "pictures"
    pictures.mkdir(parents=True)
    (pictures / "withdrawn.source.jpg").write_bytes(b"left")
    (pictures.parent / "split.json").write_bytes(b"left")
    assert run("freeze", shop / "frozen" / "1", "--workshop", shop).exit_code == 0
    files = [path for path in (shop / "frozen" / "1").rglob("*") if path.is_file()]
    assert b"left" not in [path.read_bytes() for path in files]


def test_of_two_freezes_into_one_folder_one_is_whole_and_the_other_refused(
    shop: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second begins and ends while the first has written some of its files."""
    set_freeze(shop, "pictures = false", "pictures = true")
    out, second = shop / "frozen" / "1", list[Result]()

    def meanwhile(*of: Any) -> Iterator[tuple[str, bytes]]:
        first_picture, *rest = pictures(*of)
        yield first_picture
        with monkeypatch.context() as usual:
            usual.setattr(commands, "pictures", pictures)
            second.append(run("freeze", out, "--workshop", shop))
        yield from rest

    monkeypatch.setattr(commands, "pictures", meanwhile)
    first = run("freeze", out, "--workshop", shop)
    assert [first.exit_code, second[0].exit_code] == [2, 0]
    assert f"{out}: Directory not empty" in first.output
    assert list((shop / "frozen").iterdir()) == [out]
    monkeypatch.undo()
    alone = shop / "frozen" / "alone"
    assert run("freeze", alone, "--workshop", shop).exit_code == 0
    assert files_in(out) == files_in(alone)


def files_in(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_a_freeze_that_breaks_off_leaves_nothing(shop: Path) -> None:
    set_freeze(shop, "pictures = false", "pictures = true")
    with Workshop(shop) as workshop:
        accepted = [it for it in walk(workshop).values() if it.is_accepted]
        edited = accepted[-1].edited
        assert isinstance(edited, Edited)
        for name in edited.images.values():
            workshop.image_path(name).unlink()
    result = run("freeze", shop / "frozen" / "1", "--workshop", shop)
    assert result.exit_code == 2
    assert "Put it back from a copy of the workshop." in result.output
    assert list((shop / "frozen").iterdir()) == []


def test_accepted_edits_whose_region_is_not_decided_are_counted(shop: Path) -> None:
    """One reading is taken back, and of another region its readers differ: both wait for a reader."""
    whole = run("freeze", shop / "frozen" / "whole", "--workshop", shop)
    assert "region_not_decided" not in whole.output
    with Workshop(shop) as workshop:
        limits = workshop.settings.verify
        one, other, *_ = (it for it in walk(workshop).values() if is_verified(it, limits))
        reading = one.verifications[-1]
        workshop.records.append(
            reading.model_copy(update={"value": None, "supersedes": reading.id})
        )
        no = Verified(accepted=False)
        workshop.records.append(record(Kind.VERIFY, other.sample_id, PEOPLE[1], other.pictures, no))
    told = run("freeze", shop / "frozen" / "part", "--workshop", shop)
    assert "warning region_not_decided (2): accepted edits whose region waits" in told.output
    sheet = (shop / "frozen" / "part" / "datasheet.md").read_text()
    assert "1 time so far apart that a third reader decides." in sheet


def test_samples_that_nobody_has_inspected_are_counted(shop: Path) -> None:
    """Of the random draw, five were looked at; one more is, and one that was not is withdrawn."""
    told = run("freeze", shop / "frozen" / "1", "--workshop", shop)
    with Workshop(shop) as workshop:
        candidates, settings = walk(workshop), workshop.settings
        left = [
            it
            for it in map(candidates.get, draw(candidates, settings.inspect))
            if it is not None and it.inspected is None and is_verified(it, settings.verify)
        ]
        assert f"warning not_inspected ({len(left)}): samples with a low mark" in told.output
        word = Inspected(passed=True)
        workshop.records.append(
            record(Kind.INSPECT, left[0].sample_id, "ada", left[0].pictures, word)
        )
    withdraw(shop, [left[1].sample_id])
    told = run("freeze", shop / "frozen" / "2", "--workshop", shop)
    assert f"warning not_inspected ({len(left) - 2})" in told.output


@pytest.mark.parametrize("withdrawn_ones", ["still accepted", "refused since"])
def test_what_is_in_the_split_is_counted_without_what_is_withdrawn(
    shop: Path, withdrawn_ones: str
) -> None:
    ids = [it.sample_id for it in split_of(frozen(shop, "1")).samples]
    if withdrawn_ones == "refused since":
        with Workshop(shop) as workshop:
            pictures = walk(workshop)[ids[0]].pictures
            no = Inspected(passed=False)
            workshop.records.append(record(Kind.INSPECT, ids[0], "ada", pictures, no))
    withdraw(shop, ids[:2])
    previous = shop / "frozen" / "1" / "split.json.gz"
    files = frozen(shop, "2", "--previous", previous, "--words", "Two failed the audit.")
    sheet = Datasheet.model_validate_json(files["datasheet.json"])
    assert (sheet.stages[-1].id, sheet.stages[-1].n) == ("frozen", sheet.n_samples)
    assert sheet.n_samples == len(ids) - 2


def test_nothing_verified_is_said_so(read: Path, tmp_path: Path) -> None:
    result = run("freeze", tmp_path / "out", "--workshop", read)
    assert (result.exit_code, "Nothing is accepted and verified yet" in result.output) == (2, True)
    assert not (tmp_path / "out").exists()


def test_a_region_that_cannot_be_scored_is_named(shop: Path) -> None:
    with Workshop(shop) as workshop:
        candidate = next(it for it in walk(workshop).values() if it.is_accepted)
        over: Corners = ((0.0, -1.0), (4.0, -1.0), (4.0, 1.0), (0.0, 1.0))
        words = Verified(accepted=True, corners=over)
        workshop.records.append(
            *(
                record(Kind.VERIFY, candidate.sample_id, person, candidate.pictures, words)
                for person in PEOPLE
            )
        )
    result = run("freeze", shop / "out", "--workshop", shop)
    assert result.exit_code == 2
    assert f"touch the footprint at t = 0 (1): {candidate.sample_id}" in result.output


def test_the_workshop_is_linted_and_so_is_a_file(shop: Path) -> None:
    files = frozen(shop, "1")
    report = json.loads(run("lint", "--workshop", shop, "--json").output)
    assert report["n_samples"] == len(split_of(files).samples)
    path = shop / "frozen" / "1" / "split.json.gz"
    of_file = json.loads(run("lint", "--workshop", shop, "--file", path, "--json").output)
    assert of_file == report
    assert RECORDS in {each.name for each in shop.iterdir()}


def test_a_file_is_linted_without_a_workshop_unless_one_is_named(
    shop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frozen(shop, "1")
    path = shop / "frozen" / "1" / "split.json.gz"
    in_shop = run("lint", "--workshop", shop, "--file", path, "--json").output
    monkeypatch.chdir(tmp_path)
    assert run("lint", "--file", path, "--json").output == in_shop
    absent = run("lint", "--file", path.with_name("none.json.gz"))
    assert f"{path.parent}/none.json.gz: none.json.gz cannot be read" in absent.output
    refused = run("lint", "--workshop", tmp_path / "none", "--file", path)
    assert (refused.exit_code, "no workshop" in refused.output) == (2, True)


def test_a_file_of_another_protocol_is_linted_by_that(
    shop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    split = split_of(frozen(shop, "1"))
    samples = tuple(it.model_copy(update={"task": f"own_{it.task}"}) for it in split.samples)
    path, own = tmp_path / "split.json", tmp_path / "own.toml"
    path.write_text(split.model_copy(update={"samples": samples}).model_dump_json(by_alias=True))
    text = (PACKAGED_PROTOCOLS / f"{NEWEST}.toml").read_text()
    own.write_text(text.replace('[[tasks]]\nid = "', '[[tasks]]\nid = "own_'))
    monkeypatch.chdir(tmp_path)
    assert run("lint", "--file", path).exit_code == 2
    for folder in ((), ("--workshop", shop)):
        told = run("lint", "--file", path, "--protocol", own, *folder)
        assert (told.exit_code, f"{len(samples)} samples" in told.output) == (0, True), told.output
    own.write_text("[")
    assert f"{own}: " in run("lint", "--file", path, "--protocol", own).output
    assert run("lint", "--workshop", shop, "--protocol", own).exit_code == 2


def test_a_file_that_cannot_be_scored_is_refused(shop: Path) -> None:
    split = split_of(frozen(shop, "1"))
    crossed = ((10.0, -1.0), (12.0, 1.0), (12.0, -1.0), (10.0, 1.0))
    broken = split.samples[0].model_copy(update={"region": crossed})
    path = shop / "broken.json"
    samples = (broken, *split.samples[1:])
    path.write_text(split.model_copy(update={"samples": samples}).model_dump_json(by_alias=True))
    told = run("lint", "--workshop", shop, "--file", path)
    assert told.exit_code == 2
    assert f"cross or touch themselves (1): {broken.sample_id}" in told.output
    report = run("lint", "--workshop", shop, "--file", path, "--json")
    assert report.exit_code == 2
    (fault,) = json.loads(report.output)["faults"]
    assert fault["sample_ids"] == [broken.sample_id]


def test_a_jury_is_a_gate(shop: Path) -> None:
    """Who stands still beside a hazard fares as expected; who drives on unharmed does not."""
    split = split_of(frozen(shop, "1"))
    jury = shop / "jury"
    jury.mkdir()
    slow, parked = (
        planning_file({it.sample_id: speed_mps for it in split.samples}, split=split.name)
        for speed_mps in (2.0, 0.0)
    )
    fast = planning_file({it.sample_id: 12.0 for it in split.samples}, split=split.name)
    (jury / "fast.json").write_bytes(fast)
    command = ("lint", "--workshop", shop, "--jury", jury, "--json")
    passed = run(*command)
    assert passed.exit_code == 0, passed.output
    found = {each["method"]: each for each in json.loads(passed.output)["jury"]}
    assert set(found) == {"FREEZE", "CONSTANT VELOCITY", "SOURCE AS EDITED", "fast.json"}
    assert found["FREEZE"]["ur"] == 0
    (jury / "fast.json.gz").write_bytes(gzip.compress(fast))
    (jury / "parked.json").write_bytes(parked)
    (jury / "slow.json").write_bytes(slow)
    refused = run(*command[:-1])
    assert refused.exit_code == 2
    assert "jury fast.json: HCC" in refused.output
    assert "jury fast.json.gz: HCC" in refused.output, "each file, also of one planner"
    assert (
        "jury parked.json: HCC 100.00, UR 0.00 no moving planner: stands_still, " in refused.output
    )
    assert (
        "jury slow.json: HCC 100.00, UR 0.00 OBJECTION: a moving planner has HCC" in refused.output
    )


def test_a_jury_judges_each_part(shop: Path) -> None:
    """A planner that is perfect on the public part alone would lead the live board."""
    ids = [sample.sample_id for sample in split_of(frozen(shop, "1")).samples]
    set_freeze(shop, "public_part = []", f"public_part = {json.dumps(ids[::4])}")
    jury = shop / "jury"
    jury.mkdir()
    speeds = dict.fromkeys(ids, 12.0) | dict.fromkeys(ids[::4], 2.0)
    (jury / "half.json").write_bytes(planning_file(speeds, split="made-2027"))
    refused = run("lint", "--workshop", shop, "--jury", jury)
    assert refused.exit_code == 2
    said = [line for line in refused.output.splitlines() if line.startswith("jury half.json")]
    assert ["OBJECTION" in line for line in said] == [False, True, False]
    assert [line.split(":")[0] for line in said] == [
        "jury half.json",
        "jury half.json in the public part",
        "jury half.json in the private part",
    ]


def test_a_jury_that_is_no_folder_is_named(shop: Path) -> None:
    (shop / "file").write_text("")
    for name, words in (("nope", "No such file or directory."), ("file", "Not a directory.")):
        result = run("lint", "--workshop", shop, "--jury", shop / name)
        assert (result.exit_code, f"{shop / name}: {words}" in result.output) == (2, True)
