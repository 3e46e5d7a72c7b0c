"""The stages that ask a model: what is asked, kept and decided, and what is not asked again."""

import json
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from tests.support.chat_endpoint import Reply, Seen
from tests.support.made_pictures import png_that_says
from tests.support.stand_in import StandIn, form_fields, picture, png, screen_answer
from typer.testing import CliRunner, Result

from exceptiondrive_build.asking import read_answers
from exceptiondrive_build.candidates import Candidate, walk
from exceptiondrive_build.cli import app
from exceptiondrive_build.editing import fitted
from exceptiondrive_build.measure import read_picture
from exceptiondrive_build.records import Kind, Records
from exceptiondrive_build.values import Edited, Screened, Unanswered
from exceptiondrive_build.workshop import Workshop, new_workshop

KEY = "key-of-the-tests-0123456789"


def run(shop: Path, stage: str, *more: str) -> Result:
    return CliRunner().invoke(app, ["run", stage, "-w", str(shop), *more])


def report(shop: Path, stage: str, *more: str, exit_code: int = 0) -> dict[str, Any]:
    result = run(shop, stage, "--json", *more)
    assert result.exit_code == exit_code, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def walked(shop: Path) -> dict[str, Candidate]:
    with Workshop(shop) as workshop:
        return walk(workshop)


def change(shop: Path, file: str, old: str, new: str) -> None:
    path = shop / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def once(*replies: Reply) -> Callable[[Seen], Reply | None]:
    """These faults, one after the other; then answers."""
    left = list(replies)
    return lambda seen: left.pop(0) if left else None


def test_a_workshop_without_scenes_says_what_to_do(tmp_path: Path) -> None:
    new_workshop(tmp_path / "shop", "made-2027", KEY * 2)
    for more in ((), ("--dry-run",)):
        result = run(tmp_path / "shop", "screen", *more)
        assert result.exit_code == 2
        assert "exceptiondrive-build scenes read SOURCE" in result.stderr


def test_a_stage_before_its_turn_says_what_to_run_first(shop: Path, stand_in: StandIn) -> None:
    for stage in ("edit", "review"):
        early = run(shop, stage)
        assert (early.exit_code, early.stdout) == (2, "")
        assert "18 candidates must pass an earlier stage." in early.stderr
        assert "Run first: exceptiondrive-build run screen\n" in early.stderr
    report(shop, "screen")
    assert "Run first: exceptiondrive-build run edit\n" in run(shop, "review").stderr
    early = CliRunner().invoke(app, ["localize", "--by-hand", "-w", str(shop)])
    assert (early.exit_code, "exceptiondrive-build run review" in early.stderr) == (2, True)


def test_every_stage_decides_all_and_is_then_done(shop: Path, stand_in: StandIn) -> None:
    assert report(shop, "screen")["decided"] == 18
    suitable = [c for c in walked(shop).values() if c.is_suitable]
    assert 0 < len(suitable) < 18
    assert report(shop, "edit")["decided"] == len(suitable)
    assert report(shop, "review")["decided"] == len(suitable)
    n_seen = len(stand_in.seen)
    for stage in ("screen", "edit", "review"):
        again = report(shop, stage)
        assert (again["decided"], again["calls"], again["still_open"]) == (0, 0, 0)
    assert len(stand_in.seen) == n_seen


def test_a_candidate_is_shown_all_its_views_and_told_its_own_task(
    shop: Path, stand_in: StandIn
) -> None:
    report(shop, "screen", "--limit", "1")
    (seen,) = stand_in.seen
    assert len(seen.images) == 6
    assert "View CAM_FRONT:" in seen.texts
    assert "a person steps out from behind a stopped vehicle" in seen.texts[0]
    assert "no_occluder: nothing stands beside the lane" in seen.texts[0]
    assert "6 to 30 m ahead and -4 to 4 m to the left" in seen.texts[0]
    assert "{" + "hazard}" not in seen.texts[0]
    assert seen.form == "json_schema"


def test_an_edit_is_asked_for_with_the_words_the_source_and_the_seed(
    shop: Path, stand_in: StandIn
) -> None:
    report(shop, "screen")
    stand_in.seen.clear()
    report(shop, "edit", "--limit", "1")
    seen = stand_in.seen[0]
    fields = form_fields(seen)
    assert seen.path == "/v1/images/edits"
    assert (fields["seed"], fields["response_format"]) == (b"1", b"b64_json")
    assert b"Change only the place" in fields["prompt"]
    assert b"m to the left" in fields["prompt"]
    edited = next(c for c in walked(shop).values() if isinstance(c.edited, Edited))
    view = next(iter(edited.edited.images))  # type: ignore[union-attr]
    assert fields["image"].startswith(b"\xff\xd8")
    assert read_picture(fields["image"]).size == (
        edited.keyframe.camera(view).width_px,
        edited.keyframe.camera(view).height_px,
    )


def test_what_was_changed_is_measured_where_it_was_to_be(shop: Path, stand_in: StandIn) -> None:
    stand_in.repainted = 0.0
    for stage in ("screen", "edit", "review"):
        report(shop, stage)
    changes = [
        change
        for candidate in walked(shop).values()
        if candidate.is_suitable
        for change in candidate.reviewed.changes.values()  # type: ignore[union-attr]
    ]
    assert changes
    assert all(c.inside is not None and c.inside > 0.05 > c.outside / 4 for c in changes)


def test_an_edit_that_repaints_the_background_is_rejected_whatever_the_model_says(
    shop: Path, stand_in: StandIn
) -> None:
    stand_in.repainted, stand_in.low = 1.0, 0.0
    for stage in ("screen", "edit", "review"):
        report(shop, stage)
    for candidate in walked(shop).values():
        if candidate.is_suitable:
            assert candidate.review_faults == ("background_changed",)
            assert not candidate.is_accepted


def test_a_threshold_that_changes_asks_nobody(shop: Path, stand_in: StandIn) -> None:
    for stage in ("screen", "edit", "review"):
        report(shop, stage)
    accepted = sum(c.is_accepted for c in walked(shop).values())
    assert accepted
    n_seen = len(stand_in.seen)
    change(shop, "workshop.toml", "min_mean_mark = 3.5", "min_mean_mark = 4.9")
    assert sum(c.is_accepted for c in walked(shop).values()) < accepted
    assert report(shop, "review")["calls"] == 0
    assert len(stand_in.seen) == n_seen


def test_other_words_of_one_task_ask_about_this_task_alone_and_old_ones_count_again(
    shop: Path, stand_in: StandIn
) -> None:
    report(shop, "screen")
    before = walked(shop)
    stand_in.seen.clear()
    change(shop, "tasks.toml", "the whole width of the ego lane is seen", "the lane is seen")
    assert report(shop, "screen")["decided"] == 3  # LB3 of three keyframes; LB4 is not in use
    assert {seen.texts[0].count("the lane is seen") for seen in stand_in.seen} == {1}
    change(shop, "tasks.toml", "the lane is seen", "the whole width of the ego lane is seen")
    assert report(shop, "screen")["calls"] == 0
    assert {k: c.screened for k, c in walked(shop).items()} == {
        k: c.screened for k, c in before.items()
    }


def test_another_model_is_asked_about_all(shop: Path) -> None:
    report(shop, "screen")
    change(shop, "workshop.toml", 'model = "vision-model"', 'model = "other-model"')
    assert report(shop, "screen")["decided"] == 18


def test_a_malformed_answer_is_asked_again_then_recorded_as_such(
    shop: Path, stand_in: StandIn
) -> None:
    stand_in.fault = once(stand_in.says("no idea"))
    assert report(shop, "screen", "--limit", "1")["decided"] == 1
    stand_in.fault = once(stand_in.says("no idea"), stand_in.says(None, refusal="I will not"))
    change(shop, "workshop.toml", "concurrency = 8", "concurrency = 1")
    done = report(shop, "screen", "--limit", "1")
    assert (done["decided"], done["recorded_without_answer"]) == (0, 1)
    found = [c.screened for c in walked(shop).values() if isinstance(c.screened, Unanswered)]
    assert [unanswered.failure for unanswered in found] == ["refusal"]
    with Workshop(shop) as workshop:
        texts = [answer.text for answer in read_answers(workshop, Kind.SCREEN)]
    assert texts.count("no idea") == 2
    assert "I will not" in texts


@pytest.mark.parametrize("where", ["before the answer", "in its note"])
def test_a_long_answer_is_kept_and_asked_for_once(
    shop: Path, stand_in: StandIn, where: str
) -> None:
    answer, long = screen_answer(False, reason="no_room"), 4000 * "I wonder. "
    thought = f"<think>{long}</think>" if where == "before the answer" else ""
    said = thought + json.dumps(answer if thought else answer | {"note": long})
    stand_in.fault = lambda seen: stand_in.says(said)
    assert report(shop, "screen", "--limit", "1")["decided"] == 1
    with Workshop(shop) as workshop:
        (kept,) = read_answers(workshop, Kind.SCREEN)
    assert kept.text == said
    with Workshop(shop) as workshop:
        workshop.records.close()
    (shop / "records.sqlite3").unlink()
    Records(shop / "records.sqlite3").close()
    again = report(shop, "screen", "--limit", "1")
    assert (again["decided"], again["calls"]) == (1, 0)


def wrong(**fields: Any) -> dict[str, Any]:
    edit = {"view": "CAM_FRONT", "instruction": "here"}
    return screen_answer(True, target=(12.0, 0.0), edits=[edit]) | fields


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (screen_answer(False, reason="because"), "code of a rule"),
        (screen_answer(False), "code of a rule"),
        (wrong(edits=[]), "without views"),
        (wrong(edits=[{"view": "CAM_ROOF", "instruction": "x"}]), "without views"),
        (wrong(edits=2 * [{"view": "CAM_FRONT", "instruction": "x"}]), "each once"),
        (wrong(edits=[{"view": "CAM_FRONT", "instruction": "  "}]), "without an instruction"),
        (wrong(target_ahead_m=None), "without a target"),
        (wrong(target_ahead_m=-12.0), "asked for 6 to 30"),
        (wrong(target_left_m=40.0), "asked for -4 to 4"),
        (wrong(target_left_m=float("inf")), "no single JSON"),
        (wrong(suitable="yes"), "suitable"),
        ({"suitable": True}, "reason"),
    ],
)
def test_an_answer_that_does_not_say_what_was_asked_is_not_taken(
    shop: Path, stand_in: StandIn, answer: dict[str, Any], said: str
) -> None:
    stand_in.fault = lambda seen: stand_in.says(json.dumps(answer))
    done = report(shop, "screen", "--limit", "1")
    assert done["recorded_without_answer"] == 1
    assert said in next(iter(done["first_failures"].values()))


def cut(reply: Reply) -> Reply:
    return Reply(reply.body[:50], announced_bytes=len(reply.body))


@pytest.mark.parametrize("stage", ["screen", "edit"])
@pytest.mark.parametrize("fault", ["busy", "broken", "dropped", "gateway"])
def test_an_endpoint_that_fails_for_a_while_is_asked_again(
    shop: Path, stand_in: StandIn, stage: str, fault: str
) -> None:
    if stage == "edit":
        report(shop, "screen")
    faults = {
        "busy": stand_in.fails(429, headers={"Retry-After": "0.05"}),
        "broken": stand_in.fails(500, headers={"retry-after-ms": "20"}),
        "dropped": cut(stand_in.says("{}")),
        "gateway": Reply(b"<html>Bad Gateway</html>", 502, {"retry-after-ms": "20"}),
    }
    stand_in.fault = once(faults[fault])
    done = report(shop, stage, "--limit", "2")
    assert (done["decided"], done["calls"], done["requests"]) == (2, 2, 3)


@pytest.mark.parametrize(
    ("fault", "reason", "exit_code"),
    [
        (Reply(b"<html>welcome</html>"), "bad_response", 2),
        (StandIn.fails(400, "picture too large"), "request_refused", 2),
        (StandIn.fails(503, headers={"retry-after-ms": "1"}), "server_error", 5),
    ],
)
def test_what_the_endpoint_is_to_blame_for_stays_open(
    shop: Path, stand_in: StandIn, fault: Reply, reason: str, exit_code: int
) -> None:
    stand_in.fault = lambda seen: fault
    change(shop, "workshop.toml", "concurrency = 8", "concurrency = 8\nmax_retries = 1")
    done = report(shop, "screen", "--limit", "2", exit_code=exit_code)
    assert (done["failed"], done["still_open"]) == ({reason: 2}, 18)
    assert all(candidate.screened is None for candidate in walked(shop).values())
    stand_in.fault = lambda seen: None
    assert report(shop, "screen")["still_open"] == 0


def test_what_an_endpoint_that_has_answered_refuses_does_not_stop_a_stage(
    shop: Path, stand_in: StandIn
) -> None:
    change(shop, "workshop.toml", '"RS1"]', '"RS1", "SE2"]')
    assert report(shop, "screen", "--limit", "1")["still_open"] == 20
    stand_in.fault = lambda seen: stand_in.fails(400, "content policy")
    assert report(shop, "screen", exit_code=2)["failed"] == {"request_refused": 20}


def test_an_endpoint_that_is_not_there_is_named(shop: Path, stand_in: StandIn) -> None:
    change(shop, "workshop.toml", stand_in.base_url, "http://127.0.0.1:1/v1")
    change(shop, "workshop.toml", "concurrency = 8", "concurrency = 8\nmax_retries = 0")
    done = run(shop, "screen", "--limit", "1")
    assert done.exit_code == 5
    assert "no connection to http://127.0.0.1:1/v1" in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("now", "said"),
    [
        ('base_url = "http://[bad/v1"', "base_url: expected http"),
        ('base_url = "http://localhost:99999/v1"', "expected http"),
        ('base_url = "http://me:secret@localhost/v1"', "no user or password in it"),
    ],
)
def test_an_address_that_is_none_is_named(
    shop: Path, stand_in: StandIn, now: str, said: str
) -> None:
    change(shop, "workshop.toml", f'base_url = "{stand_in.base_url}"', now)
    done = run(shop, "screen", "--limit", "1")
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())
    assert "secret" not in done.output


@pytest.mark.parametrize(
    ("fault", "exit_code", "said"),
    [
        (StandIn.fails(401, f"wrong key {KEY}"), 4, "EXCEPTIONDRIVE_BUILD_KEY"),
        (StandIn.fails(404, "no such model"), 2, "Correct base_url or model"),
    ],
)
def test_a_refused_key_or_model_stops_the_run_at_once(
    shop: Path, stand_in: StandIn, fault: Reply, exit_code: int, said: str
) -> None:
    stand_in.fault = lambda seen: fault
    change(shop, "workshop.toml", "concurrency = 8", "concurrency = 1")
    result = run(shop, "screen")
    assert (result.exit_code, len(stand_in.seen)) == (exit_code, 1)
    assert said in result.stderr
    assert KEY not in result.output


def png_of(width: int, height: int) -> bytes:
    return png(Image.new("RGB", (width, height), (90, 20, 20)))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"no picture at all", "no_picture"),
        (png_of(320, 180)[:-40], "no_picture"),
        (png_that_says(14_000, 14_000), "no_picture"),
        (png_of(100, 100), "wrong_size"),
    ],
)
def test_an_edited_picture_that_cannot_be_used_is_asked_for_again_then_recorded(
    shop: Path, stand_in: StandIn, data: bytes, reason: str
) -> None:
    report(shop, "screen")
    stand_in.fault = once(picture(data))
    assert report(shop, "edit", "--limit", "1")["decided"] == 1
    stand_in.fault = lambda seen: picture(data)
    done = report(shop, "edit", "--limit", "1")
    assert (done["failed"], done["recorded_without_answer"]) == ({reason: 1}, 1)
    edit, review = (report(shop, stage, "--dry-run") for stage in ("edit", "review"))
    assert review["not_ready"] == edit["candidates"], "one of them never comes to the review"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ([], "expected one picture as base64, got 0"),
        ([{"url": "http://127.0.0.1/x.png"}], "expected one picture as base64, got an address"),
        (2 * [{"b64_json": "AAAA"}], "expected one picture as base64, got 2"),
        ([{"b64_json": "%"}], "the picture is no base64"),
    ],
)
def test_an_answer_without_a_picture_is_none(
    shop: Path, stand_in: StandIn, data: list[dict[str, str]], said: str
) -> None:
    report(shop, "screen")
    stand_in.fault = lambda seen: Reply(json.dumps({"data": data}).encode())
    done = report(shop, "edit", "--limit", "1")
    assert done["failed"] == {"no_picture": 1}
    assert list(done["first_failures"].values()) == [f"no_picture: {said}"]


def test_a_picture_of_the_same_shape_is_scaled_unless_the_settings_say_no(
    shop: Path, stand_in: StandIn
) -> None:
    report(shop, "screen")
    stand_in.fault = lambda seen: picture(png_of(640, 360))
    assert report(shop, "edit", "--limit", "1")["decided"] == 1
    (edited,) = [c.edited for c in walked(shop).values() if isinstance(c.edited, Edited)]
    with Workshop(shop) as workshop:
        data = workshop.image(next(iter(edited.images.values())))
    assert read_picture(data).size == (320, 180)
    change(shop, "workshop.toml", "seed = 1\n\n[review]", "seed = 1\nresample = false\n\n[review]")
    assert report(shop, "edit", "--limit", "1")["failed"] == {"wrong_size": 1}


def cut_out(mode: str, size: tuple[int, int]) -> bytes:
    """A red picture, all of which is transparent."""
    if mode == "RGBA":
        return png(Image.new("RGBA", size, (200, 20, 20, 0)))
    file, image = BytesIO(), Image.new("P", size, 0)
    image.putpalette([200, 20, 20])
    image.save(file, "PNG", transparency=0)
    return file.getvalue()


@pytest.mark.parametrize("size", [(320, 180), (640, 360)])
@pytest.mark.parametrize("mode", ["RGBA", "P"])
def test_of_a_transparent_picture_people_see_the_colours_that_are_measured(
    mode: str, size: tuple[int, int]
) -> None:
    data, extension = fitted(cut_out(mode, size), (320, 180), resample=True)
    kept = read_picture(data)
    assert (extension, kept.size, kept.has_transparency_data) == ("png", (320, 180), False)
    assert kept.convert("RGB").getpixel((160, 90)) == (200, 20, 20)


@pytest.mark.parametrize(
    ("usage", "tokens"),
    [
        ({"input_tokens": 12, "output_tokens": 34}, (12, 34)),
        ({"input_tokens": [True]}, (None, None)),
        ({"input_tokens": -1}, (None, None)),
        ("many", (None, None)),
    ],
)
def test_counts_of_an_editor_that_cannot_be_read_spoil_no_picture(
    shop: Path, stand_in: StandIn, usage: object, tokens: tuple[int | None, int | None]
) -> None:
    report(shop, "screen")
    body = json.loads(picture(png_of(320, 180)).body) | {"usage": usage}
    stand_in.fault = lambda seen: Reply(json.dumps(body).encode())
    assert report(shop, "edit", "--limit", "1")["decided"] == 1
    with Workshop(shop) as workshop:
        (answer, *_) = read_answers(workshop, Kind.EDIT)
    assert (answer.prompt_tokens, answer.completion_tokens) == tokens


def test_an_editor_that_takes_no_response_format_is_asked_without(
    shop: Path, stand_in: StandIn
) -> None:
    report(shop, "screen")

    def fault(seen: Seen) -> Reply | None:
        if "response_format" in form_fields(seen):
            return stand_in.fails(400, "unknown parameter", param="response_format")
        return None

    stand_in.fault = fault
    done = report(shop, "edit", "--limit", "2")
    assert done["decided"] == 2
    with Workshop(shop) as workshop:
        forms = {answer.form for answer in read_answers(workshop, Kind.EDIT)}
    assert forms == {"without response_format"}


def test_every_view_of_a_candidate_or_none_and_no_view_is_paid_for_twice(
    shop: Path, stand_in: StandIn
) -> None:
    views = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
    where = "with its foot at 12.0 m ahead and 0.0 m to the left"
    edits = [{"view": view, "instruction": f"in {view}: {where}"} for view in views]
    answer = screen_answer(True, target=(12.0, 0.0), edits=edits)
    stand_in.fault = lambda seen: stand_in.says(json.dumps(answer))
    report(shop, "screen", "--limit", "1")
    left = [None, None, stand_in.fails(400, "no")]
    stand_in.fault = lambda seen: left.pop(0)
    done = report(shop, "edit", exit_code=2)
    assert (done["calls"], done["decided"], done["still_open"]) == (3, 0, 1)
    assert not any(candidate.edited for candidate in walked(shop).values())
    stand_in.fault = lambda seen: None
    done = report(shop, "edit")
    assert (done["calls"], done["decided"]) == (1, 1)
    (edited,) = [c.edited for c in walked(shop).values() if isinstance(c.edited, Edited)]
    assert set(edited.images) == set(views)
    sent = [form_fields(seen)["prompt"].decode() for seen in stand_in.seen[1:]]
    assert [next(v for v in views if f"in {v}:" in text) for text in sent] == [
        "CAM_FRONT_LEFT",
        "CAM_FRONT",
        "CAM_FRONT_RIGHT",
        "CAM_FRONT_RIGHT",
    ]


def test_a_dry_run_asks_nothing_and_says_what_a_run_would_take(
    shop: Path, stand_in: StandIn
) -> None:
    with (shop / "workshop.toml").open("a") as file:
        file.write("[prices.vision-model]\nprompt = 1000.0\ncompletion = 2000.0\n")
        file.write("[prices.editing-model]\nimage = 0.05\n")
    plan = report(shop, "screen", "--dry-run")
    assert (plan["candidates"], plan["calls"], plan["pictures"]) == (18, 18, 108)
    assert plan["timed_calls"] == 0
    assert plan["hours"] == round(18 * 10 / 8 / 3600, 3)
    assert plan["cost"] > 0
    assert stand_in.seen == []
    report(shop, "screen", "--limit", "8")
    plan = report(shop, "screen", "--dry-run")
    assert (plan["candidates"], plan["timed_calls"]) == (10, 8)
    assert plan["cost"] == pytest.approx(10 * (1000 * 1000 + 50 * 2000) / 1e6)
    assert report(shop, "screen")["cost"] == pytest.approx(plan["cost"])
    plan = report(shop, "edit", "--dry-run")
    assert plan["cost"] == pytest.approx(0.05 * plan["calls"])
    assert plan["not_ready"] == 0
    assert "guessed" in run(shop, "edit", "--dry-run").stdout


def test_a_missing_and_a_damaged_picture_stay_open_and_spoil_no_other(
    shop: Path, stand_in: StandIn
) -> None:
    with Workshop(shop) as workshop:
        first, second, _ = workshop.keyframes.values()
        workshop.image_path(first.cameras[2].image).unlink()
        workshop.image_path(second.cameras[1].image).write_bytes(b"\xff\xd8 cut off")
    done = report(shop, "screen")
    assert (done["decided"], done["still_open"]) == (6, 12)
    assert done["failed"] == {"unreadable_image": 12}
    assert "No such file" in next(iter(done["first_failures"].values()))
    assert done["calls"] == 18  # each kept, with why
    assert len(stand_in.seen) == 6


def test_two_runs_of_one_stage_do_not_both_pay(shop: Path, stand_in: StandIn) -> None:
    second: list[Result] = []

    def fault(seen: Seen) -> Reply | None:
        if not second:
            second.append(run(shop, "screen"))
        return None

    stand_in.fault = fault
    change(shop, "workshop.toml", "concurrency = 8", "concurrency = 1")
    assert report(shop, "screen", "--limit", "2")["decided"] == 2
    assert second[0].exit_code == 2
    assert "another run" in second[0].stderr
    assert len(stand_in.seen) == 2


def test_what_a_model_says_cannot_steer_a_terminal(shop: Path, stand_in: StandIn) -> None:
    answer = screen_answer(False, reason="no_room") | {"note": "\x1b]0;owned\x07 free \ud800 road"}
    stand_in.fault = lambda seen: stand_in.says(json.dumps(answer))
    assert report(shop, "screen", "--limit", "1")["decided"] == 1
    notes = [c.screened.note for c in walked(shop).values() if isinstance(c.screened, Screened)]
    assert "\x1b" not in notes[0]
    assert "free \ufffd road" in notes[0]


def test_the_auxiliary_draw_is_edited_and_in_nothing_else(shop: Path, stand_in: StandIn) -> None:
    for stage in ("screen", "edit", "review"):
        report(shop, stage)
    before = walked(shop)
    assert report(shop, "edit", "--dry-run")["candidates"] == 0
    change(shop, "workshop.toml", "draw = 0", "draw = 4")
    done = report(shop, "edit")
    drawn = [c for c in walked(shop).values() if c.place is not None and not c.is_suitable]
    assert 0 < len(drawn) == done["decided"] <= 4
    tasks = {c.task.id for c in before.values() if c.passed_review}
    assert {c.task.id for c in drawn} <= tasks
    assert all(isinstance(c.edited, Edited) and not c.is_accepted for c in drawn)
    assert report(shop, "review")["calls"] == 0
    assert [k for k, c in walked(shop).items() if c.is_accepted] == [
        k for k, c in before.items() if c.is_accepted
    ]


@pytest.mark.parametrize(
    ("views", "faults"),
    [(("CAM_FRONT", "CAM_BACK"), ()), (("CAM_BACK",), ("target_not_in_view",))],
)
def test_a_view_that_does_not_see_the_target_is_measured_as_a_whole(
    shop: Path, stand_in: StandIn, views: tuple[str, ...], faults: tuple[str, ...]
) -> None:
    where = "with its foot at 12.0 m ahead and 0.0 m to the left"
    edits = [{"view": view, "instruction": f"in {view}: {where}"} for view in views]
    stand_in.repainted, stand_in.low = 0.0, 0.0
    stand_in.fault = once(
        stand_in.says(json.dumps(screen_answer(True, target=(12.0, 0.0), edits=edits)))
    )
    report(shop, "screen", "--limit", "1")
    for stage in ("edit", "review"):
        report(shop, stage)
    (found,) = [c for c in walked(shop).values() if c.is_suitable]
    assert found.reviewed.changes["CAM_BACK"].inside is None  # type: ignore[union-attr]
    assert found.review_faults == faults
