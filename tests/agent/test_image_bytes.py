from collections.abc import Callable

import pytest
from tests.agent.bench import made_jpeg, made_png

from exceptiondrive_endpoints.images import ImageDataError, clean_image

Made = Callable[..., bytes]
SECRET = b"/data/n008/SE1-sample-007 task=LB1"


def test_a_png_loses_its_text_and_keeps_every_pixel_byte() -> None:
    cleaned = clean_image(made_png(7, SECRET))
    assert cleaned.media_type == "image/png"
    assert cleaned.data == made_png(7)


def test_a_jpeg_loses_exif_comment_and_trailer_and_keeps_the_coded_pixels() -> None:
    pixels = b"\x12\xff\x00\x34\xff\xd0\x56"  # a stuffed 0xFF and a restart marker
    cleaned = clean_image(made_jpeg(pixels, SECRET))
    assert cleaned.media_type == "image/jpeg"
    assert cleaned.data == made_jpeg(pixels)


def test_a_jpeg_of_several_scans_is_kept_whole() -> None:
    one = made_jpeg(b"\x12\x34")
    scan = one[one.index(b"\xff\xda") : -2]
    progressive = one[:-2] + scan + scan + b"\xff\xd9"
    assert clean_image(progressive).data == progressive


def test_a_thumbnail_in_the_jfif_header_is_dropped() -> None:
    plain = made_jpeg(b"\x12")
    thumbnail = b"\xff\xe0\x00\x13JFIF\x00\x01\x01\x00\x00\x01\x00\x01\x01\x01\xaa\xbb\xcc"
    assert b"\xaa\xbb\xcc" not in clean_image(b"\xff\xd8" + thumbnail + plain[20:]).data


def test_whatever_follows_the_end_of_a_png_is_dropped() -> None:
    assert clean_image(made_png(7) + SECRET).data == made_png(7)


@pytest.mark.parametrize("kept", range(0, 66, 5))
def test_a_cut_png_is_refused(kept: int) -> None:
    with pytest.raises(ImageDataError):
        clean_image(made_png(7)[:kept])


@pytest.mark.parametrize("removed", [1, 2, 3, 10, 40, 100])
def test_a_cut_jpeg_is_refused(removed: int) -> None:
    with pytest.raises(ImageDataError):
        clean_image(made_jpeg(b"\x12\x34")[:-removed])


def test_a_png_with_a_flipped_bit_is_refused() -> None:
    damaged = bytearray(made_png(7))
    damaged[20] ^= 1
    with pytest.raises(ImageDataError, match="checksum"):
        clean_image(bytes(damaged))


@pytest.mark.parametrize("data", [b"", b"GIF89a", b"#!/bin/sh\n", b"\xff\xd8\xff\x00\x00\x00"])
def test_what_is_no_image_is_refused(data: bytes) -> None:
    with pytest.raises(ImageDataError):
        clean_image(data)


def test_the_data_address_carries_the_media_type_and_the_bytes() -> None:
    assert clean_image(made_png(7)).data_url.startswith("data:image/png;base64,iVBORw0KGgo")
