import json
from pathlib import Path

import pytest
from tests.agent.bench import made_png

from exceptiondrive_agent.errors import AgentError
from exceptiondrive_agent.run import find_images
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_endpoints.images import MAX_IMAGE_BYTES, load_images


def test_images_of_a_folder_come_in_order_of_file_name_but_hidden_ones(tmp_path: Path) -> None:
    sample = tmp_path / "sample-1"
    sample.mkdir()
    for name in ("b.PNG", "a.jpg", "c.jpeg", "notes.txt", "._a.jpg"):
        (sample / name).write_bytes(b"")
    found = find_images(tmp_path)
    assert [path.name for path in found["sample-1"]] == ["a.jpg", "b.PNG", "c.jpeg"]


def test_files_and_hidden_folders_beside_the_samples_are_no_samples(tmp_path: Path) -> None:
    (tmp_path / "s1").mkdir()
    (tmp_path / ".cache").mkdir()
    (tmp_path / "readme.txt").write_text("")
    assert set(find_images(tmp_path)) == {"s1"}


def test_a_json_file_gives_paths_relative_to_itself_in_its_own_order(tmp_path: Path) -> None:
    file = tmp_path / "images.json"
    file.write_text(json.dumps({"any/id": ["x/2.png", "x/1.png"]}))
    assert find_images(file) == {"any/id": (tmp_path / "x/2.png", tmp_path / "x/1.png")}


@pytest.mark.parametrize(
    "text", ["", "[]", '{"s": "a.png"}', '{"s": [1]}', "{}", "[" * 100_000], ids=range(6)
)
def test_a_json_file_of_another_form_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "images.json"
    file.write_text(text)
    with pytest.raises(AgentError, match=r"images\.json"):
        find_images(file)


def test_an_empty_folder_is_refused_with_the_layout_that_is_expected(tmp_path: Path) -> None:
    with pytest.raises(AgentError, match="<sample_id>"):
        find_images(tmp_path)


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AgentError, match="no such folder"):
        find_images(tmp_path / "nowhere")


def test_images_are_loaded_without_metadata(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(made_png(1, b"secret"))
    assert [image.data for image in load_images((tmp_path / "a.png",))] == [made_png(1)]


def test_a_sample_without_images_has_a_reason() -> None:
    with pytest.raises(NoAnswerError) as caught:
        load_images(())
    assert caught.value.reason is Reason.NO_IMAGES


def test_unreadable_images_have_a_reason_and_are_named_without_their_folder(tmp_path: Path) -> None:
    (tmp_path / "text.jpg").write_text("not an image")
    with (tmp_path / "large.png").open("wb") as large:
        large.truncate(MAX_IMAGE_BYTES + 1)
    for name in ("text.jpg", "large.png", "missing.png"):
        with pytest.raises(NoAnswerError) as caught:
            load_images((tmp_path / name,))
        assert caught.value.reason is Reason.UNREADABLE_IMAGE
        assert caught.value.detail.startswith(f"{name}: ")
        assert str(tmp_path) not in caught.value.detail
