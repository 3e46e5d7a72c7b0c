"""Protocol, quick start, help and API pages."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from tests.server.pages.reading import read

from exceptiondrive import check_file, recorder
from exceptiondrive.transport import error_of
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.api.problems import Problem, ProblemCode
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.faults import FaultCode
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.protocol import (
    NEWEST,
    ProtocolDocument,
    packaged_protocol,
    packaged_protocol_toml,
)
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS

MANIFEST_OF_TWO = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="two",
    title="Two",
    revision="sha256:" + "0" * 64,
    waypoints=6,
    time_step_s=0.5,
    sample_ids=("s0", "s1"),
)


async def test_without_a_phase_protocols_lead_to_the_newest_version(site: Any) -> None:
    answer = await site.get("/protocols")
    assert (answer.status_code, answer.headers["location"]) == (307, f"/protocols/{NEWEST}")


async def test_the_protocol_page_says_every_task_and_the_values_of_the_document(
    lively_site: Any, protocol: ProtocolDocument
) -> None:
    text = (await lively_site.get("/protocols/1.0")).text
    for task in protocol.tasks:
        assert f"<code>{task.id}</code>" in text
        assert task.hazard in text
    for value in ("4.084 m by 1.85 m", "1.486 m", "1,000 bootstrap draws", "seed 20261120"):
        assert value in text
    assert protocol.digest in text


async def test_the_protocol_page_says_which_flags_take_a_rank_and_when_they_are_raised(
    site: Any,
) -> None:
    with site.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), "test")
    for version in ("1.0", "1.1"):
        site.create_phase(f"under-{version[-1]}", protocol=version)
    text = " ".join((await site.get("/protocols/1.1")).text.split())
    codes = packaged_protocol("1.1").ranking.unranked_flags
    labels = ", ".join(FLAGS[code].label for code in codes)
    assert "Stands still" in labels
    assert f"listed with its numbers, and takes no rank: {labels}." in text
    assert [kind.code for kind in FLAGS.values() if f"<b>{kind.label}" not in text] == []
    assert (
        "A mean over fewer than 5 scenes has no interval, nor has a mean of families one of which has fewer."
        in text
    )
    assert "At most 2 decimals of per cent and 2 of metres leave the server" in text
    assert "Of a withheld split, intervals of shares end at whole per cents, outward" in text
    assert "more than 5 m from the drive that was recorded" in text
    assert "less than 10 % in a family of at least 20 samples" in text
    assert "takes no rank" not in (await site.get("/protocols/1.0")).text


async def test_required_clearances_of_the_protocol_page_are_scaled_and_not_rounded(
    site: Any,
) -> None:
    text = packaged_protocol_toml("1.0").replace('version = "1.0"', 'version = "1.5"')
    with site.database.write() as session:
        add_protocol(session, text.replace("d_safe_scale = 1.0", "d_safe_scale = 1.5"), "test")
    site.create_phase("scaled", protocol="1.5")
    page = " ".join((await site.get("/protocols/1.5")).text.split())
    shown = set(re.findall(r"</svg>\s*([\d.]+)\s*m\s*</td>", page))
    assert shown == {f"{1.5 * task.d_safe_m:g}" for task in packaged_protocol("1.0").tasks}


async def test_the_page_of_a_protocol_says_what_differs_from_the_one_before(site: Any) -> None:
    site.create_phase("first", protocol="1.0")
    with site.database.write() as session:
        add_protocol(session, packaged_protocol_toml("1.1"), "test")
    site.create_phase("second", protocol="1.1")
    page = (await site.get("/protocols/1.1")).text.split("What differs from 1.0</h2>")[1]
    assert "<li>fewest scenes for an interval 2 -&gt; 5</li>" in page
    assert "What differs" not in (await site.get("/protocols/1.0")).text


async def test_an_unknown_protocol_is_not_found(lively_site: Any) -> None:
    assert (await lively_site.get("/protocols/9.9")).status_code == 404


async def test_the_quick_start_shows_real_commands_of_an_open_phase(lively_site: Any) -> None:
    text = (await lively_site.get("/submit")).text
    assert "exceptiondrive submit planner.json.gz <i>--phase</i> sample" in text, "in one piece"
    assert "exceptiondrive.planning/1" in text
    assert "exceptiondrive.strategy/1" in text
    assert "/api/v1/schemas/planning" in text
    assert "exceptiondrive remind" not in text


async def test_the_quick_start_of_the_strategy_challenge_speaks_of_answers(shown_site: Any) -> None:
    text = (await shown_site.get("/submit?phase=strategy")).text
    assert "exceptiondrive submit agent.json.gz <i>--phase</i> strategy" in text
    assert "StrategyRecorder" in text
    start = text[text.index("<h1") : text.index('id="hp"')]
    assert "planner" not in start
    assert "<code>exceptiondrive remind</code> and <code>exceptiondrive decide</code>" in start
    assert '<a href="/submit?phase=strategy" aria-current="true">Strategy</a>' in text
    assert '<a href="/submit?phase=sample">Planning</a>' in text


def test_the_programs_of_the_quick_start_write_files_that_pass(tmp_path: Path) -> None:
    (tmp_path / "recorder.py").write_text(Path(recorder.__file__).read_text())
    manifest = MANIFEST_OF_TWO
    (tmp_path / "manifest.json").write_text(manifest.model_dump_json(by_alias=True))
    for challenge in CHALLENGES.values():
        code = challenge.words.code
        command = [sys.executable, "-c", code.program, "manifest.json", code.file]
        subprocess.run(command, cwd=tmp_path, check=True)
        report = check_file(tmp_path / code.file, manifest=manifest)
        assert (report.is_valid, report.challenge) == (True, challenge.id)


async def test_the_quick_start_leads_to_the_client_where_the_server_holds_it(
    lively_site: Any, tmp_path: Path
) -> None:
    without = (await lively_site.get("/submit")).text
    assert "/client/" not in read(without).one("ol", "start").text + "".join(links_of(without))
    assert "ask the organizers where to get it" in without
    assert "pip install" not in without, "an index may give anybody's package of that name"
    services = lively_site.app.state.services
    services.settings = services.settings.model_copy(update={"client_dir": tmp_path})
    with zipfile.ZipFile(tmp_path / "exceptiondrive-9.9-py3-none-any.whl", "w") as archive:
        archive.writestr("exceptiondrive-9.9.dist-info/METADATA", "Requires-Python: >=3.10\n")
        archive.writestr("exceptiondrive/recorder.py", "")
    text = (await lively_site.get("/submit")).text
    assert {"/client/", "/client/recorder.py"} <= links_of(text)
    assert (
        text.count("pip install") == text.count("exceptiondrive-9.9-py3-none-any.whl#sha256=") > 0
    )
    assert (await lively_site.get("/client/recorder.py")).status_code == 200


def links_of(text: str) -> set[str]:
    return set(re.findall(r'href="([^"]+)"', text))


async def test_the_quick_start_works_before_any_phase_exists(site: Any) -> None:
    assert (await site.get("/submit")).status_code == 200


@pytest.mark.parametrize("code", list(ProblemCode))
async def test_every_problem_has_a_help_page(shown_site: Any, code: ProblemCode) -> None:
    answer = await shown_site.get(f"/problems/{code.value}")
    assert answer.status_code == 200
    assert PROBLEMS[code].title in answer.text


async def test_of_a_problem_that_the_client_alone_says_no_answer_is_shown(shown_site: Any) -> None:
    text = (await shown_site.get("/problems/file_invalid")).text
    assert "As the server answers it" not in text
    assert "the submission becomes <code>rejected</code>" in text
    assert "As the server answers it" in (await shown_site.get("/problems/bad_request")).text


def test_every_problem_is_explained_with_at_least_one_step() -> None:
    assert set(PROBLEMS) == set(ProblemCode)
    assert all(help_.steps and help_.happened for help_ in PROBLEMS.values())


def test_the_exit_code_of_every_problem_is_what_the_client_ends_with() -> None:
    for code, kind in PROBLEMS.items():
        problem = Problem(type="", title="", status=kind.status, code=code, detail="")
        assert error_of(problem).exit_code == kind.exit_code, code


@pytest.mark.parametrize("code", list(FaultCode))
async def test_every_fault_of_a_file_has_a_page_with_the_checkers_report(
    shown_site: Any, code: FaultCode
) -> None:
    answer = await shown_site.get(f"/problems/{code.value}")
    assert answer.status_code == 200
    assert "Expected" in answer.text
    assert "Got" in answer.text
    assert "`" not in answer.text, "commands are set as code"


async def test_the_index_leads_to_every_code(shown_site: Any) -> None:
    text = (await shown_site.get("/problems")).text
    linked = set(re.findall(r'href="/problems/([a-z_0-9]+)"', text))
    assert linked == {code.value for code in (*ProblemCode, *FaultCode)}


async def test_an_unknown_problem_is_not_found(shown_site: Any) -> None:
    assert (await shown_site.get("/problems/nonsense")).status_code == 404


async def test_a_page_of_a_problem_tells_a_reader_what_to_do_without_a_client(site: Any) -> None:
    assert all(problem.steps for problem in PROBLEMS.values())
    text = (await site.get("/?phase=unknown")).text
    assert "Check the address." in text
    assert "exceptiondrive " not in text


async def test_the_board_says_how_to_install_the_client_that_this_server_holds(
    lively_site: Any, tmp_path: Path
) -> None:
    assert "pip install" not in (await lively_site.get("/?sort=ur")).text  # it holds none
    services = lively_site.app.state.services
    services.settings = services.settings.model_copy(update={"client_dir": tmp_path})
    with zipfile.ZipFile(tmp_path / "exceptiondrive-9.9-py3-none-any.whl", "w") as archive:
        archive.writestr("exceptiondrive-9.9.dist-info/METADATA", "Requires-Python: >=3.10\n")
    text = read((await lively_site.get("/")).text).one("pre", "term").text
    found = re.search(r'pip install "exceptiondrive @ http://site.test(/client/[^"#]+)#', text)
    assert found is not None
    assert (await lively_site.get(found[1])).status_code == 200
    assert "exceptiondrive login --server http://site.test" in text
