"""The walls around withheld splits: imports, words, folders and what is shipped."""

import ast
import os
import re
import subprocess
import sys
from fnmatch import fnmatch
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import tomllib
from tests.support.distributions import DISTRIBUTIONS, build, names_in

from exceptiondrive import __version__
from exceptiondrive_worker.splits.private_store import PrivateStore, Shelf

ROOT = Path(__file__).parents[2]
FOLDER = "hidden_splits"
BY_NAME = re.compile(r"""["']exceptiondrive_worker["'.]""")
NAMES_A_ROLE = {"roles.py": "the worker's role in the database is called like its package"}
WITHOUT_SPLITS = ["server", "client", "schemas"]
MAY_OPEN_SPLITS = {
    "boards/entries.py": "takes the manifest's counts",
    "boards/run.py": "waits where the split is not there",
    "context.py": "opens the store",
    "jury.py": "scores planners that are known against a loaded split",
    "operator_cli.py": "checks and registers",
    "scoring_run.py": "waits where the split is not there",
    "splits/admin.py": "registers and publishes",
    "splits/floors_held.py": "opens a split as its floors allow",
    "stages.py": "takes loaded arrays",
}


def sources(folder: str) -> list[Path]:
    return [path for path in (ROOT / folder).rglob("*") if path.is_file()]


def imported_modules(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def test_no_folder_of_tests_is_left_out(pytestconfig: pytest.Config) -> None:
    """Of itself pytest goes into none that is called `build` or `dist`."""
    folders = {
        part
        for path in (ROOT / "tests").rglob("test_*.py")
        for part in path.relative_to(ROOT).parts
    }
    left_out = pytestconfig.getini("norecursedirs")
    assert [name for name in folders if any(fnmatch(name, each) for each in left_out)] == []


def test_a_conftest_holds_fixtures_alone_and_nobody_imports_it() -> None:
    """What tests and fixtures work with has a module of its own, named after what it is."""
    tests = sorted((ROOT / "tests").rglob("*.py"))
    assert len(tests) > 400
    for path in tests:
        assert not any("conftest" in name for name in imported_modules(path)), path
    for path in (ROOT / "tests").rglob("conftest.py"):
        own = [
            node.name
            for node in ast.parse(path.read_text()).body
            if isinstance(node, ast.ClassDef | ast.FunctionDef)
            and not any("fixture" in ast.unparse(each) for each in node.decorator_list)
            and not node.name.startswith("pytest_")
        ]
        assert own == [], path


def test_the_import_contracts_hold() -> None:
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_no_module_imports_in_a_circle() -> None:
    """Deferred imports count, too; `CycleError` names the modules of a circle in order."""
    paths = {
        ".".join(path.relative_to(ROOT / root).with_suffix("").parts).removesuffix(
            ".__init__"
        ): path
        for root in ("schemas", "worker", "server", "client")
        for path in (ROOT / root).rglob("*.py")
    }
    imports = {
        name: {found for found in imported_modules(path) if found in paths and found != name}
        for name, path in paths.items()
    }
    assert len(imports) > 100
    TopologicalSorter(
        {name: found - {name.rpartition(".")[0]} for name, found in imports.items()}
    ).prepare()


def test_no_nouns_of_the_server_stand_on_each_other_in_a_circle() -> None:
    """`web` is wired to two of them, and what starts or operates a server knows them all."""
    server = ROOT / "server" / "exceptiondrive_server"
    nouns = {path.parent.name for path in server.glob("*/__init__.py")} - {"web"}
    stands_on: dict[str, set[str]] = {noun: set() for noun in nouns}
    for noun in nouns:
        for path in (server / noun).rglob("*.py"):
            ours = [
                name for name in imported_modules(path) if name.startswith("exceptiondrive_server.")
            ]
            stands_on[noun] |= {name.split(".")[1] for name in ours} & nouns - {noun}
    TopologicalSorter(stands_on).prepare()


def test_private_names_are_used_in_their_own_module_alone() -> None:
    used = []
    for root in ("schemas", "worker", "server", "client"):
        for path in (ROOT / root).rglob("*.py"):
            tree = ast.parse(path.read_text("utf-8"))
            modules = {
                alias.asname or alias.name.rpartition(".")[2]
                for node in ast.walk(tree)
                if isinstance(node, ast.Import | ast.ImportFrom)
                for alias in node.names
            }
            used += [
                f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)}"
                for node in ast.walk(tree)
                if isinstance(node, ast.Attribute | ast.ImportFrom)
                and is_private_of_another(node, modules)
            ]
    assert used == []


PRIVATE = re.compile(r"_(?!_|fields$|asdict$|replace$)")
"""All but the public names of a `NamedTuple`."""
OF_PYTHON = {"os._exit": "ends a process that was forked, without what its parent would do"}


def is_private_of_another(node: ast.Attribute | ast.ImportFrom, modules: set[str]) -> bool:
    if isinstance(node, ast.ImportFrom):
        names = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
        return any(PRIVATE.match(name) for name in names)
    return (
        PRIVATE.match(node.attr) is not None
        and isinstance(node.value, ast.Name)
        and node.value.id in modules
        and ast.unparse(node) not in OF_PYTHON
    )


def test_the_client_names_the_reminder_agent_only_in_its_table_of_commands() -> None:
    client = ROOT / "client" / "exceptiondrive"
    naming = {
        path.relative_to(client).as_posix()
        for path in client.rglob("*.py")
        if "exceptiondrive_agent" in path.read_text("utf-8")
    }
    assert naming == {"cli/__init__.py"}


@pytest.mark.parametrize("folder", WITHOUT_SPLITS)
def test_the_folder_of_splits_is_not_even_named_elsewhere(folder: str) -> None:
    files = [path for path in sources(folder) if path.suffix != ".pyc"]
    assert files
    naming = [path for path in files if FOLDER.encode() in path.read_bytes()]
    assert naming == []


@pytest.mark.parametrize("folder", WITHOUT_SPLITS)
def test_nothing_outside_imports_the_worker_by_name_at_run_time(folder: str) -> None:
    """Import contracts do not see `import_module("exceptiondrive_worker...")`."""
    naming = [
        path
        for path in sources(folder)
        if path.suffix == ".py"
        and path.name not in NAMES_A_ROLE
        and BY_NAME.search(path.read_text("utf-8"))
    ]
    assert naming == []


def test_few_modules_of_the_worker_touch_the_split_store() -> None:
    worker = ROOT / "worker" / "exceptiondrive_worker"
    touching = {
        path.relative_to(worker).as_posix()
        for path in worker.rglob("*.py")
        if "exceptiondrive_worker.splits.store" in imported_modules(path)
    }
    assert touching == MAY_OPEN_SPLITS.keys()


def test_no_split_is_opened_past_its_floors() -> None:
    """Whether a split fits a protocol tells of its regions: `open_split` asks the floors first."""
    worker = ROOT / "worker" / "exceptiondrive_worker"
    opening = {
        path.relative_to(worker).as_posix()
        for path in worker.rglob("*.py")
        if "splits.find(" in path.read_text("utf-8")
    }
    assert opening == {
        "splits/floors_held.py",
        "scoring_run.py",  # whether it is there: nothing of it is told, and the job asks the floors
        "verify_run.py",  # under what a worker has scored it already
    }


def test_only_the_split_store_and_the_sample_read_split_files() -> None:
    """`Split` is the document with regions: who validates one, opens one."""
    reading = {
        path.relative_to(ROOT).as_posix()
        for folder in ("worker", "server", "client", "schemas")
        for path in (ROOT / folder).rglob("*.py")
        if "Split.model_validate" in path.read_text("utf-8")
    }
    server_side = {path for path in reading if path.startswith("server/")}
    assert server_side == set()
    assert "worker/exceptiondrive_worker/splits/store.py" in reading


def test_the_repository_holds_no_split_but_the_sample() -> None:
    listed = subprocess.run(
        ["git", "ls-files", FOLDER], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    assert sorted(listed.stdout.split()) == [
        f"{FOLDER}/README.md",
        f"{FOLDER}/sample/datasheet.json",
        f"{FOLDER}/sample/floors.toml",
        f"{FOLDER}/sample/split.json.gz",
    ]


@pytest.mark.parametrize(
    "path", [f"{FOLDER}/real/split.json.gz", "secrets/postgres_password", ".env", "data/x"]
)
def test_git_ignores_a_real_split_secrets_and_records(path: str) -> None:
    done = subprocess.run(
        ["git", "check-ignore", path], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode == 128:
        pytest.skip("not a git checkout")
    assert done.stdout.strip() == path


def read_as_nobody(path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["cat", str(path)],
        user=65534,
        group=65534,
        extra_groups=[],
        capture_output=True,
        text=True,
        check=False,
    )


def test_another_user_cannot_read_the_private_store(open_folder: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root can become another user")
    public = open_folder / "public"
    public.write_text("anyone may read this")
    assert read_as_nobody(public).stdout == "anyone may read this"
    store = PrivateStore(open_folder / "private")
    store.write(Shelf.SETTLED, "k", b"{}")
    (store.root / Shelf.SETTLED / "k").chmod(0o644)  # the folder alone must be enough
    refused = read_as_nobody(store.root / Shelf.SETTLED / "k")
    assert refused.returncode != 0
    assert "Permission denied" in refused.stderr


@pytest.fixture(scope="module", params=["client", "server", "worker"])
def archives(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[str]]:
    """The names in wheel and source archive of a distribution."""
    distribution: str = request.param
    folder = tmp_path_factory.mktemp("dist")
    return {path.suffix: names_in(path) for path in build(distribution, folder)}


@pytest.mark.row("I27")
def test_no_archive_holds_a_split(archives: dict[str, list[str]]) -> None:
    assert set(archives) == {".whl", ".gz"}
    for names in archives.values():
        assert any(name.endswith("/__init__.py") for name in names)
        assert not [name for name in names if FOLDER in name or name.endswith("split.json.gz")]


def test_no_file_is_in_two_distributions(tmp_path: Path) -> None:
    wheels = {name: build(name, tmp_path, "wheel")[0] for name in DISTRIBUTIONS}
    packages = {
        name: sorted({path.split("/")[0] for path in names_in(wheel) if ".dist-info/" not in path})
        for name, wheel in wheels.items()
    }
    assert packages == {
        "client": [
            "exceptiondrive",
            "exceptiondrive_agent",
            "exceptiondrive_endpoints",
            "exceptiondrive_schemas",
            "exceptiondrive_scoring",
        ],
        "server": ["exceptiondrive_records", "exceptiondrive_server"],
        "worker": ["exceptiondrive_build", "exceptiondrive_worker"],
    }


def test_the_distributions_ask_for_each_other_in_one_version() -> None:
    for folder, wanted in {
        "server": {"exceptiondrive"},
        "worker": {"exceptiondrive", "exceptiondrive-server"},
    }.items():
        project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text("utf-8"))["project"]
        ours = {each for each in project["dependencies"] if each.startswith("exceptiondrive")}
        assert ours == {f"{name}=={__version__}" for name in wanted}
