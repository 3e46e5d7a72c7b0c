import gzip
import io
import json
import lzma
import math
import os
import pickle
import shutil
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from exceptiondrive import pair_files
from exceptiondrive.checking import write_file
from exceptiondrive.conversion import RawPair, submission_text
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.pair_files import read_pairs
from exceptiondrive.recorder import Recorder

SIX = tuple((float(step), 0.5) for step in range(1, 7))
LISTS = [list(point) for point in SIX]
PAIR = RawPair("s1", source=SIX, edited=None)
PREDICTION = {"sample_id": "s1", "source": LISTS, "edited": None}
DOCUMENT = {"schema": "exceptiondrive.planning/1", "split": "sample", "predictions": [PREDICTION]}


def written(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_submission_file_is_read_with_its_split(tmp_path: Path) -> None:
    path = written(tmp_path, "a.json", json.dumps(DOCUMENT))
    assert read_pairs([path]) == ((PAIR,), "sample")


def test_gzip_is_recognised_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(gzip.compress(json.dumps(DOCUMENT).encode()))
    assert read_pairs([path]) == ((PAIR,), "sample")


def test_a_bare_list_and_json_lines_are_read(tmp_path: Path) -> None:
    bare = written(tmp_path, "a.json", json.dumps([PREDICTION]))
    lines = written(
        tmp_path, "b.jsonl", "".join(json.dumps(PREDICTION | {"sample_id": i}) + "\n" for i in "xy")
    )
    assert read_pairs([bare]) == ((PAIR,), None)
    assert [pair.sample_id for pair in read_pairs([lines])[0]] == ["x", "y"]


def test_one_json_line_is_read(tmp_path: Path) -> None:
    assert read_pairs([written(tmp_path, "a.jsonl", json.dumps(PREDICTION))]) == ((PAIR,), None)


def test_the_journal_of_a_dead_run_is_read(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "p.json", split="sample")
    recorder.add("s1", source=LISTS, edited=None)
    recorder.close()
    assert read_pairs([Path(recorder.journal_path)]) == ((PAIR,), "sample")


def test_shards_become_one(tmp_path: Path) -> None:
    first = written(tmp_path, "0.jsonl", json.dumps(PREDICTION))
    second = written(tmp_path, "1.jsonl", json.dumps(PREDICTION | {"sample_id": "s2"}))
    assert [pair.sample_id for pair in read_pairs([first, second])[0]] == ["s1", "s2"]
    with pytest.raises(InvalidArgumentError, match="s1 occurs twice"):
        read_pairs([first, first])


@pytest.mark.parametrize(
    "text",
    [
        '{"s1": {"source": [], "edited": null}, "s1": {"source": null, "edited": null}}',
        '{"sample_id": "s1", "source": [], "edited": null, "s1": 0, "s1": 1}',
        '{"schema": "exceptiondrive.planning/1", "split": "x", "s1": 0, "s1": 1, "predictions": []}',
    ],
)
def test_a_key_that_stands_twice_loses_no_answer(tmp_path: Path, text: str) -> None:
    with pytest.raises(InvalidArgumentError, match="s1 occurs twice in one object"):
        read_pairs([written(tmp_path, "a.json", text)])


def test_csv_is_read_in_any_order_of_rows(tmp_path: Path) -> None:
    rows = [f"s1,source,{step},{x},{y}" for step, (x, y) in enumerate(SIX, start=1)]
    text = "sample_id,trajectory,step,x_m,y_m\n" + "\n".join(reversed(rows)) + "\n"
    assert read_pairs([written(tmp_path, "a.csv", text)]) == ((PAIR,), None)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32"])
def test_tabs_between_cells_are_read_in_every_encoding(encoding: str, tmp_path: Path) -> None:
    """As spreadsheets write "Unicode text"."""
    rows = [f"s1,source,{step},{x},{y}" for step, (x, y) in enumerate(SIX, start=1)]
    path = tmp_path / "a.txt"
    path.write_bytes((HEADER + "\n".join(rows)).replace(",", "\t").encode(encoding))
    assert read_pairs([path]) == ((PAIR,), None)


def test_a_trajectory_of_empty_cells_is_null_as_in_every_other_form(tmp_path: Path) -> None:
    rows = "".join(f"s1,source,{step},0.5,0.3\ns1,edited,{step},,\n" for step in (1, 2))
    (read,), _ = read_pairs([written(tmp_path, "a.csv", HEADER + rows)])
    assert read == RawPair("s1", ((0.5, 0.3),) * 2, None)


def test_a_row_of_csv_with_more_cells_than_the_head_is_refused(tmp_path: Path) -> None:
    """Decimal commas between commas: x would be 0 and y the digits behind its comma."""
    path = written(tmp_path, "a.csv", f"{HEADER}s1,source,1,0,5,0,3\n")
    with pytest.raises(InvalidArgumentError, match=r"line 2 has 7 cells, the first line 5"):
        read_pairs([path])
    empty = written(tmp_path, "b.csv", f"{HEADER}s1,source,1,0.5,0.3,,\n")
    assert read_pairs([empty])[0][0].source == ((0.5, 0.3),), "empty cells hold nothing"


def test_lists_of_predictions_that_cat_made_one_file_of_are_read(tmp_path: Path) -> None:
    shards = [json.dumps([{"sample_id": name, "source": None, "edited": None}]) for name in "ab"]
    pairs, _ = read_pairs([written(tmp_path, "cat.json", "".join(shards))])
    assert [each.sample_id for each in pairs] == ["a", "b"]


def test_blanks_in_csv_are_passed_over(tmp_path: Path) -> None:
    rows = "".join(f"s1 , source, {step}, {x}, {y}\n" for step, (x, y) in enumerate(SIX, start=1))
    path = written(tmp_path, "a.csv", f"sample_id, trajectory, step, x_m, y_m\n{rows}")
    assert read_pairs([path]) == ((PAIR,), None)


@pytest.mark.parametrize("empty", ["", " ", "nan", "NaN", "NULL"])
def test_an_empty_cell_is_a_number_that_is_missing(tmp_path: Path, empty: str) -> None:
    path = written(tmp_path, "a.csv", f"{HEADER}s1,source,1,1,0\ns1,source,2,{empty},{empty}\n")
    ((pair,), _) = read_pairs([path])
    assert pair.source is not None
    assert pair.source[0] == (1.0, 0.0)
    assert all(math.isnan(number) for number in pair.source[1])


def test_a_data_frame_with_gaps_is_read_of_csv_and_of_parquet(tmp_path: Path) -> None:
    frame = pd.DataFrame(
        {
            "sample_id": ["s1"] * 2,
            "trajectory": ["source"] * 2,
            "step": [1, 2],
            "x_m": [1.0, np.nan],
            "y_m": [0.0, np.nan],
        }
    )
    frame.to_csv(tmp_path / "a.csv", index=False)
    frame.to_parquet(tmp_path / "a.parquet")
    for name in ("a.csv", "a.parquet"):
        ((pair,), _) = read_pairs([tmp_path / name])
        assert pair.source is not None
        assert [math.isnan(number) for point in pair.source for number in point] == [
            *(False, False),
            *(True, True),
        ]


def test_csv_may_carry_headings_and_t_0(tmp_path: Path) -> None:
    text = "sample_id,trajectory,step,x_m,y_m,heading_rad\ns1,edited,0,0,0,0.1\ns1,edited,1,1,0,0.2"
    pairs, _ = read_pairs([written(tmp_path, "a.csv", text)])
    assert pairs[0].edited == ((0.0, 0.0, 0.1), (1.0, 0.0, 0.2))


def test_a_null_among_the_waypoints_is_a_number_that_is_missing(tmp_path: Path) -> None:
    holed = [LISTS[0], None, *LISTS[2:]]
    path = written(tmp_path, "a.jsonl", json.dumps(PREDICTION | {"source": holed}))
    (found,), _ = read_pairs([path])
    assert found.source is not None
    assert [at for at, point in enumerate(found.source) if math.isnan(point[0])] == [1]


def test_an_object_by_sample_id_is_read(tmp_path: Path) -> None:
    sides = {"source": LISTS, "edited": None}
    by_id = written(tmp_path, "a.json", json.dumps({"s1": sides}))
    inside = written(tmp_path, "b.json", json.dumps(DOCUMENT | {"predictions": {"s1": sides}}))
    assert read_pairs([by_id]) == ((PAIR,), None)
    assert read_pairs([inside]) == ((PAIR,), "sample")


def test_one_of_several_modes_is_taken_where_it_is_said(tmp_path: Path) -> None:
    other = [[0.0, 0.0]] * 6
    several = written(tmp_path, "a.json", json.dumps([PREDICTION | {"source": [other, LISTS]}]))
    told: list[str] = []
    assert read_pairs([several], mode=1, on_form=told.append) == ((PAIR,), None)
    assert told[1:] == ["mode 1 of 2"]
    arrays = tmp_path / "a.npz"
    np.savez(
        arrays, sample_id=["s1"], source=[[LISTS, LISTS]], edited=np.full((1, 2, 6, 2), np.nan)
    )
    assert read_pairs([arrays], mode=1) == ((PAIR,), None)
    for mode in (None, 2):
        with pytest.raises(InvalidArgumentError, match="s1: source has 2 modes") as caught:
            read_pairs([several], mode=mode)
        assert "--mode N, from 0 to 1" in caught.value.advice
    single = written(tmp_path, "b.json", json.dumps([PREDICTION | {"source": [LISTS]}]))
    assert read_pairs([single]) == ((PAIR,), None)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(DOCUMENT).encode())
    assert read_pairs([path]) == ((PAIR,), "sample")


def test_null_in_a_trajectory_is_no_number(tmp_path: Path) -> None:
    path = written(tmp_path, "a.json", json.dumps([PREDICTION | {"source": [[1, None], [1, 2]]}]))
    source = read_pairs([path])[0][0].source
    assert source is not None
    assert math.isnan(source[0][1])


def test_arrays_are_read_and_objects_in_them_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    missing = np.full((1, 6, 2), np.nan)
    np.savez(path, sample_id=np.array(["s1"]), source=np.array([LISTS]), edited=missing)
    assert read_pairs([path]) == ((PAIR,), None)
    np.savez(path, sample_id=np.array([b"s1"]), source=np.array([LISTS]), edited=missing)
    assert read_pairs([path]) == ((PAIR,), None), "ids as bytes"
    np.savez(path, sample_id=np.array(["s1"], dtype=object), source=missing, edited=missing)
    with pytest.raises(InvalidArgumentError, match=r"dtype=str and NaN .*: Object arrays"):
        read_pairs([path])
    np.savez(path, sample_id=np.array(["s1"]))
    needed = "has no array source, edited; there must be sample_id, source, edited"
    with pytest.raises(InvalidArgumentError, match=needed) as caught:
        read_pairs([path])
    assert "--source-run FILE --edited-run FILE" in caught.value.advice
    for ids in (np.array("s1"), np.array(["s1", "s2"])):
        np.savez(path, sample_id=ids, source=missing, edited=missing)
        with pytest.raises(InvalidArgumentError, match="must have as many rows each"):
            read_pairs([path])
    with path.open("wb") as one_array:
        np.save(one_array, missing)
    with pytest.raises(InvalidArgumentError, match="one array without names"):
        read_pairs([path])


def huge_array() -> bytes:
    """An NPZ of some hundred bytes whose array says that it has a million million numbers."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as members:
        members.writestr("sample_id.npy", header.getvalue())
    return packed.getvalue()


def encrypted() -> bytes:
    """An NPZ that says that its one member is encrypted."""
    packed = io.BytesIO()
    np.savez(packed, sample_id=np.array(["s1"]))
    data = bytearray(packed.getvalue())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    return bytes(data)


BROKEN = {
    "encrypted": encrypted(),
    "cut gzip": gzip.compress(json.dumps(DOCUMENT).encode())[:-12],
    "gzip of noise": b"\x1f\x8b\x08\0\0\0\0\0\0\x03" + b"noise" * 9,
    "broken archive": b"PK\x03\x04" + b"noise" * 9,
    "huge array": huge_array(),
    "huge field": b"sample_id,trajectory,step,x_m,y_m\n" + b"s" * 140_000 + b",source,1,0,0\n",
}
BROKEN_WORDS = {
    "cut gzip": "gzip that stops before its end: was its writing or copying cut off",
    "gzip of noise": "gzip that is damaged: compress it again",
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_file_is_named_without_a_traceback(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "mine"
    path.write_bytes(BROKEN[kind])
    with pytest.raises(InvalidArgumentError, match=f"mine: .*{BROKEN_WORDS.get(kind, '')}"):
        read_pairs([path])


def test_no_more_is_inflated_than_a_file_may_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pair_files, "MOST_BYTES", 10_000)
    path = tmp_path / "mine"
    path.write_bytes(gzip.compress(b" " * 20_000))
    with pytest.raises(InvalidArgumentError, match="in parts"):
        read_pairs([path])
    wide = np.zeros((20_000,))
    np.savez_compressed(path.with_suffix(".npz"), sample_id=wide, source=wide, edited=wide)
    with pytest.raises(InvalidArgumentError, match="in parts"):
        read_pairs([path.with_suffix(".npz")])


def parquet(path: Path, columns: Mapping[str, Any]) -> Path:
    pq.write_table(pa.table(columns), path)
    return path


def test_parquet_is_read_a_waypoint_a_row(tmp_path: Path) -> None:
    columns = {
        "sample_id": ["s1"] * 6,
        "trajectory": ["source"] * 6,
        "step": list(range(6, 0, -1)),
        "x_m": [x for x, _ in reversed(SIX)],
        "y_m": [y for _, y in reversed(SIX)],
    }
    assert read_pairs([parquet(tmp_path / "a.parquet", columns)]) == ((PAIR,), None)
    headings = {**columns, "heading_rad": [0.0] * 6}
    (pair,), _ = read_pairs([parquet(tmp_path / "b.parquet", headings)])
    assert pair.source == tuple((*point, 0.0) for point in SIX)


def test_parquet_is_read_a_prediction_a_row(tmp_path: Path) -> None:
    columns = {"sample_id": ["s1"], "source": [LISTS], "edited": [None]}
    assert read_pairs([parquet(tmp_path / "a.parquet", columns)]) == ((PAIR,), None)


def test_a_data_frame_of_pandas_saved_as_parquet_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    rows = [{"sample_id": "s1", "source": [np.array(point) for point in SIX], "edited": None}]
    pd.DataFrame(rows, index=[7]).to_parquet(path, index=False)
    assert read_pairs([path]) == ((PAIR,), None)


def test_parquet_of_another_form_is_refused(tmp_path: Path) -> None:
    path = parquet(tmp_path / "a.parquet", {"sample_id": ["s1"], "x": [1.0]})
    needed = r"has no column step, .*,x_m,y_m, or sample_id,source,edited"
    with pytest.raises(InvalidArgumentError, match=needed):
        read_pairs([path])
    row = {"sample_id": ["s1"], "trajectory": ["source"], "step": [1.0], "x_m": [1.0], "y_m": [0.0]}
    path = parquet(tmp_path / "b.parquet", row | {"sample_id": [["s1"]]})
    with pytest.raises(InvalidArgumentError, match="row 1: sample_id must be a text"):
        read_pairs([path])
    for step in (math.inf, 1.5):
        path = parquet(tmp_path / "c.parquet", row | {"step": [step]})
        with pytest.raises(InvalidArgumentError, match="row 1: step must be a whole number"):
            read_pairs([path])
    no_text = pa.array([b"\xff"]).view(pa.string())
    path = parquet(tmp_path / "d.parquet", row | {"sample_id": no_text})
    with pytest.raises(InvalidArgumentError, match="cannot be read as Parquet"):
        read_pairs([path])
    path.write_bytes(b"PAR1" + bytes(20))
    with pytest.raises(InvalidArgumentError, match="cannot be read as Parquet"):
        read_pairs([path])


def test_parquet_without_pyarrow_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = parquet(tmp_path / "a.parquet", {"sample_id": ["s1"]})
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InvalidArgumentError, match="need pyarrow") as caught:
        read_pairs([path])
    assert caught.value.advice == 'Run: pip install "exceptiondrive[parquet]"'


class Opened:
    """Unpickled, it would make a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (self.folder,)


def test_a_pickle_is_never_loaded(tmp_path: Path) -> None:
    path, folder = tmp_path / "a.pkl", tmp_path / "made"
    path.write_bytes(pickle.dumps(Opened(folder)))
    with pytest.raises(InvalidArgumentError, match="is a pickle, which is never loaded") as caught:
        read_pairs([path])
    assert "{token: array.tolist(), ...}; docs/client.md has a line" in caught.value.advice
    assert not folder.exists()


HEADER = "sample_id,trajectory,step,x_m,y_m\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sample,x\n1,2\n", "has no column sample_id, step, trajectory, x_m, y_m"),
        (HEADER + "s1,middle,1,0,0\n", "line 2: trajectory must be source or edited"),
        (HEADER + "s1,source,one,0,0\n", "line 2: step must be a whole number"),
        (HEADER + "s1,source,1,0\n", "line 2: step must be a whole number"),
        (HEADER + "s1,source,1,one,0\n", "line 2: step must be .*, x_m and y_m numbers"),
        (HEADER + "s1,source,1,0,0\ns1,source,1,0,0\n", "step 1 occurs twice"),
        (HEADER + "s1,source,1,0,0\ns1,source,3,0,0\n", "without a gap"),
        (HEADER + "s1,source,2,0,0\n", "steps must run from 0 or 1"),
        ('{"sample_id": "s1"}\nrubbish\n', "line 2 is not JSON"),
        ("[" * 100_000, "line 1 is not JSON: nested too deeply"),
        ('{"source": null}', "needs a sample_id"),
        ('{"id": "s1", "plan": [[1, 0]]}', "needs a sample_id, got {'id': 's1', 'plan'"),
        ('{"s1": [[1, 0]]}', "is one run of a planner"),
        ('{"s1": [[1, 0]], "s2": null, "s3": [[1, 0]]}', "is one run of a planner"),
        ("", "is empty: check that your program finished writing it"),
        (" \n", "is empty: check that your program finished writing it"),
        ('// of today\n{"predictions": []}', "begins with what looks like a comment: remove it"),
        (f"# of today\n{HEADER}", "begins with what looks like a comment: remove it"),
        ('{"sample_id": "s1", "plan": []}', "unknown key plan; a prediction has sample_id, "),
        ('{"source": {"s1": null}, "edited": {"s1": null}}', "needs a sample_id"),
        ('{"sample_id": ["s1"], "source": [null], "edited": [null]}', "needs a sample_id"),
        (
            '{"n": 1, "results": [{"sample_id": "s1", "source": null}]}',
            "mean what is under results",
        ),
        ('{"results": {"s1": {"source": null}}}', "did you mean what is under results"),
        ('{"schema": "a", "run": {"predictions": []}}', "alone into a file, or call the key pred"),
        ('{"run": {"results": {"predictions": []}}}', "run: unknown key results"),
        ('{"sample_id": "s1", "edited": 5}', "s1: edited must be a list"),
        ('{"sample_id": "s1", "edited": [[true, 1]]}', "s1: edited must be a list"),
        ('{"schema": "exceptiondrive.strategy/1", "split": "x"}', "only .* has trajectories"),
        ('{"predictions": null}', "predictions must be a list, or an object by sample id"),
        ('{"predictions": "[] []"}', "predictions must be a list, or an object by sample id"),
    ],
)
def test_an_unreadable_file_says_where(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        read_pairs([written(tmp_path, "a.txt", text)])


@pytest.mark.parametrize("kind", ["zip", "tar", "xz"])
def test_an_archive_is_named_and_what_is_read_instead(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path, "a.json", json.dumps(DOCUMENT))
    if kind == "xz":
        packed = tmp_path / "a.json.xz"
        packed.write_bytes(lzma.compress(path.read_bytes()))
    else:
        packed = Path(shutil.make_archive(str(tmp_path / "b"), kind, tmp_path, "a.json"))
    with pytest.raises(InvalidArgumentError, match=rf"is (a )?{kind}.*Read are JSON"):
        read_pairs([packed])


def test_a_missing_file_and_bytes_that_are_no_text_are_said(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"none\.json cannot be read: No such file"):
        read_pairs([tmp_path / "none.json"])
    (tmp_path / "a.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidArgumentError, match="not UTF-8"):
        read_pairs([tmp_path / "a.json"])


def test_files_of_two_splits_are_not_mixed(tmp_path: Path) -> None:
    other = json.dumps(DOCUMENT | {"split": "other", "predictions": []})
    paths = [
        written(tmp_path, "a.json", json.dumps(DOCUMENT)),
        written(tmp_path, "b.json", other),
    ]
    with pytest.raises(InvalidArgumentError, match="different splits: other, sample"):
        read_pairs(paths)


@pytest.mark.parametrize("name", ["out.json", "out.json.gz"])
def test_what_is_written_is_read_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    assert write_file(path, submission_text("sample", [PAIR])) == path.stat().st_size
    assert read_pairs([path]) == ((PAIR,), "sample")
    assert sorted(tmp_path.iterdir()) == [path]


def test_what_a_link_leads_to_is_replaced_and_the_link_stays(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    link, target = tmp_path / "out.json", tmp_path / "kept" / "planner.json"
    link.symlink_to(target)
    for text in ("first", "second"):
        write_file(link, text)
        assert (link.is_symlink(), target.read_text()) == (True, text)
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "kept", target, link]


def test_a_named_pipe_is_written_into_and_stays(pipe: tuple[Path, Callable[[], bytes]]) -> None:
    path, all_read = pipe
    assert write_file(path, "words") == len("words")
    assert list(path.parent.iterdir()) == [path]
    assert all_read() == b"words"


def test_stdin_is_no_place_to_write_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidArgumentError, match="- stands for stdin") as caught:
        write_file(Path("-"), "words")
    assert caught.value.advice == "Name the file to write."
    assert not list(tmp_path.iterdir())
