"""Whatever a public call is given, it raises an `ExceptionDriveError` and nothing else."""

import inspect
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import exceptiondrive
from exceptiondrive import (
    Client,
    ExceptionDriveError,
    InvalidArgumentError,
    Recorder,
    RecorderError,
    check_file,
    evaluate_file,
    evaluate_samples,
    to_dataframe,
)
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.published import example_text

if TYPE_CHECKING:
    from tests.client.servers import Running

MakeFile = Callable[..., Path]
VIEW = SubmissionView.read(example_text("submission"))
WRONG: list[Any] = [3, None, "", "no such", "\0", object(), {}, [], float("nan"), b"x", VIEW]
CALLBACKS = {"on_progress", "before_upload"}
TAKES_DOCUMENTS = {"protocol_of"}
METHODS = [
    name
    for name, _ in inspect.getmembers(Client, inspect.isfunction)
    if not name.startswith("_") and name not in ("close", *TAKES_DOCUMENTS)
]


def test_every_method_of_the_client(running: "Running", planning_file: MakeFile) -> None:
    sound: dict[str, Any] = {"phase": "dev", "method": "m", "file": planning_file()}
    assert len(METHODS) > 30
    with running.client() as client:
        for name in METHODS:
            wanted = inspect.signature(getattr(client, name)).parameters.values()
            given = {
                each.name: sound.get(each.name, "x")
                for each in wanted
                if each.default is inspect.Parameter.empty
            }
            for argument in {each.name for each in wanted} - CALLBACKS:
                for wrong in WRONG:
                    may_refuse(getattr(client, name), **{**given, argument: wrong})


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: type(wrong).__name__)
def test_what_works_on_files(wrong: Any, planning_file: MakeFile, split_file: Path) -> None:
    columns = {"sample_id": wrong, "source": wrong, "edited": wrong}
    for file in (wrong, columns, {"sample_id": ["s0"], "source": wrong}, {"predictions": wrong}):
        may_refuse(check_file, file)
        may_refuse(evaluate_file, file, split=split_file)
        may_refuse(evaluate_samples, file, split=split_file)
    may_refuse(evaluate_file, planning_file(), split=wrong)
    may_refuse(check_file, planning_file(), manifest=wrong)
    may_refuse(Client, wrong)
    may_refuse(Client, token=wrong)


@pytest.mark.parametrize("wrong", [3, None, "a", b"x", {}, [1], ["a"], object(), [VIEW, 3]])
def test_what_is_no_table_is_named(wrong: Any) -> None:
    with pytest.raises(InvalidArgumentError, match="nothing that becomes a table") as refused:
        to_dataframe(wrong)
    assert "a board, a score sheet" in refused.value.advice


@pytest.mark.parametrize(
    "wrong", [{"attempts": 0}, {"attempts": "3"}, {"timeout_s": 0}, {"timeout_s": "5"}]
)
def test_attempts_and_the_timeout_are_numbers_that_let_a_request_be_sent(
    wrong: dict[str, Any],
) -> None:
    ((name, value),) = wrong.items()
    with pytest.raises(InvalidArgumentError, match=f"{name} is a .*, not {value!r}"):
        Client("http://127.0.0.1:9", **wrong)


@pytest.mark.parametrize("name", exceptiondrive.__all__)
def test_who_names_arguments_in_a_docstring_names_all_of_them(name: str) -> None:
    public = getattr(exceptiondrive, name)
    told = {name: public}
    if inspect.isclass(public):
        told |= {key: each for key, each in vars(public).items() if not key.startswith("_")}
    for each in filter(callable, told.values()):
        text = inspect.getdoc(each) or ""
        assert text, each
        for argument in inspect.signature(each).parameters if "Args:" in text else ():
            assert argument == "self" or f"    {argument}: " in text, (each, argument)


def test_a_recording_that_cannot_be_opened_says_so(tmp_path: Path) -> None:
    no_path: Any = 3
    for path in (no_path, tmp_path / "no folder" / "run.json.gz", tmp_path / ("a" * 900)):
        with pytest.raises(RecorderError, match=r"named by a path|cannot be written"):
            Recorder(path, split="tiny")


def test_a_number_of_submissions_that_is_none_is_refused() -> None:
    not_whole: Any = 1.5
    with Client("http://127.0.0.1:9") as client:
        for limit in (-1, not_whole):
            with pytest.raises(InvalidArgumentError, match=f"None for all, not {limit}"):
                client.submissions(limit=limit)


def test_a_status_and_a_subscription_may_be_a_text(running: "Running") -> None:
    with running.client() as client:
        assert client.submissions(status="scored") == ()
        with pytest.raises(ExceptionDriveError):
            client.submissions(status="score")
        contact = client.add_contact("https://example.org/hook", "scored")
        assert contact["wishes"] == ["scored"]


def test_a_view_is_short_and_says_what_is_known() -> None:
    shown = repr(VIEW)
    assert len(shown) < 700
    assert f"id={VIEW.id!r}" in shown
    assert "None" not in shown


def may_refuse(call: Callable[..., object], *args: Any, **kwargs: Any) -> None:
    """Let it succeed, or be refused in words: anything else is raised and fails the test."""
    with suppress(ExceptionDriveError):
        call(*args, **kwargs)
