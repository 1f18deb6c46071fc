"""Recordings of a simulated flight, written by other people's programs: ROS 1 bags and MCAP files.

Also a small tool: `python recordings.py flight.csv flight.bag` turns a CSV of `crazyflie fly` into what the thesis's
rig would have recorded.
"""

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np

START_NS = 1_500_000_000_000_000_000
COMMAND, IMU, POSE = "/crazyflie/cmd_vel", "/crazyflie/imu", "/ar_single_board/pose"


def rows(path):
    """The rows of a CSV: numbers by column, empty cells left out."""
    with open(path, newline="") as file:
        return [{name: float(cell) for name, cell in row.items() if cell} for row in csv.DictReader(file)]


def stamp_ns(t_s):
    return START_NS + round(t_s * 1e9)


def messages(flight, store):
    """(topic, type, time of record, message) of a flight, as `crazyflie_ros` and a marker detector publish them."""
    kind = store.types
    vector, quaternion = kind["geometry_msgs/msg/Vector3"], kind["geometry_msgs/msg/Quaternion"]
    header, time = kind["std_msgs/msg/Header"], kind["builtin_interfaces/msg/Time"]
    point, pose = kind["geometry_msgs/msg/Point"], kind["geometry_msgs/msg/Pose"]

    def head(t_s):
        ns = stamp_ns(t_s)
        args = {"stamp": time(sec=ns // 10**9, nanosec=ns % 10**9), "frame_id": "crazyflie/base_link"}
        return header(seq=0, **args) if "seq" in header.__dataclass_fields__ else header(**args)

    def nine(first):
        return np.array([first] + [0.0] * 8)

    for row in flight:
        t_s = row["t_s"]
        # degrees and counts, pitch along x: what the driver sends to the vehicle
        linear = vector(x=row["cmd_pitch_deg"], y=row["cmd_roll_deg"], z=row["cmd_thrust_pwm"])
        angular = vector(x=0.0, y=0.0, z=row["cmd_yaw_rate_degps"])
        command = kind["geometry_msgs/msg/Twist"](linear=linear, angular=angular)
        yield COMMAND, "geometry_msgs/msg/Twist", stamp_ns(t_s), command
        imu = kind["sensor_msgs/msg/Imu"](
            header=head(t_s),
            orientation=quaternion(x=0.0, y=0.0, z=0.0, w=0.0),
            orientation_covariance=nine(-1.0),
            angular_velocity=vector(x=row["gyro_x_radps"], y=row["gyro_y_radps"], z=row["gyro_z_radps"]),
            angular_velocity_covariance=nine(0.0),
            linear_acceleration=vector(x=row["acc_x_mps2"], y=row["acc_y_mps2"], z=row["acc_z_mps2"]),
            linear_acceleration_covariance=nine(0.0),
        )
        yield IMU, "sensor_msgs/msg/Imu", stamp_ns(t_s + 0.002), imu
        if "marker_x_m" in row:
            half = math.radians(row["marker_yaw_deg"]) / 2
            place = point(x=row["marker_x_m"], y=row["marker_y_m"], z=row["marker_z_m"])
            turned = quaternion(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
            seen = kind["geometry_msgs/msg/PoseStamped"](
                header=head(row["marker_t_s"]), pose=pose(position=place, orientation=turned)
            )
            yield POSE, "geometry_msgs/msg/PoseStamped", stamp_ns(t_s - 0.001), seen


def write_bag(flight, path, compression=None):
    """A ROS 1 bag, by the package `rosbags`."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        connections = {}
        for topic, kind, time_ns, message in messages(flight, store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time_ns, store.serialize_ros1(message, kind))


def write_mcap(flight, path, encoding):
    """ROS messages as MCAP, by the package `mcap`; `encoding` is ros1 or cdr."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = encoding == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile=encoding)
        channels = {}
        for topic, kind, time_ns, message in messages(flight, store):
            if topic not in channels:
                name = kind.replace("/msg/", "/") if is_ros1 else kind
                schema = writer.register_schema(name=name, encoding="ros1msg" if is_ros1 else "ros2msg", data=b"")
                channels[topic] = writer.register_channel(topic=topic, message_encoding=encoding, schema_id=schema)
            data = store.serialize_ros1(message, kind) if is_ros1 else store.serialize_cdr(message, kind)
            writer.add_message(channels[topic], log_time=time_ns, publish_time=time_ns, data=bytes(data))
        writer.finish()


def write_rows(flight, path):
    """The project's own rows as MCAP, by the package `mcap`."""
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="crazyflie.FlightRow", encoding="jsonschema", data=b'{"type": "object"}')
        channel = writer.register_channel(topic="flight", message_encoding="json", schema_id=schema)
        for row in flight:
            time_ns = round(row["t_s"] * 1e9)
            writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=json.dumps(row).encode())
        writer.finish()


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    write_bag(rows(source), target)
