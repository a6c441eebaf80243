"""What calibd puts on the wire equals, byte for byte, what `rosbags` makes of the same values."""

import json
import subprocess

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine")
import ros  # noqa: E402

STAMP = 12 * 10**9 + 345  # of the messages that calibd reads, as made by tests/support/ros_messages.hpp


@pytest.fixture(scope="module")
def wire(bin_dir):
    """The messages that wire_dump received from calibd's writers, by topic."""
    done = subprocess.run([bin_dir / "tests" / "wire_dump"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    return {line["topic"]: line for line in lines}


def payload(encoded):
    """Without the encapsulation header, whose last two bits say how many bytes of padding end the message."""
    assert encoded[:2] == b"\x00\x01", "little-endian XCDR1"
    assert encoded[2] == 0 and encoded[3] < 4
    return encoded[4:len(encoded) - encoded[3]]


def transform():
    vector = ros.message("geometry_msgs/Vector3", x=0.1, y=-0.2, z=0.3)
    rotation = ros.message("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return ros.message("geometry_msgs/TransformStamped", header=ros.header(7 * 10**9, "camera"), child_frame_id="lidar",
                       transform=ros.message("geometry_msgs/Transform", translation=vector, rotation=rotation))


def cloud():
    points = np.array([[1 + i, 2, 3, i] for i in range(6)], np.float32)
    fields = [ros.message("sensor_msgs/PointField", name=name, offset=4 * i, datatype=7, count=1)
              for i, name in enumerate(["x", "y", "z", "intensity"])]
    return ros.message("sensor_msgs/PointCloud2", header=ros.header(STAMP, "lidar"), height=2, width=3, fields=fields,
                       is_bigendian=False, point_step=16, row_step=48, data=points.view(np.uint8).reshape(-1), is_dense=True)


def camera_info():
    roi = ros.message("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return ros.message(
        "sensor_msgs/CameraInfo", header=ros.header(STAMP, "camera"), height=480, width=640, distortion_model="plumb_bob",
        d=np.array([-0.3, 0.1, 0.001, -0.002, 0.01]), k=np.array([500, 0, 320, 0, 510, 240, 0, 0, 1], float),
        r=np.zeros(9), p=np.array([500, 0, 320, 0, 0, 510, 240, 0, 0, 0, 1, 0], float), binning_x=0, binning_y=0, roi=roi)


def disparity():
    picture = ros.message("sensor_msgs/Image", header=ros.header(STAMP, "camera"), height=4, width=6, encoding="32FC1",
                          is_bigendian=0, step=24, data=np.arange(1, 25, dtype=np.float32).view(np.uint8))
    window = ros.message("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return ros.message("stereo_msgs/DisparityImage", header=ros.header(STAMP + 10**9, "camera"), image=picture, f=200.0, t=0.5,
                       valid_window=window, min_disparity=0.0, max_disparity=0.0, delta_d=0.0625)


def vector(x, y, z):
    return ros.message("geometry_msgs/Vector3", x=x, y=y, z=z)


UPRIGHT = ros.message("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)


def imu():
    return ros.message("sensor_msgs/Imu", header=ros.header(STAMP, "imu"), orientation=UPRIGHT,
                       orientation_covariance=np.zeros(9), angular_velocity=vector(0.2, -0.3, 0.6),
                       angular_velocity_covariance=np.zeros(9), linear_acceleration=vector(0.0, 0.0, 9.8),
                       linear_acceleration_covariance=np.zeros(9))


def odometry():
    def covariance(last):
        return np.array([0.0] * 35 + [last])

    pose = ros.message("geometry_msgs/Pose", position=ros.message("geometry_msgs/Point", x=5.0, y=0.0, z=0.0),
                       orientation=UPRIGHT)
    twist = ros.message("geometry_msgs/Twist", linear=vector(8.0, 0.0, 0.0), angular=vector(0.2, -0.3, 0.6))
    return ros.message("nav_msgs/Odometry", header=ros.header(STAMP, "odom"), child_frame_id="base_link",
                       pose=ros.message("geometry_msgs/PoseWithCovariance", pose=pose, covariance=covariance(0.5)),
                       twist=ros.message("geometry_msgs/TwistWithCovariance", twist=twist, covariance=covariance(0.25)))


def known_values():
    """What wire_dump published, as far as calibd does not word it: by topic, the type and the value."""
    return {
        "/calibd/tf_static_proposed": ("tf2_msgs/TFMessage", ros.message("tf2_msgs/TFMessage", transforms=[transform()] * 2)),
        "/calibd/drift_alert": ("calibd_msgs/DriftAlert", ros.message(
            "calibd_msgs/DriftAlert", stamp=ros.message("builtin_interfaces/Time", sec=7, nanosec=9), alert_sequence=5,
            vehicle="demo-car", pair="front", verdict="drifted", previous_verdict="calibrated", reason="yaw",
            rotation_rad=np.array([0.1, 0.2, 0.3]), translation_m=np.array([0.4, 0.5, 0.6]),
            sigma_rotation_rad=np.array([1.0, 2.0, 3.0]), sigma_translation_m=np.array([4.0, 5.0, 6.0]),
            record_sequence=4)),
        "/image": ("sensor_msgs/Image", ros.message(
            "sensor_msgs/Image", header=ros.header(STAMP, "camera"), height=4, width=6, encoding="mono8", is_bigendian=0,
            step=6, data=np.full(24, 7, np.uint8))),
        "/image/compressed": ("sensor_msgs/CompressedImage", ros.message(
            "sensor_msgs/CompressedImage", header=ros.header(STAMP, "camera"), format="jpeg",
            data=np.array([1, 2, 3], np.uint8))),
        "/camera_info": ("sensor_msgs/CameraInfo", camera_info()),
        "/points": ("sensor_msgs/PointCloud2", cloud()),
        "/disparity": ("stereo_msgs/DisparityImage", disparity()),
        "/imu": ("sensor_msgs/Imu", imu()),
        "/odometry": ("nav_msgs/Odometry", odometry()),
    }


@pytest.mark.parametrize("topic", known_values())
def test_cdr_is_byte_equal_with_rosbags(wire, topic):
    name, value = known_values()[topic]
    assert payload(bytes.fromhex(wire[topic]["cdr"])) == payload(ros.cdr(name, value))


def test_diagnostics_read_and_written_again_by_rosbags_are_byte_equal(wire):
    encoded = bytes.fromhex(wire["/diagnostics"]["cdr"])
    value = ros.STORE.deserialize_cdr(encoded, "diagnostic_msgs/msg/DiagnosticArray")
    assert payload(ros.cdr("diagnostic_msgs/DiagnosticArray", value)) == payload(encoded)
    assert (value.header.stamp.sec, value.header.stamp.nanosec) == (1_700_000_000, 5)
    (status,) = value.status
    assert (status.level, status.name, status.hardware_id) == (1, "calibd: front", "demo-car")
    assert status.message == "suspect: yaw has moved"
    values = {entry.key: entry.value for entry in status.values}
    assert values["verdict"] == "suspect" and values["evaluated"] == "12" and values["skipped low_overlap"] == "3"


def test_type_names_and_hashes_are_those_of_ros(wire):
    assert len(wire) == 10
    for line in wire.values():
        package, name = line["type"].removesuffix("_").split("::msg::dds_::")
        assert line["user_data"] == f"typehash={ros.STORE.hash_rihs01(f'{package}/msg/{name}')};"
