"""Cards, leases and decisions, without a browser."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.build.shop import make_shop
from typer.testing import CliRunner

from exceptiondrive_build.agreement import outcome, readings
from exceptiondrive_build.cli import app
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.records import Author, Kind, Record
from exceptiondrive_build.report import report
from exceptiondrive_build.review_page import desk as desk_module
from exceptiondrive_build.review_page import leases
from exceptiondrive_build.review_page.cards import card
from exceptiondrive_build.review_page.desk import Desk, Queue, TakenError
from exceptiondrive_build.review_page.leases import Holder
from exceptiondrive_build.values import Corners, Inspected, Mark, Verified
from exceptiondrive_build.workshop import Workshop

ADA, GRACE, LIN = Holder("b1", "ada"), Holder("b2", "grace"), Holder("b3", "lin")
PASSED = Inspected(passed=True)
LEASE_S = 60.0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_shop(tmp_path_factory.mktemp("made"), width_px=64)


class Clock:
    now = 1_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(leases, "time", clock)
    return clock


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "shop")


@pytest.fixture
def desk(folder: Path) -> Iterator[Desk]:
    with Workshop(folder) as workshop:
        desk = Desk(workshop, LEASE_S)
        yield desk
        desk.leases.close()


def moved(corners: Corners | None, ahead_m: float) -> Corners:
    assert corners is not None
    a, b, c, d = ((x + ahead_m, y) for x, y in corners)
    return a, b, c, d


def region(desk: Desk, sample_id: str) -> Corners:
    localized = desk.candidates[sample_id].localized
    assert localized is not None
    return localized.corners


def accepted(desk: Desk, sample_id: str, ahead_m: float = 0, *, blind: bool = True) -> Verified:
    corners = moved(region(desk, sample_id), ahead_m)
    return Verified(accepted=True, corners=corners, checked=("location",), blind=blind)


def rewrite(folder: Path, old: str, new: str, name: str = "workshop.toml") -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new))


def take(desk: Desk, holder: Holder, sample_id: str) -> None:
    """Claim until a card is held."""
    while sample_id not in (got := desk.claim("verify", holder, 1)):
        assert got


def test_no_card_is_given_to_two_and_none_is_left(desk: Desk) -> None:
    given: list[str] = []
    for _ in range(6):
        given += [*desk.claim("inspect", ADA, 2), *desk.claim("inspect", GRACE, 3)]
    assert len(given) == len(set(given)) == 21
    assert set(given) == set(desk.cards("inspect"))
    assert desk.claim("inspect", LIN, 1) == []


def test_two_processes_share_the_leases(desk: Desk, folder: Path) -> None:
    with Workshop(folder) as workshop:
        other = Desk(workshop, LEASE_S)
        given = [*desk.claim("inspect", ADA, 9), *other.claim("inspect", GRACE, 99)]
        assert len(given) == len(set(given)) == 21
        desk.decide("inspect", given[0], ADA, PASSED)
        assert other.progress("inspect", "grace").decided == 1
        other.leases.close()


def test_cards_of_a_browser_that_died_come_back_when_its_time_is_over(
    desk: Desk, clock: Clock
) -> None:
    lost = desk.claim("inspect", ADA, 4)
    assert set(lost).isdisjoint(desk.claim("inspect", GRACE, 99))
    clock.now += LEASE_S - 1
    desk.leases.renew(GRACE)
    clock.now += 2
    assert desk.claim("inspect", LIN, 99) == lost


def test_a_sign_of_life_holds_cards_and_does_not_bring_lost_ones_back(
    desk: Desk, clock: Clock
) -> None:
    first = desk.claim("inspect", ADA, 1)
    clock.now += LEASE_S - 1
    desk.leases.renew(ADA)
    clock.now += LEASE_S - 1
    assert first[0] not in desk.claim("inspect", GRACE, 1)
    clock.now += 2
    desk.leases.renew(ADA)
    assert first[0] in desk.claim("inspect", GRACE, 99)


def test_a_decision_that_comes_late_counts_if_nobody_else_has_the_card(
    desk: Desk, clock: Clock
) -> None:
    card_, other = desk.claim("inspect", ADA, 2)
    clock.now += LEASE_S + 1
    desk.decide("inspect", card_, ADA, PASSED)
    assert desk.seats("inspect", card_) == 0
    assert other in desk.claim("inspect", GRACE, 99)
    with pytest.raises(TakenError):
        desk.decide("inspect", other, ADA, PASSED)
    assert desk.standing("inspect", other) == ()


def test_the_same_word_sent_again_is_one_decision(desk: Desk) -> None:
    (card_,) = desk.claim("inspect", ADA, 1)
    for _ in range(3):
        desk.decide("inspect", card_, ADA, PASSED)
    assert len(list(desk.workshop.records.read(Kind.INSPECT))) == 1


def test_another_word_after_a_lost_answer_is_told_that_the_first_was_kept(desk: Desk) -> None:
    seen, read = *desk.claim("inspect", ADA, 1), *desk.claim("verify", ADA, 1)
    desk.decide("inspect", seen, ADA, PASSED)
    desk.decide("verify", read, ADA, accepted(desk, read))
    refused = Inspected(passed=False, reason=Mark.VISIBILITY)
    with pytest.raises(
        BuildError, match=r"Your first word on this card was kept\. U takes it back"
    ):
        desk.decide("inspect", seen, ADA, refused)
    with pytest.raises(BuildError, match="U takes it back"):
        desk.decide("verify", read, ADA, Verified(accepted=False, reason="task"))
    assert desk.undo("inspect", ADA) is not None
    desk.decide("inspect", seen, ADA, refused)
    assert [it.value for it in desk.standing("inspect", seen)] == [refused.model_dump(mode="json")]


def test_undo_takes_back_one_decision_after_the_other_and_keeps_all_records(desk: Desk) -> None:
    first, second = desk.claim("inspect", ADA, 2)
    desk.decide("inspect", first, ADA, Inspected(passed=True, note="first"))
    desk.decide("inspect", second, ADA, Inspected(passed=False, note="second"))
    for card_, note in ((second, "second"), (first, "first")):
        found = desk.undo("inspect", ADA)
        assert found is not None
        assert (found[0], (found[1].value or {})["note"]) == (card_, note)
        assert card_ not in desk.claim("inspect", GRACE, 99)
    assert desk.undo("inspect", ADA) is None
    assert desk.undo("inspect", GRACE) is None
    desk.decide("inspect", first, ADA, PASSED)
    records = list(desk.workshop.records.read(Kind.INSPECT))
    assert [record.value and record.value["passed"] for record in records] == [
        True,
        False,
        None,
        None,
        True,
    ]


def test_what_is_put_off_comes_last_for_who_put_it_off_alone(desk: Desk) -> None:
    first, second = desk.claim("inspect", ADA, 2)
    desk.skip("inspect", first, ADA)
    assert desk.claim("inspect", GRACE, 1) == [first]
    desk.leases.give_back(GRACE)
    rest = desk.claim("inspect", ADA, 99)
    assert rest[-1] == first
    assert second not in rest


def test_what_was_inspected_and_refused_is_not_verified(desk: Desk) -> None:
    bad, good = desk.claim("inspect", ADA, 2)
    desk.decide("inspect", bad, ADA, Inspected(passed=False))
    desk.decide("inspect", good, ADA, PASSED)
    assert bad not in desk.cards("verify")
    assert good in desk.cards("verify")


def test_each_region_is_read_once_by_each_of_two_and_then_by_nobody(desk: Desk) -> None:
    read: dict[str, list[str]] = {card_: [] for card_ in desk.cards("verify")}
    for holder in (ADA, ADA, GRACE, LIN, GRACE, ADA, LIN) * 9:
        for card_ in desk.claim("verify", holder, 2):
            read[card_].append(holder.reviewer)
            desk.decide("verify", card_, holder, accepted(desk, card_))
    assert all(len(people) == len(set(people)) == 2 for people in read.values())
    assert desk.progress("verify", "lin").decided == 21


def test_a_reader_spelled_otherwise_gets_no_card_again(desk: Desk) -> None:
    again = Holder("b4", "ADA")
    held, read = desk.claim("verify", ADA, 2)
    desk.decide("verify", read, ADA, accepted(desk, read))
    assert {held, read}.isdisjoint(desk.claim("verify", again, 99))
    assert desk.progress("verify", "ADA").mine == 1
    undone = desk.undo("verify", again)
    assert undone is not None
    assert undone[0] == read


def test_one_who_was_third_reads_blind_no_more_however_spelled(desk: Desk) -> None:
    card_ = disputed(desk)
    desk.decide("verify", card_, LIN, accepted(desk, card_, blind=False))
    assert desk.undo("verify", ADA) is not None
    assert desk.undo("verify", LIN) is not None
    assert not desk.may_decide("verify", card_, "Lin")


def test_one_who_was_third_may_still_say_whether_the_edit_is_good(desk: Desk) -> None:
    card_ = disputed(desk)
    desk.decide("verify", card_, LIN, accepted(desk, card_, blind=False))
    assert card_ in desk.claim("inspect", LIN, 99)
    desk.decide("inspect", card_, LIN, PASSED)
    assert desk.progress("inspect", "lin").mine == 1


def test_a_reader_who_differs_is_not_told_and_a_third_decides(desk: Desk) -> None:
    (card_,) = desk.claim("verify", ADA, 1)
    desk.decide("verify", card_, ADA, accepted(desk, card_))
    take(desk, GRACE, card_)
    assert card(desk, "verify", card_)["others"] == []
    desk.decide("verify", card_, GRACE, accepted(desk, card_, 2.5))
    assert card_ not in desk.claim("verify", ADA, 99) + desk.claim("verify", GRACE, 99)
    assert desk.progress("verify", "ada").third == 1
    take(desk, LIN, card_)
    shown = card(desk, "verify", card_)
    assert shown["third"]
    assert [word["corners"][0][0] for word in shown["others"]] == pytest.approx(
        [region(desk, card_)[0][0], region(desk, card_)[0][0] + 2.5]
    )
    desk.decide("verify", card_, LIN, accepted(desk, card_, 1.0, blind=False))
    found = outcome(desk.standing("verify", card_), desk.workshop.settings.verify)
    assert (found.state, people(desk, card_)) == ("verified", ("ada", "grace", "lin"))
    assert found.corners == moved(region(desk, card_), 1.0)


def people(desk: Desk, sample_id: str) -> tuple[str, ...]:
    """Whose words on a region stand."""
    return tuple(person for person, _ in readings(desk.standing("verify", sample_id)))


def disputed(desk: Desk) -> str:
    """A card that Ada and Grace read three metres apart, and Lin holds as the third."""
    (card_,) = desk.claim("verify", ADA, 1)
    desk.decide("verify", card_, ADA, accepted(desk, card_))
    take(desk, GRACE, card_)
    desk.decide("verify", card_, GRACE, accepted(desk, card_, 3.0))
    take(desk, LIN, card_)
    return card_


def test_a_reading_taken_back_is_open_for_desk_and_report_alike(desk: Desk) -> None:
    card_ = disputed(desk)
    desk.decide("verify", card_, LIN, accepted(desk, card_, blind=False))
    assert desk.undo("verify", ADA) is not None
    left = sum(desk.seats("verify", each) for each in desk.cards("verify"))
    (_, verified) = report(desk.workshop).people
    assert verified.open == left == 41


def test_a_third_reader_is_told_why_another_rejects(desk: Desk) -> None:
    (card_,) = desk.claim("verify", ADA, 1)
    desk.decide("verify", card_, ADA, Verified(accepted=False, reason="calibration"))
    take(desk, GRACE, card_)
    desk.decide("verify", card_, GRACE, accepted(desk, card_))
    assert [it["reason"] for it in card(desk, "verify", card_)["others"]] == ["calibration", None]


def test_two_who_never_agree_leave_every_card_in_a_clear_state(desk: Desk) -> None:
    for holder, ahead_m in ((ADA, 0.0), (GRACE, 3.0)):
        for card_ in desk.claim("verify", holder, 99):
            desk.decide("verify", card_, holder, accepted(desk, card_, ahead_m))
    for who in ("ada", "grace"):
        found = desk.progress("verify", who)
        assert (found.cards, found.decided, found.for_me, found.for_others) == (21, 0, 0, 21)
        assert found.third == 21
    assert desk.progress("verify", "lin").for_me == 21
    assert len(list(desk.workshop.records.read(Kind.VERIFY))) == 42


def test_a_card_whose_readings_changed_under_a_third_is_shown_anew(desk: Desk) -> None:
    card_ = disputed(desk)
    assert desk.undo("verify", ADA) is not None
    with pytest.raises(TakenError):
        desk.decide("verify", card_, LIN, accepted(desk, card_, blind=False))
    desk.decide("verify", card_, ADA, accepted(desk, card_, 3))
    found = outcome(desk.standing("verify", card_), desk.workshop.settings.verify)
    assert (found.state, people(desk, card_)) == ("verified", ("grace", "ada"))


def test_a_third_is_asked_again_where_the_two_have_changed(desk: Desk) -> None:
    """Also where the third says the same, and as often as it changes."""
    card_ = disputed(desk)
    same = accepted(desk, card_, blind=False)
    desk.decide("verify", card_, LIN, same)
    for ahead_m in (6.0, 9.0):
        assert desk.seats("verify", card_) == 0
        assert desk.undo("verify", ADA) is not None
        desk.decide("verify", card_, ADA, accepted(desk, card_, ahead_m))
        assert desk.seats("verify", card_) == desk.progress("verify", "lin").third == 1
        take(desk, LIN, card_)
        desk.decide("verify", card_, LIN, same)
    found = outcome(desk.standing("verify", card_), desk.workshop.settings.verify)
    assert (found.state, found.corners) == ("verified", same.corners)
    assert desk.undo("verify", LIN) is not None
    assert desk.is_third(card_)
    assert desk.undo("verify", LIN) is None


def test_who_was_shown_what_others_said_reads_the_region_blind_no_more(desk: Desk) -> None:
    card_ = disputed(desk)
    desk.decide("verify", card_, LIN, accepted(desk, card_, blind=False))
    assert desk.undo("verify", ADA) is not None
    assert desk.undo("verify", LIN) is not None
    assert not desk.may_decide("verify", card_, "lin")
    with pytest.raises(TakenError):
        desk.decide("verify", card_, LIN, accepted(desk, card_))
    desk.decide("verify", card_, ADA, accepted(desk, card_, 6))
    assert desk.may_decide("verify", card_, "lin")
    desk.decide("verify", card_, LIN, accepted(desk, card_, blind=False))
    found = outcome(desk.standing("verify", card_), desk.workshop.settings.verify)
    assert (found.state, people(desk, card_)) == ("verified", ("grace", "ada", "lin"))


def test_limits_changed_while_the_page_is_open_hold_at_once(desk: Desk, folder: Path) -> None:
    (card_,) = desk.claim("verify", ADA, 1)
    desk.decide("verify", card_, ADA, accepted(desk, card_))
    take(desk, GRACE, card_)
    desk.decide("verify", card_, GRACE, accepted(desk, card_, 0.2))
    assert desk.progress("verify", "lin").third == 0
    rewrite(folder, "max_corner_distance_m = 1.0", "max_corner_distance_m = 0.1")
    assert desk.progress("verify", "lin").third == 1
    with Workshop(folder) as anew:
        (_, verified) = report(anew).people
    assert verified.open == sum(desk.seats("verify", each) for each in desk.cards("verify"))


def test_settings_that_cannot_be_read_are_told_until_they_can(desk: Desk, folder: Path) -> None:
    rewrite(folder, "min_iou = 0.7", "min_iou = seven")
    for _ in range(2):
        with pytest.raises(BuildError, match=r"workshop\.toml: Invalid value"):
            desk.progress("verify", "ada")
    rewrite(folder, "min_iou = seven", "min_iou = 0.7")
    rewrite(folder, "[SE1", "[XX1", "tasks.toml")
    for _ in range(2):
        with pytest.raises(BuildError, match=r"tasks\.toml: no words for the tasks SE1"):
            desk.claim("verify", ADA, 1)
    rewrite(folder, "[XX1", "[SE1", "tasks.toml")
    assert len(desk.claim("verify", ADA, 1)) == 1


@pytest.mark.parametrize("queue", ["inspect", "verify"])
def test_a_decision_is_about_the_pictures_that_were_shown(desk: Desk, queue: Queue) -> None:
    (card_,) = desk.claim(queue, ADA, 1)
    record = desk.candidates[card_].current[Kind.EDIT]
    assert record.value is not None
    (view, _), *_ = record.value["images"].items()
    another = desk.candidates[card_].keyframe.camera(view).image
    later = {**record.value, "images": {**record.value["images"], view: another}}
    desk.workshop.records.append(record.model_copy(update={"value": later, "id": None}))
    desk.refresh(walk_after_s=0)
    word = PASSED if queue == "inspect" else Verified(accepted=False, reason="views")
    with pytest.raises(TakenError):
        desk.decide(queue, card_, ADA, word)
    assert not desk.leases.holds(queue, card_, ADA)
    assert not list(desk.workshop.records.read(Kind.INSPECT, Kind.VERIFY))


def test_a_decision_about_an_edit_that_counts_no_more_is_not_kept(desk: Desk, folder: Path) -> None:
    (card_,) = desk.claim("inspect", ADA, 1)
    rewrite(folder, "seed = 1", "seed = 2")
    with pytest.raises(TakenError):
        desk.decide("inspect", card_, ADA, PASSED)
    rewrite(folder, "seed = 2", "seed = 1")
    take_again = desk.claim("inspect", ADA, 1)
    desk.decide("inspect", take_again[0], ADA, PASSED)
    assert desk.standing("inspect", take_again[0])


def test_what_was_taken_back_is_no_decision_of_the_report(desk: Desk) -> None:
    (card_,) = desk.claim("inspect", ADA, 1)
    desk.decide("inspect", card_, ADA, PASSED)
    assert desk.undo("inspect", ADA) is not None
    desk.decide("inspect", card_, ADA, Inspected(passed=False, reason=Mark.VISIBILITY))
    (inspected, _) = report(desk.workshop).people
    assert inspected.decisions == desk.progress("inspect", "ada").mine == 1


def test_the_report_counts_what_people_refused_edits_and_regions_for(desk: Desk) -> None:
    seen, other, read = desk.cards("inspect")[:3]
    desk.decide("inspect", seen, ADA, Inspected(passed=False, reason=Mark.VISIBILITY))
    desk.decide("inspect", other, ADA, Inspected(passed=False))
    desk.decide("verify", read, ADA, Verified(accepted=False, reason="task"))
    desk.decide("verify", read, GRACE, Verified(accepted=False, reason="location"))
    assert report(desk.workshop).rejected_because == {
        "inspected:no_reason": 1,
        "inspected:visibility": 1,
        "region:location": 1,
        "region:task": 1,
    }


def test_a_region_that_is_reopened_goes_to_both_readers_again(desk: Desk, folder: Path) -> None:
    card_, other = desk.cards("verify")[:2]
    for holder in (ADA, GRACE):
        for each in (card_, other):
            desk.decide("verify", each, holder, accepted(desk, each))
    before = report(desk.workshop).people[1]
    command = ["reopen", card_, "--workshop", str(folder), "--by", "organizer"]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert desk.progress("verify", "ada").decided == 1
    after = report(desk.workshop).people[1]
    assert (after.open, after.hours) == (before.open + 2, before.hours)
    for holder in (ADA, GRACE):
        assert desk.seats("verify", other) == 0
        take(desk, holder, card_)
        assert card(desk, "verify", card_)["others"] == []
        desk.decide("verify", card_, holder, accepted(desk, card_, 2.0))
    found = outcome(desk.standing("verify", card_), desk.workshop.settings.verify)
    assert found.corners == moved(region(desk, card_), 2.0)


def test_what_is_withdrawn_waits_for_no_reader_in_desk_and_report_alike(desk: Desk) -> None:
    card_ = desk.cards("verify")[0]
    reason = {"reason": "the scene was closed to the public"}
    author = Author(person="organizer")
    withdrawal = Record(kind=Kind.WITHDRAW, candidate=card_, by=author, inputs=(), value=reason)
    desk.workshop.records.append(withdrawal)
    desk.refresh(walk_after_s=0)
    (_, verified) = report(desk.workshop).people
    assert verified.open == sum(desk.seats("verify", each) for each in desk.cards("verify")) == 40


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        (((10.0, 0.0), (12.0, 2.0), (12.0, 0.0), (10.0, 2.0)), "crosses or touches itself"),
        (((10.0, 0.0), (10.0, 0.05), (10.05, 0.05), (10.05, 0.0)), "smaller than 0.01 m²"),
        (((2.0, -1.0), (2.0, 1.0), (6.0, 1.0), (6.0, -1.0)), "touches the car where it stands"),
        (((140.0, 0.0), (140.0, 2.0), (142.0, 2.0), (142.0, 0.0)), "more than 100 m away"),
        (None, "it has no corners"),
    ],
)
def test_a_region_that_no_split_may_hold_is_refused_in_words(
    desk: Desk, corners: Corners | None, said: str
) -> None:
    (card_,) = desk.claim("verify", ADA, 1)
    with pytest.raises(BuildError, match=said):
        desk.decide("verify", card_, ADA, Verified(accepted=True, corners=corners))
    desk.decide("verify", card_, ADA, accepted(desk, card_))


def test_a_region_is_accepted_by_who_says_what_was_checked(desk: Desk) -> None:
    (card_,) = desk.claim("verify", ADA, 1)
    word = accepted(desk, card_)
    with pytest.raises(BuildError, match="Say what you checked"):
        desk.decide("verify", card_, ADA, word.model_copy(update={"checked": ()}))
    assert desk.standing("verify", card_) == ()
    desk.decide("verify", card_, ADA, word)


def test_on_a_full_disk_the_decision_is_refused_and_the_card_stays(desk: Desk) -> None:
    (card_,) = desk.claim("inspect", ADA, 1)
    connection = desk.workshop.records._connection
    pages = connection.execute("PRAGMA page_count").fetchone()[0]
    connection.execute(f"PRAGMA max_page_count = {pages}")
    long = Inspected(passed=True, note="x" * 100_000)
    with pytest.raises(BuildError, match="full"):
        desk.decide("inspect", card_, ADA, long)
    assert desk.leases.holds("inspect", card_, ADA)
    connection.execute("PRAGMA max_page_count = 1073741823")
    desk.decide("inspect", card_, ADA, long)
    assert desk.standing("inspect", card_)[0].value == long.model_dump(mode="json")


def test_a_candidate_withdrawn_meanwhile_leaves_the_queue(desk: Desk) -> None:
    card_ = desk.cards("verify")[0]
    desk.workshop.records.append(
        Record(
            kind=Kind.WITHDRAW,
            candidate=card_,
            by=Author(person="organizer"),
            inputs=(),
            value={"reason": "the scene was closed to the public"},
        )
    )
    desk.refresh(walk_after_s=0)
    assert card_ not in desk.cards("verify")


def test_what_a_stage_did_meanwhile_comes_to_a_reviewer_who_has_nothing(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk_module, "WALK_WHEN_IDLE_S", 0.0)
    card_ = desk.cards("verify")[0]
    record = desk.candidates[card_].current[Kind.LOCALIZE]
    taken_back = record.model_copy(update={"value": None, "supersedes": record.id, "id": None})
    desk.workshop.records.append(taken_back)
    desk.refresh(walk_after_s=0)
    assert card_ not in desk.claim("verify", ADA, 99)
    desk.workshop.records.append(record.model_copy(update={"id": None}))
    assert desk.claim("verify", ADA, 99) == [card_]
