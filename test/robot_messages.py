"""Messages of other robots' drivers with the fields of a mapping; definitions as bags contain them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from hd_diag.bag import BagWriter
from hd_diag.messages.schemas import Definition

HEADER = f"""{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
DYNAMIC = Definition(
    "control_msgs/msg/DynamicJointState",
    f"""std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
{"=" * 80}
MSG: control_msgs/InterfaceValue
string[] interface_names
float64[] values
{HEADER}""",
)
FRANKA = Definition(
    "franka_msgs/msg/FrankaRobotState",
    f"""std_msgs/Header header
sensor_msgs/JointState measured_joint_state
sensor_msgs/JointState measured_joint_motor_state
float64[7] ddq_d
{"=" * 80}
MSG: sensor_msgs/JointState
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{HEADER}""",
)
KUKA = Definition(
    "lbr_fri_idl/msg/LBRState",
    """module lbr_fri_idl {
  module msg {
    typedef double double__7[7];
    struct LBRState {
      int8 session_state;
      uint32 time_stamp_sec;
      uint32 time_stamp_nano_sec;
      lbr_fri_idl::msg::double__7 measured_joint_position;
      lbr_fri_idl::msg::double__7 measured_torque;
    };
  };
};
""",
    "ros2idl",
)
JOINT_STATE = "sensor_msgs/msg/JointState"
START = 1_760_000_000 * 10**9  # [ns]


class Messages:
    """Makes messages of a type from its definition, and writes them into bags."""

    def __init__(self, known: Definition) -> None:
        self.known, self.store = known, get_typestore(Stores.EMPTY)
        parse = get_types_from_msg if known.encoding == "ros2msg" else None
        types = parse(known.text, known.type_name) if parse else get_types_from_idl(known.text)
        self.store.register(types)

    def of(self, short: str, *fields: Any) -> Any:
        """Message of a type, given by its last name."""
        (full,) = (name for name in self.store.types if name.endswith(f"/{short}"))
        return self.store.types[full](*fields)

    def header(self, stamp: int) -> Any:
        return self.of("Header", self.of("Time", stamp // 10**9, stamp % 10**9), "")

    def joint_state(self, stamp: int, names: list[str], *blocks: Any) -> Any:
        arrays = [np.array(block, np.float64) for block in blocks]
        return self.of("JointState", self.header(stamp), names, *arrays)

    def data(self, message: Any, little_endian: bool = True) -> bytes:
        name = self.known.type_name
        return bytes(self.store.serialize_cdr(message, name, little_endian=little_endian))

    def write(self, path: Path, topic: str, messages: Iterable[tuple[int, Any]]) -> Path:
        """Write a bag with messages at log times [ns]."""
        with BagWriter(path) as writer:
            writer.add_topic(topic, self.known.type_name, known=self.known)
            for time, message in messages:
                writer.write(topic, self.known.type_name, self.data(message), time)
        return path


def stamps(time: np.ndarray) -> list[int]:
    """Stamps [ns] of times [s]."""
    return [START + round(1e9 * t) for t in time.tolist()]


def dynamic_states(messages: Messages, given: dict[str, np.ndarray]) -> list[tuple[int, Any]]:
    """Messages of ros2_control's broadcaster; the other joint has other interfaces."""
    found = []
    columns = zip(stamps(given["time"]), given["input"], given["output"], given["torque"], strict=True)
    for stamp, motor, link, torque in columns:
        own = ["motor_position", "position", "effort"], np.array([motor, link, torque])
        other = ["effort", "position"], np.array([1.0, 2.0])
        values = [messages.of("InterfaceValue", *each) for each in (other, own)]
        header = messages.header(stamp)
        found.append((stamp, messages.of("DynamicJointState", header, ["shoulder", "elbow"], values)))
    return found


def franka_states(messages: Messages, given: dict[str, np.ndarray], ratio: float) -> list[tuple[int, Any]]:
    """Both encoders of a Franka's joint 4; the motor angle refers to the link's side."""
    names, found = [f"fr3_joint{i}" for i in range(1, 8)], []
    columns = zip(stamps(given["time"]), given["input"], given["output"], given["torque"], strict=True)
    for stamp, motor, link, torque in columns:
        motors, links, torques = (np.arange(7.0) for _ in range(3))
        motors[3], links[3], torques[3] = motor / ratio, link, torque
        state = messages.joint_state(stamp, names, links, [], torques)
        behind = messages.joint_state(stamp, names, motors, [], [])
        header = messages.header(stamp)
        found.append((stamp, messages.of("FrankaRobotState", header, state, behind, np.zeros(7))))
    return found


def kuka_states(messages: Messages, given: dict[str, np.ndarray]) -> list[tuple[int, Any]]:
    """A KUKA's joint 4 with one angle and the torque; no header."""
    found = []
    for stamp, link, torque in zip(stamps(given["time"]), given["output"], given["torque"], strict=True):
        links, torques = np.arange(7.0), np.arange(7.0)
        links[3], torques[3] = link, torque
        found.append((stamp, messages.of("LBRState", 4, stamp // 10**9, stamp % 10**9, links, torques)))
    return found
