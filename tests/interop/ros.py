"""ROS 2 messages on DDS as somebody else writes them: types for `cyclonedds`, bytes by `rosbags`, nothing of calibd's."""

import types
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def dds_name(package, name):
    return f"{package}.msg.dds_.{name}_"


@dataclass
class Time(IdlStruct, typename=dds_name("builtin_interfaces", "Time")):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename=dds_name("std_msgs", "Header")):
    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename=dds_name("sensor_msgs", "Image")):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class CompressedImage(IdlStruct, typename=dds_name("sensor_msgs", "CompressedImage")):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class RegionOfInterest(IdlStruct, typename=dds_name("sensor_msgs", "RegionOfInterest")):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename=dds_name("sensor_msgs", "CameraInfo")):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class PointField(IdlStruct, typename=dds_name("sensor_msgs", "PointField")):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename=dds_name("sensor_msgs", "PointCloud2")):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Vector3(IdlStruct, typename=dds_name("geometry_msgs", "Vector3")):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename=dds_name("geometry_msgs", "Quaternion")):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Imu(IdlStruct, typename=dds_name("sensor_msgs", "Imu")):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class Transform(IdlStruct, typename=dds_name("geometry_msgs", "Transform")):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename=dds_name("geometry_msgs", "TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename=dds_name("tf2_msgs", "TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
class KeyValue(IdlStruct, typename=dds_name("diagnostic_msgs", "KeyValue")):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename=dds_name("diagnostic_msgs", "DiagnosticStatus")):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename=dds_name("diagnostic_msgs", "DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class DriftAlert(IdlStruct, typename=dds_name("calibd_msgs", "DriftAlert")):
    stamp: Time
    alert_sequence: uint64
    vehicle: str
    pair: str
    verdict: str
    previous_verdict: str
    reason: str
    rotation_rad: array[float64, 3]
    translation_m: array[float64, 3]
    sigma_rotation_rad: array[float64, 3]
    sigma_translation_m: array[float64, 3]
    record_sequence: uint64


DRIFT_ALERT_MSG = """
builtin_interfaces/Time stamp
uint64 alert_sequence
string vehicle
string pair
string verdict
string previous_verdict
string reason
float64[3] rotation_rad
float64[3] translation_m
float64[3] sigma_rotation_rad
float64[3] sigma_translation_m
uint64 record_sequence
"""

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(get_types_from_msg(DRIFT_ALERT_MSG, "calibd_msgs/msg/DriftAlert"))


def message(name, /, **fields):
    """A message for `rosbags`, e.g. message("sensor_msgs/Image", header=...)."""
    return STORE.types[name.replace("/", "/msg/")](**fields)


def cdr(name, value):
    return bytes(STORE.serialize_cdr(value, name.replace("/", "/msg/")))


def header(stamp_ns, frame_id):
    stamp = message("builtin_interfaces/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return message("std_msgs/Header", stamp=stamp, frame_id=frame_id)


# Cyclone DDS's configuration for a domain on loopback.
LOOPBACK = ('<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
            '</Domain></CycloneDDS>')


class Peer:
    """A participant on loopback. Writers take ready CDR, so that what is on the wire is what `rosbags` made."""

    XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)

    _domains = {}  # a program has one of each

    def __init__(self, domain):
        if domain not in self._domains:
            self._domains[domain] = Domain(domain, LOOPBACK)
        self._participant = DomainParticipant(domain)

    def writer(self, kind, topic, reliable=True):
        reliability = Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort
        qos = Qos(reliability, Policy.History.KeepLast(1), self.XCDR1)
        return DataWriter(self._participant, Topic(self._participant, "rt" + topic, kind), qos)

    def reader(self, kind, topic, latched=False, reliable=True):
        """One that is not reliable keeps the newest sample only."""
        durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        reliability = Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort
        history = Policy.History.KeepAll if reliable else Policy.History.KeepLast(1)
        qos = Qos(reliability, durability, history, self.XCDR1)
        return DataReader(self._participant, Topic(self._participant, "rt" + topic, kind), qos)


def write_cdr(writer, encoded):
    """Writes these bytes; Cyclone refuses what is not CDR of the writer's type."""
    sample = object.__new__(writer.data_type)
    sample.serialize = types.MethodType(lambda self, **_: encoded, sample)
    writer.write(sample)
