"""What leaves the machine: images without metadata, the same text for every sample, nothing else."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest
from tests.agent.bench import KEY, Bench, made_jpeg, made_png

from exceptiondrive_schemas.protocol import packaged_protocol

if TYPE_CHECKING:
    from tests.support.chat_endpoint import ChatEndpoint, Reply, Seen

Made = Callable[..., bytes]
SAMPLES = {
    "n015-2018-07-18-SE1-0001": "task=SE1 occluded_pedestrian region=[[12.375,1.625],[14.5,1.875]]",
    "n008-2018-08-01-LB3-0002": "task=LB3 full_lane_closure region=[[21.125,-1.5],[23.75,2.25]]",
    "n008-2018-08-01-RS2-0003": "task=RS2 pothole_or_open_manhole region=[[7.0625,0.5],[8.5,0.75]]",
}
SECRET_WORDS = [
    *SAMPLES,
    "n015",
    "n008",
    "withheld-folder",
    "CAM_FRONT",
    "12.375",
    "21.125",
    "7.0625",
    "task=",
    "region=",
    "d_safe",
    "acceptable",
]
DATA_URL = re.compile(r"data:image/[a-z]+;base64,[A-Za-z0-9+/=]+")


@pytest.fixture
def secretive(bench: Bench) -> Bench:
    """Samples whose ids, folders, file names and image metadata give their task and region away."""
    bench.images = bench.folder / "withheld-folder"
    for number, (sample_id, secret) in enumerate(SAMPLES.items()):
        folder = bench.images / sample_id
        folder.mkdir(parents=True)
        note = f"{folder} {secret}".encode()
        (folder / f"{sample_id}__CAM_FRONT.png").write_bytes(made_png(number, note) + note)
        (folder / f"{sample_id}__CAM_FRONT_LEFT.jpg").write_bytes(made_jpeg(bytes([number]), note))
    bench.write_manifest(list(SAMPLES))
    return bench


@pytest.fixture
def sent(
    secretive: Bench,
    endpoint: "ChatEndpoint",
    record: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> dict[str, list["Seen"]]:
    """All requests of the three runs of the paper, by run, where OpenAI is set up besides."""
    monkeypatch.setenv("OPENAI_ORG_ID", "org-of-mine")
    monkeypatch.setenv("OPENAI_PROJECT_ID", "project-of-mine")
    monkeypatch.setenv("OPENAI_CUSTOM_HEADERS", "X-Team: mine\nAuthorization: Bearer of-mine")

    def answer(seen: "Seen") -> "Reply":
        is_reminder = "risk reminder" in seen.texts[0]
        return endpoint.says(json.dumps(record if is_reminder else {"strategy": "C"}))

    endpoint.answer = answer
    runs = {}
    for name, arguments in {
        "remind": ("remind", "--manifest", str(secretive.manifest)),
        "without": ("decide",),
        "with": (
            "decide",
            "--reminders",
            str(secretive.reminders),
            "--journal",
            journal(secretive),
        ),
    }.items():
        assert secretive.report(*arguments)["done"] == len(SAMPLES)
        runs[name] = list(endpoint.seen)
        endpoint.seen.clear()
    return runs


def journal(bench: Bench) -> str:
    return str(bench.folder / "with.jsonl")


def test_three_requests_leave_per_sample_and_no_more(sent: dict[str, list["Seen"]]) -> None:
    assert {name: len(requests) for name, requests in sent.items()} == {
        "remind": 3,
        "without": 3,
        "with": 3,
    }


def test_no_request_holds_an_id_a_path_a_file_name_or_the_metadata_of_its_images(
    sent: dict[str, list["Seen"]],
) -> None:
    for requests in sent.values():
        for seen in requests:
            everything = b"\n".join((seen.head, seen.body, *seen.images)).decode("latin-1")
            assert [word for word in SECRET_WORDS if word in everything] == []


def test_all_that_differs_between_samples_is_the_coded_pixels(
    sent: dict[str, list["Seen"]],
) -> None:
    """Whatever the text says of tasks, it says for every sample: nothing in it is about one."""
    for requests in sent.values():
        bodies = {DATA_URL.sub("<image>", seen.body.decode()) for seen in requests}
        assert len(bodies) == 1


def test_the_images_that_leave_are_the_coded_pixels_alone(sent: dict[str, list["Seen"]]) -> None:
    for requests in sent.values():
        images = sorted(seen.images for seen in requests)
        assert images == sorted(
            [made_png(number), made_jpeg(bytes([number]))] for number in range(3)
        )


def test_headers_are_the_same_for_every_sample_and_do_not_describe_this_machine(
    sent: dict[str, list["Seen"]],
) -> None:
    for requests in sent.values():
        heads = {re.sub(rb"(?i)content-length: \d+", b"", seen.head) for seen in requests}
        assert len(heads) == 1
        names = {line.partition(":")[0].lower() for line in heads.pop().decode().splitlines()[1:]}
        assert names - {""} == {
            "accept",
            "accept-encoding",
            "authorization",
            "connection",
            "content-type",
            "host",
            "user-agent",
            "x-stainless-raw-response",
        }


def test_what_the_environment_sets_for_openai_is_not_sent(sent: dict[str, list["Seen"]]) -> None:
    for requests in sent.values():
        for seen in requests:
            assert b"mine" not in seen.head + seen.body
            assert f"Bearer {KEY}".encode() in seen.head


def test_a_decision_without_reminder_is_told_no_task(sent: dict[str, list["Seen"]]) -> None:
    text = "\n".join(sent["without"][0].texts)
    for task in packaged_protocol().tasks:
        assert task.name not in text
        assert task.hazard not in text


def test_a_request_holds_the_fields_that_are_documented_and_no_others(
    sent: dict[str, list["Seen"]],
) -> None:
    for requests in sent.values():
        for seen in requests:
            assert sorted(seen.document) == [
                "max_tokens",
                "messages",
                "model",
                "response_format",
                "temperature",
            ]
            assert [m["role"] for m in seen.document["messages"]] == ["system", "user"]
            assert {part["type"] for part in seen.parts} == {"text", "image_url"}


def test_a_run_connects_to_the_endpoint_and_to_nothing_else(
    secretive: Bench, endpoint: "ChatEndpoint", record: dict[str, Any], tmp_path: Path
) -> None:
    """An audit hook inside the run writes down every name it looks up and address it connects to."""
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record))
    log = tmp_path / "connections.txt"
    program = f"""
import runpy, sys
log = open({str(log)!r}, "w", buffering=1)
def note(event, arguments):
    if event == "socket.connect":
        print("connect", arguments[1], file=log)
    if event == "socket.getaddrinfo":
        print("look up", arguments[:2], file=log)
sys.addaudithook(note)
runpy.run_module("exceptiondrive", run_name="__main__", alter_sys=True)
"""
    result = subprocess.run(
        [sys.executable, "-c", program, *secretive.arguments("remind")],
        env=os.environ | {"NO_PROXY": "127.0.0.1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    host, port = urlsplit(endpoint.base_url).hostname, urlsplit(endpoint.base_url).port
    lines = set(log.read_text(encoding="utf-8").splitlines())
    assert f"connect {(host, port)!r}" in lines
    assert lines <= {f"connect {(host, port)!r}", f"look up {(host, port)!r}"}
