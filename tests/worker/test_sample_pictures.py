"""Pictures beside a split: of public ones alone, made anew, shown under words, taken away again."""

import contextlib
import io
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pytest
from PIL import Image
from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from tests.support.made_pictures import png, png_that_says

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.operations.dump import file_digests
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.splits.drawings import PublicSplit
from exceptiondrive_records.splits.pictures import pictures_of, show_pictures, shows_picture
from exceptiondrive_records.splits.splits import publish_split
from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split, SplitRef
from exceptiondrive_worker.splits.admin import current_split, register_all_splits
from exceptiondrive_worker.splits.pictures import (
    PicturesRefusedError,
    publish_pictures,
    remove_pictures,
)
from exceptiondrive_worker.splits.small_jpeg import PictureUnreadableError, small_jpeg
from exceptiondrive_worker.splits.store import SplitStore

LICENCE = "Made up by a test, CC0 1.0"


@dataclass
class Shelf:
    """A split of two samples with its folder, files and records."""

    folder: Path
    database: Database
    files: FileStore
    ref: SplitRef

    @property
    def splits(self) -> SplitStore:
        return SplitStore(self.folder.parent)

    def publish_split(self) -> None:
        """Say that it is public, without a file of it: it holds marked coordinates."""
        with self.database.write() as session:
            publish_split(session, "tiny", self.ref.revision, "sha256:" + "7" * 64, "test")

    def put(self, name: str, data: bytes) -> None:
        (self.folder / "pictures").mkdir(exist_ok=True)
        (self.folder / "pictures" / name).write_bytes(data)

    def show(self, licence: str = LICENCE) -> int:
        return publish_pictures(
            self.database, self.files, *current_split(self.splits, "tiny"), licence
        )

    @property
    def rows(self) -> list[SamplePictureRow]:
        with self.database.read() as session:
            return list(session.scalars(select(SamplePictureRow)))


@pytest.fixture
def shelf(tmp_path: Path, sqlite_url: str, make_split: Callable[..., Split]) -> Iterator[Shelf]:
    split = make_split({"a": {}, "b": {"task": "LB1"}})
    folder = tmp_path / "splits" / "tiny"
    folder.mkdir(parents=True)
    (folder / "split.json").write_text(split.model_dump_json(by_alias=True, exclude_none=True))
    database, files = Database(sqlite_url), FileStore(f"file://{tmp_path}/uploads")
    register_all_splits(database, SplitStore(folder.parent), packaged_protocol())
    yield Shelf(folder, database, files, SplitRef(name="tiny", revision=split.revision))
    database.dispose()


def test_pictures_are_kept_small_bare_and_by_their_content(shelf: Shelf) -> None:
    shelf.publish_split()
    shelf.put("a.source.png", png(1600, 900, "taken at 48.1 N"))
    shelf.put("a.edited.png", png(64, 40))
    assert shelf.show() == 2
    with shelf.database.read() as session:
        source, edited = pictures_of(session, shelf.ref, ["a", "b"])["a"]
        assert set(file_digests(session)) >= {source.file_digest, edited.file_digest}
    assert (source.shows, source.width_px, source.height_px) == ("source", 1280, 720)
    assert (edited.shows, edited.width_px, edited.height_px) == ("edited", 64, 40)
    assert {source.licence, edited.licence} == {LICENCE}
    stored = shelf.files.read(source.file_digest, limit_bytes=2**22)
    assert b"48.1" not in stored
    with Image.open(io.BytesIO(stored)) as picture:
        assert (picture.format, picture.size) == ("JPEG", (1280, 720))


def test_what_lies_there_now_takes_the_place_of_what_was_shown(shelf: Shelf) -> None:
    shelf.publish_split()
    shelf.put("a.source.png", png(64, 40))
    shelf.show()
    (before,) = shelf.rows
    shelf.put("a.source.png", png(32, 20))
    shelf.show("CC BY 4.0, after the reader asked")
    (after,) = shelf.rows
    assert after.file_digest != before.file_digest
    assert after.licence == "CC BY 4.0, after the reader asked"
    assert not shelf.files.holds(before.file_digest)
    assert shelf.files.holds(after.file_digest)
    remove_pictures(shelf.database, shelf.files, shelf.ref)
    assert shelf.rows == []
    assert not shelf.files.holds(after.file_digest)
    with shelf.database.read() as session:
        assert not shows_picture(session, "tiny", after.file_digest)
        lines = session.scalars(
            select(AuditLine.detail).where(AuditLine.action == "pictures shown")
        )
        assert [line["n_pictures"] for line in lines] == [1, 1, 0]


def test_the_worker_shows_no_picture_of_a_withheld_split_and_stores_none(
    shelf: Shelf, tmp_path: Path
) -> None:
    shelf.put("a.source.png", png(64, 40))
    with pytest.raises(PicturesRefusedError, match="not public"):
        shelf.show()
    with pytest.raises(PicturesRefusedError, match="not public"):
        remove_pictures(shelf.database, shelf.files, shelf.ref)
    assert shelf.rows == []
    assert not [path for path in (tmp_path / "uploads").rglob("*") if path.is_file()]


def test_a_later_revision_is_withheld_until_it_is_published_itself(
    shelf: Shelf, make_split: Callable[..., Split]
) -> None:
    shelf.publish_split()
    later = make_split({"a": {}, "c": {"task": "LB1"}})
    (shelf.folder / "split.json").write_text(
        later.model_dump_json(by_alias=True, exclude_none=True)
    )
    register_all_splits(shelf.database, shelf.splits, packaged_protocol())
    shelf.put("a.source.png", png(64, 40))
    with pytest.raises(PicturesRefusedError, match="not public"):
        shelf.show()


def test_the_records_refuse_pictures_of_a_withheld_split_whoever_asks(shelf: Shelf) -> None:
    picture = {"sample_id": "a", "shows": "edited", "width_px": 6, "height_px": 4}
    digest = "sha256:" + "5" * 64
    forged = PublicSplit(shelf.ref, digest)  # an attacker who says that it is public
    row = SamplePictureRow(file_digest=digest, **picture)
    with shelf.database.write() as session:
        with pytest.raises(IntegrityError):
            show_pictures(session, forged, [row], LICENCE, "attacker")
        session.rollback()
    for said in (digest, None):  # and one who writes rows
        with shelf.database.write() as session:
            session.add(
                SamplePictureRow(
                    split_name="tiny",
                    split_revision=shelf.ref.revision,
                    public_file_digest=said,
                    file_digest=digest,
                    licence=LICENCE,
                    created_at=datetime.now(UTC),
                    **picture,
                )
            )
            with pytest.raises(IntegrityError):
                session.flush()
            session.rollback()
    assert shelf.rows == []


def test_the_invariants_find_a_picture_of_a_withheld_split(shelf: Shelf, sqlite_url: str) -> None:
    shelf.publish_split()
    shelf.put("a.source.png", png(64, 40))
    shelf.show()
    with shelf.database.write() as session:
        assert not violations(session)
    file = sqlite_url.removeprefix("sqlite:///")
    with contextlib.closing(sqlite3.connect(file)) as bare:  # which checks no foreign key
        bare.execute("UPDATE splits SET public_file_digest = NULL")
        bare.commit()
    with shelf.database.read() as session:
        assert [found.rule for found in violations(session)] == ["picture of a withheld split"]


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.source.svg", b"<svg xmlns='http://www.w3.org/2000/svg'/>", "is not named"),
        ("a.png", png(6, 4), "is not named"),
        ("a.other.png", png(6, 4), "is not named"),
        ("a.source.png", b"<html><script>alert(1)</script>", "no JPEG, PNG or WebP"),
        ("a.source.png", b"<svg xmlns='http://www.w3.org/2000/svg'/>", "no JPEG, PNG or WebP"),
        ("a.source.png", b"GIF89a\x01\0\x01\0\0\0\0;", "no JPEG, PNG or WebP"),
        ("a.source.png", png(64, 40)[:90], "no JPEG, PNG or WebP"),
        ("a.source.png", b"", "no JPEG, PNG or WebP"),
    ],
)
def test_what_is_no_picture_of_a_sample_is_refused_by_its_name(
    shelf: Shelf, name: str, data: bytes, words: str
) -> None:
    shelf.publish_split()
    shelf.put("0.source.png", png(64, 40))
    shelf.put(name, data)
    with pytest.raises(PicturesRefusedError, match=words) as refused:
        shelf.show()
    assert name in str(refused.value)
    assert shelf.rows == []
    assert list(shelf.files.stored()) == [], "files without a record stop the reconcilers' sweep"


def test_a_picture_that_would_unpack_to_too_much_is_refused_unread() -> None:
    with pytest.raises(PictureUnreadableError, match="more than 40000000 pixels"):
        small_jpeg(png_that_says(9000, 8000), 1280)


def test_what_hides_behind_the_pixels_is_not_stored(shelf: Shelf) -> None:
    """A file that is a picture to one reader and a page to another comes out as a picture."""
    jpeg, _, _ = small_jpeg(png(64, 40) + b"<script>alert(1)</script>", 1280)
    assert b"script" not in jpeg
    assert jpeg.startswith(b"\xff\xd8\xff")


@pytest.mark.parametrize("licence", ["", "  ", "two\nlines", "x" * 301])
def test_a_licence_is_a_line_of_words(shelf: Shelf, licence: str) -> None:
    shelf.publish_split()
    shelf.put("a.source.png", png(64, 40))
    with pytest.raises(InvalidRecord, match="licence"):
        shelf.show(licence)
    assert shelf.rows == []
    assert list(shelf.files.stored()) == []


def test_a_picture_of_no_sample_of_the_split_and_no_picture_at_all_are_refused(
    shelf: Shelf,
) -> None:
    shelf.publish_split()
    with pytest.raises(PicturesRefusedError, match="no pictures in tiny/pictures"):
        shelf.show()
    shelf.put("nosuch.source.png", png(64, 40))
    with pytest.raises(InvalidRecord, match="'nosuch' first"):
        shelf.show()
