"""Definitions of ROS 2 messages with measurements, and extraction of their numbers.

Definitions: github.com/ros2/common_interfaces (std_msgs, sensor_msgs, geometry_msgs),
github.com/ros2/geometry2 (tf2_msgs) and github.com/ros2/rcl_interfaces (builtin_interfaces),
without their comments. Messages of `leglab_msgs` are leglab's, with one number per field.
"""

from collections.abc import Mapping
from typing import Any

JOINT_STATE = "sensor_msgs/msg/JointState"
FLOAT64 = "std_msgs/msg/Float64"
FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
TEMPERATURE = "sensor_msgs/msg/Temperature"
STRING = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
OWN_PACKAGE = "leglab_msgs/msg/"  # Package of messages with several columns of one joint

# Name of a message's field with its number or array, for types where it is not `data`.
_FIELDS = {FLUID_PRESSURE: "fluid_pressure", TEMPERATURE: "temperature"}
# Messages that are fields of other messages, each before the messages it contains.
_WITHIN = {
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
}


def _whole(fields: str) -> str:
    """Returns a message's definition, followed by the definitions of the messages in it."""
    for kind, inner in _WITHIN.items():
        if f"{kind} " in fields or f"{kind}[] " in fields:
            fields += f"{'=' * 80}\nMSG: {kind}\n{inner}"
    return fields


_STAMPED = "std_msgs/Header header\n"
_MESSAGES = {
    JOINT_STATE: f"{_STAMPED}string[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort\n",
    STRING: "string data\n",
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms\n",
    FLUID_PRESSURE: f"{_STAMPED}float64 fluid_pressure\nfloat64 variance\n",
    TEMPERATURE: f"{_STAMPED}float64 temperature\nfloat64 variance\n",
    FLOAT64: "float64 data\n",
    "std_msgs/msg/Float32": "float32 data\n",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data\n",
    "std_msgs/msg/Float32MultiArray": "std_msgs/MultiArrayLayout layout\nfloat32[] data\n",
}
DEFINITIONS = {kind: _whole(fields) for kind, fields in _MESSAGES.items()}
"""Of the messages that are written, and of those that older bags do not define."""


def supported(kind: str) -> bool:
    """Tests whether `numbers` can extract numbers from messages of a type."""
    theirs = kind in DEFINITIONS and kind not in (STRING, TRANSFORMS)
    return theirs or kind.startswith(OWN_PACKAGE)


def own_definition(fields: Mapping[str, str]) -> str:
    """Returns the definition of a leglab message from units by field, "" for an unknown unit."""
    lines = (f"float64 {name}" + f"  # {unit}" * bool(unit) for name, unit in fields.items())
    return _whole(_STAMPED + "".join(f"{line}\n" for line in lines))


def numbers(kind: str, message: Any, topic: str, is_clock: bool) -> dict[str, float]:
    """Returns the numbers of a decoded message of a `supported` type, by column name.

    Columns of the JointState topic of the time axis are `<joint>_position` and so on; columns of
    other topics begin with the topic.

    Raises:
        ValueError: The fields do not fit together.
    """
    owner = topic.removeprefix("/")
    if kind.startswith(OWN_PACKAGE):
        joint = owner.rpartition("/")[0]
        fields = (field for field in message.__slots__ if field != "header")
        return {f"{joint}_{field}": float(getattr(message, field)) for field in fields}
    if kind.endswith("Array"):
        return {f"{owner}[{i}]": float(value) for i, value in enumerate(message.data)}
    if kind != JOINT_STATE:
        return {owner: float(getattr(message, _FIELDS.get(kind, "data")))}
    names = [joint if is_clock else f"{owner}/{joint}" for joint in message.name]
    if len(set(names)) < len(names):
        raise ValueError(f"joints {message.name} are not all different")
    found: dict[str, float] = {}
    for field in ("position", "velocity", "effort"):
        values = getattr(message, field)
        # The definition allows an empty array for a quantity that is not measured.
        if len(values) not in (0, len(names)):
            raise ValueError(f"{len(values)} values of {field} for {len(names)} joints")
        ends = f"_{field}" if is_clock else f"/{field}"
        found |= {name + ends: float(x) for name, x in zip(names, values, strict=False)}
    return found


def scalar(column: str) -> tuple[str, str]:
    """Returns the most specific message type for a scalar column, and its field."""
    kind = TEMPERATURE if column.endswith("_temperature") else FLOAT64
    if column.endswith(("_pressure", "_pressure_a", "_pressure_b")):
        kind = FLUID_PRESSURE
    return kind, _FIELDS.get(kind, "data")


def header(stamp: int) -> dict[str, Any]:
    """Returns a message header with a time stamp [ns]."""
    second, nanosecond = divmod(stamp, 10**9)
    return {"stamp": {"sec": second, "nanosec": nanosecond}, "frame_id": ""}
