"""A synthetic set in nuScenes form: a flat road, seen by six cameras with exact calibration.

Every pixel is the colour of the ground point that its ray meets, so a point on the road is in each
picture exactly where the tables say. Painted marks, listed in `marks.json`, show that. The same
seed gives the same bytes. Calibration and shutter times are close to those of a nuScenes car.
"""

import hashlib
import json
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from exceptiondrive_build.scenes.nuscenes import CAMERAS, LIDAR, TIME_STEP_S, rigid
from exceptiondrive_scoring.aliases import FloatArray

VERSION = "v1.0-mini"
START_US = 1_532_402_927_600_000
FULL_WIDTH, FULL_HEIGHT = 1600, 900
# channel: yaw in degrees, focal length in pixels of the full width, x, y, z in metres, shutter in ms
RIG = {
    "CAM_FRONT_LEFT": (55.0, 1272.6, 1.52, 0.49, 1.51, -43.0),
    "CAM_FRONT": (0.0, 1266.4, 1.70, 0.02, 1.51, -35.0),
    "CAM_FRONT_RIGHT": (-55.0, 1260.8, 1.55, -0.49, 1.50, -27.0),
    "CAM_BACK_LEFT": (108.0, 1256.7, 1.04, 0.48, 1.59, -2.0),
    "CAM_BACK": (180.0, 809.2, 0.03, 0.00, 1.57, -10.0),
    "CAM_BACK_RIGHT": (-110.0, 1259.5, 1.01, -0.48, 1.57, -18.0),
}
PITCH_RAD = 0.01
SKY, FOG_M = (np.array([150.0, 178.0, 205.0]), np.array([206.0, 216.0, 224.0])), 120.0
ASPHALT, GRAVEL, GRASS = (88, 89, 92), (150, 144, 134), (92, 112, 68)
PAINT, MARK = (228, 228, 222), (214, 40, 150)
MARK_RADIUS_M, MARK_STEP_M, MARK_ASIDE_M = 0.3, 3.0, (-7.0, -2.4, 0.0, 3.2, 8.0)
FIRST_MARK_M = -24.0
LANE_M, SHOULDER_M = 3.5, 1.6


@dataclass(frozen=True)
class Drive:
    """One drive along the right lane of an arc of road."""

    start_m: FloatArray
    yaw_rad: float
    curvature_per_m: float
    speed_mps: float
    acceleration_mps2: float

    def pose(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Rotation (w, x, y, z) and translation (x, y, 0) of the car in the map."""
        stop_s = -self.speed_mps / self.acceleration_mps2 if self.acceleration_mps2 < 0 else np.inf
        driven_s = min(time_s, stop_s)
        along_m = self.speed_mps * driven_s + self.acceleration_mps2 * driven_s**2 / 2
        yaw = self.yaw_rad + along_m * self.curvature_per_m
        rotation = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        return rotation, np.append(self.on_road(along_m, 0.0), 0.0)

    def on_road(self, along_m: float, left_m: float) -> FloatArray:
        """Map position of a point of the road, by metres along and left of the driven line."""
        radius_m = 1 / self.curvature_per_m
        yaw = self.yaw_rad + along_m * self.curvature_per_m
        outward = np.array([np.sin(yaw), -np.cos(yaw)])
        return self._centre_m() + (radius_m - left_m) * outward

    def road(self, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Metres along and left of the driven line: (n, 2) map positions -> two (n,)."""
        side = np.sign(self.curvature_per_m)
        radius_m = 1 / self.curvature_per_m
        from_centre = at_m - self._centre_m()
        yaw = np.arctan2(side * from_centre[:, 0], -side * from_centre[:, 1])
        turned = (yaw - self.yaw_rad + np.pi) % (2 * np.pi) - np.pi
        left_m = radius_m - side * np.hypot(from_centre[:, 0], from_centre[:, 1])
        return turned * radius_m, left_m

    def _centre_m(self) -> FloatArray:
        normal = np.array([-np.sin(self.yaw_rad), np.cos(self.yaw_rad)])
        return self.start_m + normal / self.curvature_per_m

    def marks_m(self) -> FloatArray:
        """(n, 2) map positions of the painted marks."""
        along = np.arange(FIRST_MARK_M, 130.0, MARK_STEP_M)
        return np.array(
            [self.on_road(s, MARK_ASIDE_M[i % len(MARK_ASIDE_M)]) for i, s in enumerate(along)]
        )


class _View:
    """What each pixel of a camera sees: a point of the ground, or the sky."""

    def __init__(self, channel: str, width: int) -> None:
        yaw_degrees, focal_px, x, y, z, self.shutter_ms = RIG[channel]
        self.width, self.height = width, width * FULL_HEIGHT // FULL_WIDTH
        focal = focal_px * width / FULL_WIDTH
        self.intrinsic = np.array(
            [[focal, 0, (width - 1) / 2], [0, focal, (self.height - 1) / 2], [0, 0, 1]]
        )
        self.translation = np.array([x, y, z])
        self.rotation = _camera_quaternion(np.radians(yaw_degrees), PITCH_RAD)
        ego_from_camera = rigid(self.rotation, self.translation)
        v, u = np.mgrid[0 : self.height, 0 : self.width]
        pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
        rays = ego_from_camera[:3, :3] @ np.linalg.inv(self.intrinsic) @ pixels
        self.falls = rays[2] < -1e-3
        down = rays[:, self.falls]
        self.ground_m = (self.translation[:2, None] - down[:2] * z / down[2]).T
        self.distance_m = np.hypot(*(self.ground_m.T - self.translation[:2, None]))
        upward = np.clip(rays[2] / np.hypot(rays[0], rays[1]) * 2.5, 0, 1)[:, None]
        self.sky = SKY[1] * (1 - upward) + SKY[0] * upward

    def picture(self, drive: Drive, time_s: float) -> bytes:
        """JPEG of what the camera sees when its shutter opens."""
        map_from_ego = rigid(*drive.pose(time_s + self.shutter_ms / 1e3))
        at_m = self.ground_m @ map_from_ego[:2, :2].T + map_from_ego[:2, 3]
        fog = (1 - np.exp(-self.distance_m / FOG_M))[:, None]
        pixels = self.sky.copy()
        pixels[self.falls] = ground_colours(drive, at_m) * (1 - fog) + SKY[1] * fog
        image = Image.fromarray(
            pixels.round().astype(np.uint8).reshape(self.height, self.width, 3), "RGB"
        )
        file = BytesIO()
        image.save(file, "JPEG", quality=92, subsampling=0)
        return file.getvalue()


def ground_colours(drive: Drive, at_m: FloatArray) -> FloatArray:
    """Colours of map positions, (n, 2) -> (n, 3): two lanes, shoulders, grass, and the marks."""
    along_m, left_m = drive.road(at_m)
    right_edge, left_edge = -LANE_M / 2, LANE_M * 1.5
    aside_m = np.maximum(right_edge - left_m, left_m - left_edge)
    colours = np.empty((len(at_m), 3))
    colours[:] = ASPHALT
    colours[aside_m > 0] = GRAVEL
    colours[aside_m > SHOULDER_M] = GRASS
    is_edge = np.abs(aside_m + 0.25) < 0.09
    is_middle = (np.abs(left_m - LANE_M / 2) < 0.08) & (along_m % 9 < 3.5)
    colours += _ground_grain(at_m)[:, None]
    colours[is_edge | is_middle] = PAINT
    place = np.clip(np.round((along_m - FIRST_MARK_M) / MARK_STEP_M).astype(int), 0, None)
    marks_m = drive.marks_m()
    nearest = marks_m[np.minimum(place, len(marks_m) - 1)]
    colours[np.hypot(*(at_m - nearest).T) < MARK_RADIUS_M] = MARK
    return np.clip(colours, 0, 255)


def _ground_grain(at_m: FloatArray) -> FloatArray:
    """Fixed texture of the ground, a quarter of a metre in size."""
    x, y = np.floor(at_m.T * 4).astype(np.int64)
    mixed = (x * 73_856_093) ^ (y * 19_349_663)
    mixed = (mixed ^ (mixed >> 13)) * 1_274_126_177
    grain: FloatArray = ((mixed >> 8) & 0xFF) / 255 * 16 - 8
    return grain


def _camera_quaternion(yaw_rad: float, pitch_rad: float) -> FloatArray:
    """Quaternion of a camera (x right, y down, z ahead) turned left by yaw and down by pitch."""
    level = np.array([0.5, -0.5, 0.5, -0.5])
    down = np.array([np.cos(pitch_rad / 2), -np.sin(pitch_rad / 2), 0.0, 0.0])
    left = np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])
    return _quaternion_product(_quaternion_product(left, level), down)


def _quaternion_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Product of two quaternions (w, x, y, z)."""
    scalar = p[0] * q[0] - p[1:] @ q[1:]
    return np.append(scalar, p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:]))


def make_scenes(
    folder: Path, *, n_scenes: int = 3, n_samples: int = 8, seed: int = 0, width_px: int = 480
) -> None:
    """Write tables and pictures of a synthetic set: keyframes 0.5 s apart, pictures of 16 : 9.

    The first `n_samples - 6` keyframes of each scene have a recorded path.
    """
    draw = np.random.default_rng(seed)
    views = {channel: _View(channel, width_px) for channel in CAMERAS}
    tables: dict[str, list[dict[str, Any]]] = {
        name: [] for name in ("scene", "sample", "sample_data", "calibrated_sensor", "ego_pose")
    }
    tables["sensor"] = [
        {"token": _token("sensor", channel), "channel": channel, "modality": modality}
        for channel, modality in [*((c, "camera") for c in CAMERAS), (LIDAR, "lidar")]
    ]
    log = _token("log", seed)
    tables["log"] = [
        {
            "token": log,
            "logfile": f"generated-{seed}",
            "vehicle": "made-up",
            "date_captured": "2018-07-24",
            "location": "made-up-road",
        }
    ]
    tables["calibrated_sensor"] = [
        {
            "token": _token("calibrated_sensor", channel),
            "sensor_token": _token("sensor", channel),
            "translation": view.translation.tolist(),
            "rotation": view.rotation.tolist(),
            "camera_intrinsic": view.intrinsic.tolist(),
        }
        for channel, view in views.items()
    ]
    tables["calibrated_sensor"].append(
        {
            "token": _token("calibrated_sensor", LIDAR),
            "sensor_token": _token("sensor", LIDAR),
            "translation": [0.94, 0.0, 1.84],
            "rotation": [0.7071067811865476, 0.0, 0.0, -0.7071067811865476],
            "camera_intrinsic": [],
        }
    )
    marks = {}
    for place in range(n_scenes):
        drive = Drive(
            start_m=draw.uniform(300, 1500, 2).round(2),
            yaw_rad=float(draw.uniform(-np.pi, np.pi)),
            curvature_per_m=float(draw.choice([-1, 1]) / draw.uniform(90, 900)),
            speed_mps=float(draw.uniform(5, 11)),
            acceleration_mps2=float(draw.uniform(-1.2, 0.8)),
        )
        name = f"scene-{place + 1:04d}"
        marks[name] = drive.marks_m().round(4).tolist()
        _add_scene(folder, tables, drive, name, _token("scene", seed, place), n_samples, views)
        tables["scene"][-1]["log_token"] = log
    (folder / VERSION).mkdir(parents=True, exist_ok=True)
    for table, rows in tables.items():
        _write(folder / VERSION / f"{table}.json", rows)
    _write(folder / "marks.json", marks)


def _add_scene(
    folder: Path,
    tables: dict[str, list[dict[str, Any]]],
    drive: Drive,
    name: str,
    scene_token: str,
    n_samples: int,
    views: dict[str, _View],
) -> None:
    tokens = [_token(scene_token, index) for index in range(n_samples)]
    bend = "left" if drive.curvature_per_m > 0 else "right"
    tables["scene"].append(
        {
            "token": scene_token,
            "name": name,
            "description": f"Two-lane road that bends {bend}, daylight, no other traffic",
            "nbr_samples": n_samples,
            "first_sample_token": tokens[0],
            "last_sample_token": tokens[-1],
        }
    )
    for index, token in enumerate(tokens):
        time_s = index * TIME_STEP_S
        timestamp = START_US + round(time_s * 1e6)
        tables["sample"].append(
            {
                "token": token,
                "timestamp": timestamp,
                "scene_token": scene_token,
                "prev": tokens[index - 1] if index else "",
                "next": tokens[index + 1] if index + 1 < n_samples else "",
            }
        )
        for channel in (*CAMERAS, LIDAR):
            view = views.get(channel)
            late_ms = view.shutter_ms if view else 0.0
            ending = "jpg" if view else "pcd.bin"
            file = f"samples/{channel}/{name}__{channel}__{index:03d}.{ending}"
            rotation, translation = drive.pose(time_s + late_ms / 1e3)
            reading = _token(token, channel)
            at_us = timestamp + round(late_ms * 1e3)
            tables["ego_pose"].append(
                {
                    "token": reading,
                    "timestamp": at_us,
                    "rotation": rotation.tolist(),
                    "translation": translation.tolist(),
                }
            )
            tables["sample_data"].append(
                {
                    "token": reading,
                    "sample_token": token,
                    "ego_pose_token": reading,
                    "calibrated_sensor_token": _token("calibrated_sensor", channel),
                    "timestamp": at_us,
                    "fileformat": ending.partition(".")[0],
                    "is_key_frame": True,
                    "height": view.height if view else 0,
                    "width": view.width if view else 0,
                    "filename": file,
                }
            )
            if view:
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (folder / file).write_bytes(view.picture(drive, time_s))


def _token(*parts: object) -> str:
    return hashlib.md5("/".join(map(str, parts)).encode(), usedforsecurity=False).hexdigest()


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=0) + "\n", encoding="utf-8")
