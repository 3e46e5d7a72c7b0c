"""A stand-in for the models of a workshop: it screens, edits pictures and gives marks.

It speaks the very protocol and knows the cameras of the scenes, so that a hazard is painted where
the screening put it. What it decides hangs on digests of what it is asked: the same question gets
the same answer, whatever came before. `python -m tests.support.stand_in WORKSHOP --port 8000`.
"""

import argparse
import base64
import hashlib
import json
import re
import signal
import threading
from collections.abc import Callable
from email.parser import BytesParser
from email.policy import HTTP
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageFilter
from tests.support.chat_endpoint import ChatEndpoint, Reply, Seen

from exceptiondrive_build.measure import target_area
from exceptiondrive_build.scenes.keyframe import Camera
from exceptiondrive_build.values import Mark
from exceptiondrive_build.workshop import Workshop
from exceptiondrive_endpoints.images import clean_image

PLACE = re.compile(r"(-?[\d.]+) m ahead and (-?[\d.]+) m to the left")
RANGE = re.compile(r"([\d.-]+) to ([\d.-]+) m ahead and ([\d.-]+) to ([\d.-]+) m to the left")
CODE = re.compile(r"^(\w+): ", re.MULTILINE)
HAZARD_SIZE_M = (1.5, 1.5, 1.5)
HAZARD_COLOUR = (250, 120, 20)
Fault = Callable[[Seen], Reply | None]


class StandIn(ChatEndpoint):
    """The server.

    Attributes:
        suitable: Share of candidates that suit their scene.
        low: Share of reviews with a low mark.
        repainted: Share of edits that change the whole picture.
        fault: Called with every request; what it returns is sent in place of an answer.
    """

    def __init__(self, cameras: dict[str, Camera], port: int = 0) -> None:
        super().__init__(port)
        self._cameras = cameras
        self._edit = lru_cache(256)(self._edit_anew)
        self.suitable, self.low, self.repainted = 0.5, 0.1, 0.05
        self.fault: Fault = lambda _: None
        self.keeps_seen = True
        self.n_answered = 0
        self.answer = self._answer

    @classmethod
    def of(cls, workshop: Workshop, port: int = 0) -> "StandIn":
        """A stand-in that knows the cameras of a workshop's scenes."""
        cameras = {
            digest(clean_image(workshop.image(camera.image)).data): camera
            for keyframe in workshop.keyframes.values()
            for camera in keyframe.cameras
        }
        return cls(cameras, port)

    def _answer(self, seen: Seen) -> Reply:
        fault = self.fault(seen)
        if not self.keeps_seen:
            self.seen.clear()
        if fault is not None:
            return fault
        self.n_answered += 1
        if seen.path.endswith("/images/edits"):
            fields = form_fields(seen)
            return picture(self.edited(fields["image"], fields["prompt"].decode()))
        if seen.form == "words":
            return self.fails(400, "this endpoint wants a response_format")
        name = seen.document["response_format"].get("json_schema", {}).get("name", "")
        answer = self.screened(seen) if name == "screen" else self.reviewed(seen)
        return self.says(json.dumps(answer))

    def screened(self, seen: Seen) -> dict[str, Any]:
        """Suitable by a share, with a target that at least one view sees."""
        instructions, *_ = seen.texts
        draw = share_of(b"screen", instructions.encode(), *seen.images)
        rules = instructions.partition("(code: rule):")[2].partition("\n\n")[0]
        if draw >= self.suitable:
            reason = CODE.findall(rules)[int(draw * 1000) % 2]
            return screen_answer(False, reason=reason)
        low_x, high_x, low_y, high_y = map(float, RANGE.findall(instructions)[0])
        ahead = round(low_x + (min(high_x, 22.0) - low_x) * share_of(b"x", *seen.images), 1)
        left = round(max(low_y, -1.5) + 3.0 * share_of(b"y", *seen.images) * (high_y > 0), 1)
        left = min(left, high_y)
        cameras = [self._cameras[digest(image)] for image in seen.images]
        views = [c.view for c in cameras if self._sees(c, ahead, left)]
        words = f"draw it with its foot at {ahead} m ahead and {left} m to the left"
        edits = [{"view": view, "instruction": f"in {view}: {words}"} for view in views]
        return screen_answer(True, target=(ahead, left), edits=edits)

    @staticmethod
    def _sees(camera: Camera, ahead: float, left: float) -> bool:
        area = target_area(camera, (ahead, left), HAZARD_SIZE_M)
        return area is not None and int(area.sum()) > 60

    def edited(self, image: bytes, prompt: str) -> bytes:
        """The picture with a hazard where the prompt says, as PNG."""
        return self._edit(image, prompt)

    def _edit_anew(self, image: bytes, prompt: str) -> bytes:
        camera = self._cameras[digest(image)]
        source = Image.open(BytesIO(image)).convert("RGB")
        ahead, left = map(float, PLACE.findall(prompt)[0])
        area = target_area(camera, (ahead, left), HAZARD_SIZE_M)
        if share_of(b"repaint", image, prompt.encode()) < self.repainted:
            source = source.filter(ImageFilter.GaussianBlur(6)).point(lambda value: value * 0.7)
        pixels = np.array(source)
        if area is not None:
            stripes = (np.indices(area.shape).sum(axis=0) // 4 % 2).astype(bool)
            pixels[area] = HAZARD_COLOUR
            pixels[area & stripes] = (20, 20, 20)
        return png(Image.fromarray(pixels))

    def reviewed(self, seen: Seen) -> dict[str, Any]:
        """Marks of 4 and 5; by a share, one of 1 or 2."""
        draw = share_of(b"review", seen.texts[0].encode(), *seen.images)
        marks = {mark.value: 4 + int(draw * 1e4) % 2 for mark in Mark}
        if draw < self.low:
            marks[list(marks)[int(draw * 1e6) % len(marks)]] = 1 + int(draw * 1e5) % 2
        return {**marks, "note": "looked at source and edit"}


def screen_answer(
    suitable: bool,
    reason: str | None = None,
    target: tuple[float | None, float | None] = (None, None),
    edits: Any = (),
) -> dict[str, Any]:
    """The whole answer to a question of screening."""
    return {
        "suitable": suitable,
        "reason": reason,
        "target_ahead_m": target[0],
        "target_left_m": target[1],
        "edits": list(edits),
        "note": "looked at all views",
    }


def picture(data: bytes) -> Reply:
    """An answer of `images/edits`."""
    body = {"created": 1, "data": [{"b64_json": base64.b64encode(data).decode()}]}
    return Reply(json.dumps(body).encode())


def png(image: Image.Image) -> bytes:
    """A picture as PNG."""
    file = BytesIO()
    image.save(file, "PNG", compress_level=1)
    return file.getvalue()


def form_fields(seen: Seen) -> dict[str, bytes]:
    """The fields of a multipart form."""
    kind = re.search(rb"(?im)^content-type: (.*)$", seen.head)
    assert kind, "a form without its type"
    head = b"MIME-Version: 1.0\r\nContent-Type: " + kind[1].strip() + b"\r\n\r\n"
    message = BytesParser(policy=HTTP).parsebytes(head + seen.body)
    found = {}
    for part in message.walk():
        name = part.get_param("name", header="content-disposition")
        value = part.get_payload(decode=True)
        if isinstance(name, str) and isinstance(value, bytes):
            found[name] = value
    return found


def digest(data: bytes) -> str:
    """Which picture this is."""
    return hashlib.sha256(data).hexdigest()


def share_of(*parts: bytes) -> float:
    """A number in [0, 1) that hangs on these bytes alone."""
    mixed = hashlib.sha256(b"\0".join(hashlib.sha256(part).digest() for part in parts))
    return int.from_bytes(mixed.digest()[:6], "big") / 2**48


def main() -> None:
    """Serve until a signal comes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("workshop", type=Path)
    parser.add_argument("--port", type=int, default=8000)
    for name, share in (("suitable", 0.5), ("low", 0.1), ("repainted", 0.05)):
        parser.add_argument(f"--{name}", type=float, default=share, help="share of answers")
    arguments = parser.parse_args()
    with Workshop(arguments.workshop) as workshop:
        server = StandIn.of(workshop, arguments.port)
    server.suitable, server.low = arguments.suitable, arguments.low
    server.repainted, server.keeps_seen = arguments.repainted, False
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    print(f"stand-in at {server.base_url}", flush=True)  # noqa: T201
    ended.wait()
    server.close()


if __name__ == "__main__":
    main()
