"""Writes a KITTI raw drive as recordings of ROS 2, by the packages rosbags and mcap-ros2-support."""

import dataclasses
import io
import pathlib

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as McapRos2Writer
from PIL import Image
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_700_000_000_000_000_000
TYPES = get_typestore(Stores.ROS2_HUMBLE)
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, CLOUD, TRANSFORMS = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"


@dataclasses.dataclass
class Sent:
    """A message and where it goes."""

    topic: str
    type: str
    stamp: int
    message: object


def make(type_name, **fields):
    return TYPES.types[type_name](**fields)


def header(stamp, frame):
    return make("std_msgs/msg/Header", frame_id=frame,
                stamp=make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9))


def octets(data):
    return np.frombuffer(data, np.uint8)


def image(stamp, frame, pixels):
    """Grey, or red, green and blue."""
    return make(IMAGE, header=header(stamp, frame), height=pixels.shape[0], width=pixels.shape[1],
                encoding="mono8" if pixels.ndim == 2 else "rgb8", is_bigendian=0, step=pixels.strides[0], data=pixels.reshape(-1))


def compressed_image(stamp, frame, pixels):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=95)
    return make(COMPRESSED_IMAGE, header=header(stamp, frame), format="jpeg", data=octets(file.getvalue()))


def depth_image(stamp, frame, drive, encoding):
    depth_m = drive.dense_depth((stamp - START_NS) // 100_000_000)
    values = (1000 * depth_m).astype(np.uint16) if encoding == "16UC1" else depth_m.astype(np.float32)
    return make(IMAGE, header=header(stamp, frame), height=values.shape[0], width=values.shape[1], encoding=encoding,
                is_bigendian=0, step=values.strides[0], data=octets(values.tobytes()))


def camera_info(stamp, frame, size, P, distortion=(0.0,) * 5):
    K = np.array([P[0], 0, P[2], 0, P[5], P[6], 0, 0, 1], np.float64)
    return make(CAMERA_INFO, header=header(stamp, frame), height=size[1], width=size[0], distortion_model="plumb_bob",
                d=np.array(distortion, np.float64), k=K, r=np.eye(3).reshape(-1), p=np.array(P, np.float64), binning_x=0,
                binning_y=0, roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
                                      do_rectify=False))


def cloud(stamp, frame, points):
    fields = [make("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
              for i, name in enumerate(("x", "y", "z", "intensity"))]
    return make(CLOUD, header=header(stamp, frame), height=1, width=len(points), fields=fields, is_bigendian=False,
                point_step=16, row_step=16 * len(points), data=octets(points.tobytes()), is_dense=True)


def quaternion_xyzw(R):
    """Of a rotation of less than half a turn, which is not near that."""
    w = np.sqrt(max(0.0, 1 + np.trace(R))) / 2
    return (R[2, 1] - R[1, 2]) / (4 * w), (R[0, 2] - R[2, 0]) / (4 * w), (R[1, 0] - R[0, 1]) / (4 * w), w


def transforms(stamp, *edges):
    """Each edge: parent, child, T_parent_child as 4 x 4."""
    def stamped(parent, child, T):
        x, y, z, w = quaternion_xyzw(T[:3, :3])
        return make("geometry_msgs/msg/TransformStamped", header=header(stamp, parent), child_frame_id=child,
                    transform=make("geometry_msgs/msg/Transform",
                                   translation=make("geometry_msgs/msg/Vector3", x=T[0, 3], y=T[1, 3], z=T[2, 3]),
                                   rotation=make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)))
    return make(TRANSFORMS, transforms=[stamped(*edge) for edge in edges])


class Drive:
    """A KITTI raw drive, read by nothing of ours."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        values = {}
        for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
            for line in (self.folder.parent / name).read_text().splitlines():
                key, _, text = line.partition(":")
                try:
                    values[key] = np.array([float(number) for number in text.split()])
                except ValueError:
                    pass
        self.P_left, self.P_right = values["P_rect_02"], values["P_rect_03"]
        self.R_rect, self.R, self.T = values["R_rect_00"].reshape(3, 3), values["R"].reshape(3, 3), values["T"]
        self.T_camera_lidar = np.eye(4)
        self.T_camera_lidar[:3, :3], self.T_camera_lidar[:3, 3] = self.R_rect @ self.R, self.R_rect @ self.T
        self.T_camera_lidar[0, 3] += self.P_left[3] / self.P_left[0]
        self.names = sorted(path.stem for path in (self.folder / "image_02/data").iterdir())

    def pixels(self, camera, name):
        return np.asarray(Image.open(self.folder / camera / "data" / f"{name}.png"))

    def points(self, name):
        return np.fromfile(self.folder / "velodyne_points/data" / f"{name}.bin", np.float32).reshape(-1, 4)

    def dense_depth(self, number):
        """Metres along the optical axis, of the nearest LiDAR point to the left in each row: rough, and complete."""
        points = self.points(self.names[number])[:, :3] @ self.T_camera_lidar[:3, :3].T + self.T_camera_lidar[:3, 3]
        points = points[points[:, 2] > 1]
        height, width = self.pixels("image_02", self.names[number]).shape
        fx, fy, cx, cy = self.P_left[[0, 5, 2, 6]]
        u = np.rint(fx * points[:, 0] / points[:, 2] + cx).astype(int)
        v = np.rint(fy * points[:, 1] / points[:, 2] + cy).astype(int)
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        depth_m = np.zeros((height, width), np.float32)
        depth_m[v[inside], u[inside]] = points[inside, 2]
        for column in range(1, width):
            empty = depth_m[:, column] == 0
            depth_m[empty, column] = depth_m[empty, column - 1]
        return np.minimum(depth_m, 60)

    def messages(self, right=True, info=True, tf="/tf_static", direct_tf=True, late_ns=0):
        """As drivers would have sent them: a frame each 100 ms."""
        height, width = self.pixels("image_02", self.names[0]).shape[:2]
        P_right = self.P_right.copy()
        P_right[3] -= self.P_left[3]  # as ROS has it: seen from the left camera
        P_left = self.P_left.copy()
        P_left[3] = 0
        if tf and direct_tf:
            yield Sent(tf, TRANSFORMS, START_NS, transforms(START_NS, ("camera_left", "lidar", self.T_camera_lidar)))
        elif tf:
            # By way of a frame of the vehicle, as in every description of one.
            T_base_lidar = np.eye(4)
            T_base_lidar[:3, 3] = 1.5, 0, 1.8
            T_base_camera = T_base_lidar @ np.linalg.inv(self.T_camera_lidar)
            yield Sent(tf, TRANSFORMS, START_NS, transforms(START_NS, ("base_link", "lidar", T_base_lidar),
                                                            ("base_link", "camera_left", T_base_camera)))
        for i, name in enumerate(self.names):
            stamp = START_NS + i * 100_000_000
            yield Sent("/lidar/points", CLOUD, stamp + late_ns, cloud(stamp + late_ns, "lidar", self.points(name)))
            if info:
                yield Sent("/camera/left/camera_info", CAMERA_INFO, stamp,
                           camera_info(stamp, "camera_left", (width, height), P_left))
            yield Sent("/camera/left/image_rect", IMAGE, stamp, image(stamp, "camera_left", self.pixels("image_02", name)))
            if right:
                yield Sent("/camera/right/image_rect", IMAGE, stamp,
                           image(stamp, "camera_left", self.pixels("image_03", name)))
                if info:
                    yield Sent("/camera/right/camera_info", CAMERA_INFO, stamp,
                               camera_info(stamp, "camera_left", (width, height), P_right))


def write_rosbag2(folder, messages, storage="mcap", compression=None):
    """By rosbags. `compression` is None, "file", "message" or (of MCAP) "storage"."""
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for sent in messages:
            if sent.topic not in connections:
                connections[sent.topic] = writer.add_connection(sent.topic, sent.type, typestore=TYPES)
            writer.write(connections[sent.topic], sent.stamp, bytes(TYPES.serialize_cdr(sent.message, sent.type)))
    return folder


def as_plain(value):
    """A message of rosbags as mcap-ros2-support takes it."""
    if dataclasses.is_dataclass(value):
        return {field.name: as_plain(getattr(value, field.name)) for field in dataclasses.fields(value)
                if not field.name.startswith("__")}
    if isinstance(value, np.ndarray):
        return bytes(value) if value.dtype == np.uint8 else value.tolist()
    return [as_plain(entry) for entry in value] if isinstance(value, list) else value


def write_mcap(path, messages, compression="zstd", **options):
    """By mcap-ros2-support. `compression` is none, lz4 or zstd; other options are those of its writer, or of mcap's own."""
    with open(path, "wb") as file:
        writer = McapRos2Writer(file if not options else io.BytesIO(), compression=CompressionType[compression.upper()])
        if options:  # which its writer does not pass on
            writer._writer = McapWriter(file, compression=CompressionType[compression.upper()], **options)
            writer._writer.start(profile="ros2", library="mcap-ros2-support")
        schemas = {}
        for sent in messages:
            if sent.type not in schemas:
                definition, _ = TYPES.generate_msgdef(sent.type, ros_version=2)
                schemas[sent.type] = writer.register_msgdef(sent.type, definition)
            writer.write_message(topic=sent.topic, schema=schemas[sent.type], message=as_plain(sent.message),
                                 log_time=sent.stamp, publish_time=sent.stamp)
        writer.finish()
    return path
