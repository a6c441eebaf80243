"""Recordings of one camera and one LiDAR, as calib-eval reads them: drives of KITTI raw, and lists of a rectified camera."""

import pathlib
from dataclasses import dataclass

import numpy as np


class RecordingError(Exception):
    """What is wrong with a recording, and what to do about it."""


@dataclass(frozen=True)
class Camera:
    """A rectified one. Pixels; (0, 0) is the centre of the top left pixel."""
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class Frame:
    name: str
    image: pathlib.Path
    right_image: pathlib.Path | None
    cloud: pathlib.Path


@dataclass(frozen=True)
class Recording:
    camera: Camera
    T_camera_lidar: np.ndarray  # 4 x 4, p_camera = T p_lidar, metres
    baseline_m: float | None    # to the right camera; none where there is none, or no images of it
    frames: list
    columns: tuple = ("float32", 4)  # numbers of a point in a .bin

    def image(self, frame):
        return read_grey(frame.image, self.camera)

    def right_image(self, frame):
        return read_grey(frame.right_image, self.camera)

    def points(self, frame):
        """N x 3, metres, in the LiDAR's frame."""
        kind, count = self.columns
        if frame.cloud.suffix.lower() != ".bin":
            raise RecordingError(f"{frame.cloud}: only clouds in .bin are read here; write them as float32x4")
        numbers = np.fromfile(frame.cloud, np.dtype(kind).newbyteorder("<"))
        if len(numbers) % count:
            raise RecordingError(f"{frame.cloud} does not hold whole points of {kind}x{count}; correct cloud_layout")
        points = numbers.reshape(-1, count)[:, :3].astype(np.float64)
        length = np.linalg.norm(points, axis=1)
        return points[np.isfinite(length) & (length > 0) & (length < 500)]


def read_grey(path, camera):
    import cv2  # not needed by what only projects points
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise RecordingError(f"{path} is no image that can be read")
    if image.shape != (camera.height, camera.width):
        raise RecordingError(f"{path} is {image.shape[1]} x {image.shape[0]}, and the calibration is of "
                             f"{camera.width} x {camera.height}")
    return image


def open_recording(path):
    path = pathlib.Path(path)
    recording = open_kitti_raw(path) if path.is_dir() else open_list(path)
    if not recording.frames:
        raise RecordingError(f"{path} has no image with a cloud of the same name")
    return recording


def frames_by_name(images, clouds, right_images=None):
    """Frames that have all their files, in the order of their names."""
    def files(folder):
        if not folder.is_dir():
            raise RecordingError(f"{folder} is not a folder")
        return {file.stem: file for file in sorted(folder.iterdir()) if file.is_file()}

    left, scans, right = files(images), files(clouds), files(right_images) if right_images else None
    return [Frame(name, left[name], right[name] if right else None, scans[name]) for name in sorted(left)
            if name in scans and (right is None or name in right)]


# --- KITTI raw ---

def read_kitti_calibration(path):
    values = {}
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise RecordingError(f"{path} cannot be read; it comes with the data set's calibration") from error
    for line in lines:
        key, _, numbers = line.partition(":")
        try:
            values[key] = np.array([float(number) for number in numbers.split()])
        except ValueError:
            continue  # calib_time
    return values


def open_kitti_raw(drive):
    """`image_02` of DATE/DRIVE, with `image_03` as its right neighbour where the drive has it."""
    date = drive.resolve().parent
    cameras = read_kitti_calibration(date / "calib_cam_to_cam.txt")
    lidar = read_kitti_calibration(date / "calib_velo_to_cam.txt")
    try:
        P, size, R_rect = cameras["P_rect_02"].reshape(3, 4), cameras["S_rect_02"], cameras["R_rect_00"].reshape(3, 3)
        R, t = lidar["R"].reshape(3, 3), lidar["T"]
        P_right = cameras["P_rect_03"].reshape(3, 4) if "P_rect_03" in cameras else None
    except (KeyError, ValueError) as error:
        raise RecordingError(f"the calibration of {date} lacks {error}") from error
    T = np.eye(4)
    shift = np.linalg.solve(P[:, :3], P[:, 3])
    T[:3, :3], T[:3, 3] = R_rect @ R, R_rect @ t + shift
    right = drive / "image_03" / "data"
    baseline_m = None
    if P_right is not None and right.is_dir():
        baseline_m = float((shift - np.linalg.solve(P_right[:, :3], P_right[:, 3]))[0])
    camera = Camera(int(size[0]), int(size[1]), P[0, 0], P[1, 1], P[0, 2], P[1, 2])
    frames = frames_by_name(drive / "image_02" / "data", drive / "velodyne_points" / "data",
                            right if baseline_m else None)
    return Recording(camera, T, baseline_m, frames)


# --- lists, described in tools/dataset/README.md ---

def rotation_of(quaternion_xyzw):
    x, y, z, w = np.asarray(quaternion_xyzw, float) / np.linalg.norm(quaternion_xyzw)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def open_list(path):
    import yaml
    try:
        entries = yaml.safe_load(path.read_text())
        if entries["camera"]["model"] != "rectified":
            raise RecordingError(f"{path}: the network learns from rectified images; camera.model is "
                                 f"{entries['camera']['model']}: rectify the images first")
        camera = Camera(*entries["camera"]["size"], *entries["camera"]["intrinsics"])
        given, T = entries["T_camera_lidar"], np.eye(4)
        if "matrix" in given:
            T[:3] = np.array(given["matrix"], float)[:3]
        else:
            T[:3, :3], T[:3, 3] = rotation_of(given["quaternion_xyzw"]), given["translation_m"]
        folder, baseline_m = path.parent, entries.get("baseline_m")
        kind, _, count = str(entries.get("cloud_layout", "float32x4")).partition("x")
        if "images" in entries:
            right = folder / entries["right_images"] if baseline_m and "right_images" in entries else None
            frames = frames_by_name(folder / entries["images"], folder / entries["clouds"], right)
        else:
            frames = [Frame(pathlib.Path(one["image"]).stem, folder / one["image"],
                            folder / one["right_image"] if baseline_m and "right_image" in one else None,
                            folder / one["cloud"]) for one in entries["frames"]]
        stereo = bool(frames) and all(frame.right_image for frame in frames)
        return Recording(camera, T, baseline_m if stereo else None, frames, (kind, int(count)))
    except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise RecordingError(f"{path} is neither a drive of KITTI raw nor the YAML file of a list: {error!r}") from error


# --- geometry ---

def project(points, T_camera_lidar, camera):
    """Pixels (N x 2) and depths along the optical axis (N, metres) of the points that are visible."""
    p_camera = points @ T_camera_lidar[:3, :3].T + T_camera_lidar[:3, 3]
    p_camera = p_camera[p_camera[:, 2] > 0.1]
    z = p_camera[:, 2]
    uv = np.stack([camera.fx * p_camera[:, 0] / z + camera.cx, camera.fy * p_camera[:, 1] / z + camera.cy], axis=1)
    inside = (uv > -0.5).all(1) & (uv[:, 0] < camera.width - 0.5) & (uv[:, 1] < camera.height - 0.5)
    return uv[inside], z[inside]


# Across and down, and 1/m. A LiDAR's rows are 0.4 degrees apart and more. Between sensors that are d apart, what is nearer
# by an inverse depth of 0.02/m moves by 0.02 d f pixels: 4 at d = 0.3 m and f = 700, where less does no harm. A road 1 m
# below the camera changes by as much over two cells, and hides nothing.
GUARD_RAD, GUARD_INVERSE = (0.004, 0.010), 0.02


def not_occluded(uv, z, camera):
    """Which points the camera sees, too. The LiDAR is mounted beside it and sees behind what is near: a point is left out
    when one in its cell of GUARD_RAD or in those around it is nearer by GUARD_INVERSE."""
    across, down = max(1, round(GUARD_RAD[0] * camera.fx)), max(1, round(GUARD_RAD[1] * camera.fy))
    column, row = np.rint(uv[:, 0]).astype(int) // across, np.rint(uv[:, 1]).astype(int) // down
    nearest = np.zeros((row.max(initial=0) + 3, column.max(initial=0) + 3))
    np.maximum.at(nearest, (row + 1, column + 1), 1 / z)
    around = np.max([nearest[row + i, column + j] for i in range(3) for j in range(3)], axis=0)
    return around - 1 / z <= GUARD_INVERSE


def visible_points(recording, frame):
    """Pixels and depths of the points of a frame that the camera sees."""
    uv, z = project(recording.points(frame), recording.T_camera_lidar, recording.camera)
    seen = not_occluded(uv, z, recording.camera)
    return uv[seen], z[seen]
