"""Faults and their consequences in one table, which the tests run and the documentation prints.

    python test/faults.py

writes docs/tables/faults.md. `test_faults.py` runs commands, files and values through verbs, `test_node.py`
messages and values through a running node. Events with a test of their own name that test.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from live import MS, START, message, sample

from hd_diag.bag import BagWriter
from hd_diag.messages.encoding import encode_joint_states

PAGE = Path(__file__).resolve().parent.parent / "docs/tables/faults.md"
JOINT_STATE = "sensor_msgs/msg/JointState"

# Bad usage and input: code 2, one line with this text, no file made or changed ---

QUICK = "tolerance --samples 12 --sensitivity-samples 2 --jobs 1"
FLEET = "fleet a.mcap --jobs 1 --out f.parquet"
SIMULATE = "simulate --out out.mcap --duration 0.1"
COMMANDS: dict[str, dict[str, str]] = {
    "Usage": {
        "nonsense": "No such command 'nonsense'. 'hd-diag --help' lists them.",
        "chek": "No such command 'chek'. Did you mean 'check'?",
        "mesh --nonsense": "--nonsense",
        "check": "Missing argument 'CONFIG'",
        "mesh --torque x": "'x' is not a valid float",
        f"{QUICK} --samples -1": "--samples",
        "simulate --out joint.txt": "joint.txt: a bag is a file *.mcap, or a folder",
        "report a.mcap --out x.pdf": "x.pdf: the name must end with .html or .htm",
        "diagnose a.mcap --report a.mcap": "must end with .html",
        f"{QUICK} --figure a.txt": "a.txt: the name must end with .png",
        f"{FLEET} --figure f.xyz": "f.xyz: the name must end with .png or .svg or .pdf",
        f"{FLEET} --out f.csv": "f.csv: the name must end with .parquet",
        f"{FLEET} --scheduler tcp://127.0.0.1:9": "with --scheduler its workers set them",
        "report a.mcap --columns time=t": "need input, output",
        "replay a.mcap --out out.mcap": "is no log of the node, so a configuration is needed (--config)",
    },
    "Values": {
        "mesh --torque nan": "--torque must be a number of at most 1e+06",
        "mesh --torque -1e7": "--torque must be a number of at most 1e+06",
        "mesh --input-angle 1e300": "--input-angle must be a number of at most 1e+10",
        "mesh --joint c": "no joint 'c' in the configuration; it has joint_1",
        f"{FLEET} --joint elbow": "no joint 'elbow'",
        f"{FLEET} --robot (": "--robot (: ",
        f"{FLEET} --limit weight=1": "no quantity 'weight'",
        f"{FLEET} --limit eccentricity=x": "'x' is not a number",
        f"{FLEET} --limit eccentricity=nan": "must be positive and finite",
        f"{QUICK} --joint elbow": "no joint 'elbow' in the configuration; it has joint_1",
        f"{QUICK} --torque 0": "torque",
        f"{QUICK} --torque nan": "finite",
        f"{QUICK} --torque 1e300": "torque must be at most 1e+06 N m",
        f"{QUICK} --largest-um 500": "strikes the circular spline",
        f"{QUICK} --largest-um 0": "must be positive",
        f"{QUICK} --sensitivity-samples 100": "must be a power of two from 2 on, not 100",
        f"{QUICK} --sensitivity-samples 1": "power of two",
        f"{QUICK} --overlap-um nan": "the limit of overlap must be finite",
        f"{SIMULATE} --set joint_1.tooth_complianc=1e-6": "nearest known is 'joint_1.tooth_compliance'",
        f"{SIMULATE} --set joint_1.ratio": "expected PARAMETER=VALUE",
        f"{SIMULATE} --set joint_1.ratio=[1": "--set joint_1.ratio: not a value",
        f"{SIMULATE} --set joint_1.ratio=99": "its magnitude must be 100",
        f"{SIMULATE} --joint joint_9 --config two.yaml": "no joint 'joint_9' in the configuration; it has a",
        f"{SIMULATE} --rate nan": "sample_rate must be positive",
        f"{SIMULATE} --rate 1e300": "sample_rate must be at most 1e+09 Hz",
        f"{SIMULATE} --speed 1e300": "the input turns by more than 1e+10 rad",
        f"{SIMULATE} --torque-level 1e300": "torques must be at most 1e+06 N m",
        f"{SIMULATE} --angle-noise-arcsec -1": "noise: white must not be negative",
        "simulate --out out.mcap --duration 1e9 --speed 1e-3": "must end within 32 bits of Unix time",
        f"{SIMULATE} --start-time 1e12": "--start-time must be a Unix time within 32 bits",
    },
    "Files that are not there, or no place for a file": {
        "check none.yaml": "none.yaml: cannot be read: No such file or directory",
        "check empty": "File 'empty' is a directory",
        "mesh --config none.yaml": "none.yaml: cannot be read: No such file or directory",
        "node --config none.yaml": "none.yaml: cannot be read: No such file or directory",
        f"{QUICK} --config none.yaml": "none.yaml: cannot be read: No such file or directory",
        "report none.mcap": "none.mcap",
        "diagnose none.mcap": "none.mcap",
        "fleet none.mcap --out f.parquet": "none.mcap: does not exist",
        "fleet empty --out f.parquet": "no bag in empty",
        "replay circle --out out.mcap": "circle",
        "replay none.mcap --out out.mcap": "does not exist",
        "recover none.mcap --out out.mcap": "does not exist",
        "mesh --json no/folder.json": "folder.json: cannot be written: no such folder",
        f"{QUICK} --figure no/folder/a.png": "no such folder",
        f"{FLEET} --out none/f.parquet": "none/f.parquet: cannot be written: no such folder",
        f"{SIMULATE} --json missing/truth.json": "missing/truth.json: cannot be written: no such folder",
        "report a.mcap --out none/page.html": "no such folder",
        "diagnose a.mcap --report none/page.html": "no such folder",
        "replay a.mcap --out two.yaml/out.mcap": "no such folder",
        "replay a.mcap --out circle/out.mcap": "circle",
    },
    "Outputs over inputs, over each other, over what is there": {
        "simulate --out x --json x": "x and x must be different files",
        "report a.mcap --out a.htm --json a.htm": "must be different files",
        f"{FLEET} --json f.parquet": "must be different files",
        f"{FLEET} --json f.parquet.journal.jsonl": "must be different files",
        "simulate --out bag --overwrite --json bag/metadata.yaml": "must be different files",
        "diagnose a.mcap --config two.yaml --model m_a.json --json m_a.json": "m_a.json and m_a.json must be",
        "diagnose a.mcap --config m_a.json --model m.json": "m_a.json: output would overwrite the input",
        "report a.mcap --config a.html": "a.html: output would overwrite the input",
        "figures --out . --config figures.md": "figures.md: output would overwrite the input",
        "fleet a.mcap --out g.parquet --config g.parquet.journal.jsonl": "would overwrite the input",
        "fleet . --out f.parquet --json a.mcap": "a.mcap: output would overwrite the input",
        "mesh --config with_model --json model.json": "model.json: output would overwrite the input",
        "check with_model --json model.json": "model.json: output would overwrite the input",
        "replay a.mcap --out a.mcap": "overwrite the input",
        "replay a.mcap --out a.mcap/out.mcap": "a.mcap",
        "replay bag --out bag/out.mcap": "overwrite the input",
        "recover bag --out bag": "overwrite the input",
        "recover a.mcap --out link.mcap": "overwrite the input",
        "recover a.mcap --out hard.mcap": "same file as the input",
        "recover a.mcap --out bag/bag_0.mcap": "exists already: --overwrite replaces it",
        "replay a.mcap --config two.yaml --out bag": "exists already: --overwrite replaces it",
        "simulate --out bag": "exists already: --overwrite replaces it",
    },
}

# Files of recordings: each verb ends with this code and this text ---

VERBS = {
    "topics": "topics FILE",
    "diagnose": "diagnose FILE --orders-only",
    "report": "report FILE --out page.html",
    "ripple": "ripple FILE",
    "replay": "replay FILE --config one.yaml --out out.mcap",
    "recover": "recover FILE --out out.mcap",
}
COUNT = 150


def recording(path: Path) -> bytes:
    """A short recording of a moving joint under a varying torque, in chunks of 4 kB."""
    stamp, angle = START + 10 * MS * np.arange(COUNT), np.linspace(0.0, 40.0, COUNT)
    noise = 1e-5 * np.random.default_rng(0).standard_normal(COUNT)
    position = np.column_stack((angle, angle / 100.0 + noise))
    effort = np.column_stack((0.0 * angle, 20.0 * np.sin(0.3 * angle)))
    rows = encode_joint_states(("joint_1_motor", "joint_1"), stamp, position, None, effort)
    with BagWriter(path, compression="none", chunk_size=4000) as writer:
        for row, now in zip(rows, stamp.tolist(), strict=True):
            writer.write("/joint_states", JOINT_STATE, row.tobytes(), now)
    return path.read_bytes()


def flipped(whole: bytes) -> bytes:
    """The recording with one bit of a message in the middle inverted."""
    changed = bytearray(whole)
    changed[whole.index(b"joint_1_motor", len(whole) // 2)] ^= 1
    return bytes(changed)


Told = tuple[int, str]
CUT = "is cut off or damaged at byte"
# Too short to judge: `report` draws only the motion.
SHORT: dict[str, Told] = {"diagnose": (2, "too short: "), "ripple": (2, "too little motion")}
UNFINISHED = dict.fromkeys(VERBS, (0, CUT)) | dict.fromkeys(SHORT, (2, CUT))
FLIPPED = "its checksum is wrong"
SAVED = dict.fromkeys(("topics", "recover"), (0, FLIPPED))
FILES: dict[str, tuple[Callable[[bytes], bytes], dict[str, Told]]] = {
    "whole, but short": (lambda whole: whole, dict.fromkeys(VERBS, (0, "")) | SHORT),
    "cut off": (lambda whole: whole[: len(whole) * 4 // 5], UNFINISHED),
    "without its end": (lambda whole: whole[:-400], UNFINISHED),
    "one bit of a message flipped": (flipped, dict.fromkeys(VERBS, (2, FLIPPED)) | SAVED),
    "zeros": (
        lambda whole: whole[:8] + bytes(len(whole) - 8),
        dict.fromkeys(VERBS, (2, f"{CUT} 8")) | {"topics": (0, f"{CUT} 8")},
    ),
    "empty": (lambda whole: b"", dict.fromkeys(VERBS, (2, "is empty"))),
    "random bytes": (
        lambda whole: random.Random(1).randbytes(5000),
        dict.fromkeys(VERBS, (2, "is not an MCAP file")),
    ),
    "text": (lambda whole: b"time,input\n1,2\n", dict.fromkeys(VERBS, (2, "is not an MCAP file but text"))),
    "a bag of ROS 1": (
        lambda whole: b"#ROSBAG V2.0\n" + bytes(4096),
        dict.fromkeys(VERBS, (2, "is a ROS 1 bag: `rosbags-convert")),
    ),
}

# Messages: node and replay reject the sample, count it and continue ---

times = itertools.count(START, MS)


def shape(names: list[str], position: list[float]) -> bytes:
    """A message with more names than positions, which no encoder here produces."""
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState

    return bytes(serialize_message(JointState(name=names, position=position)))


MESSAGES: dict[str, tuple[Callable[[int], bytes], str]] = {
    "an angle that is no number": (
        lambda now: message(now, {"elbow_motor": np.nan}),
        "input angle of elbow_motor is nan",
    ),
    "a stamp a little before the last": (
        lambda now: sample(now - 100 * MS, 0.0, 0.0, 0.0, "elbow"),
        "stamp of elbow_motor is 0.09",
    ),
    "a stamp that repeats the last": (
        lambda now: sample(now - MS, 0.0, 0.0, 0.0, "elbow"),
        "stamp of elbow_motor repeats the last",
    ),
    "fewer values than names": (
        lambda now: shape(["elbow_motor", "elbow"], [1.0]),
        "has 1 values of position for 2",
    ),
    "cut off": (lambda now: sample(now, 0.0, 0.0, 0.0, "elbow")[:-20], ""),
    "bytes that are no message": (lambda now: b"\0\1\0\0no message", ""),
}

# Values: a running node refuses the change with this reason, `check` a file with code 2 ---

VALUES: list[tuple[dict[str, Any], str]] = [
    ({"elbow.eccentricity.magnitude": float("nan")}, "elbow.eccentricity.magnitude: expected a number"),
    ({"elbow.eccentricity.magnitude": 0.9e-3}, "strikes the circular spline"),
    ({"elbow.tilt.magnitude": 1e-3}, "give face_width and sections"),
    ({"elbow.sections": 3}, "give face_width [m]"),
    ({"elbow.neutral_curve.deformation": 1e-4}, "needs neutral_curve.shape, one of ellipse"),
    ({"elbow.ratio": 80.0}, "ratio 80 does not fit"),
    ({"elbow.tooth_compliance": "soft"}, "elbow.tooth_compliance: expected a number"),
    ({"elbow.flexspline_tooth.addendum_center": [1e-3]}, "expected two numbers"),
    ({"elbow.output": "cup"}, "expected one of flexspline, circular_spline"),
    ({"elbow.excentricity": 1e-6}, "unknown parameter 'elbow.excentricity'; the nearest known is 'elbow."),
    ({"elbow.nonsense": 1.0}, "unknown parameter 'elbow.nonsense', and none that is known is like it"),
]


def parameter_file(**given: Any) -> str:
    """Text of a parameter file; in names ``__`` stands for a dot."""
    section = {name.replace("__", "."): value for name, value in given.items()}
    return str(yaml.safe_dump({"hd_diag": {"ros__parameters": section}}))


STARTS: dict[str, tuple[str, list[str], tuple[str, ...]]] = {
    "an unknown parameter": (
        parameter_file(joint_1__eccentricty=1e-6),
        [],
        ("robot.yaml", "joint_1.eccentricty", "nearest known"),
    ),
    "a ratio that the teeth do not have": (
        parameter_file(joint_1__ratio=99.0),
        [],
        ("robot.yaml", "joint_1", "ratio 99", "must be 100"),
    ),
    "a file that is not YAML": ("hd_diag: [", [], ("robot.yaml", "not YAML")),
    "a bad value as an argument": (parameter_file(), ["-p", "joint_1.ratio:=80.0"], ("ratio 80",)),
    "a model file that is a device": (
        parameter_file(),
        ["-p", "joint_1.model_file:=/dev/zero"],
        ("'/dev/zero'", "no regular file"),
    ),
    "a model file that is not there, with a line break in its name": (
        parameter_file(joint_1__model_file="/none\nhere"),
        [],
        ("'/none\\nhere'", "cannot be read"),
    ),
    "an argument too many": (parameter_file(), ["--", "extra"], ("unknown arguments: extra",)),
    "an unknown option": (parameter_file(), ["--bogus"], ("'--bogus'",)),
}

# Events of machine, network and processes: the consequence, and the test that shows it ---

_EVENTS = """\
disk full | any verb | code 2, one line; what was there before stays
    test_cli.py::test_a_target_is_replaced_only_when_it_is_whole
disk full | fleet | code 2, one line; with room again the same command goes on
    test_cli_fleet.py::test_a_full_disk_under_the_journal_ends_a_run_that_then_goes_on
disk full | node | LOG_FAILED; samples go on; with room again the log, in a new file
    test_node_log.py::test_it_goes_on_in_a_new_file_when_writing_works_again
a start where a log lies already | node | a log of its own, named by date and time
    test_log_retention.py::test_every_start_has_a_log_of_its_own
logs over `log.max_size` or `log.max_age` | node | the oldest files go, never others' or what is written
    test_log_retention.py::test_the_oldest_go_until_the_rest_is_within_the_size
an old log that cannot be deleted | node | LOG_FAILED, which hides no fault of a joint; samples and log go on
    test_log_retention.py::test_a_file_that_cannot_be_deleted_is_told
a fault of a joint that begins | node | with `log.mode: snapshot` the minutes before it are written
    test_node_recording.py::test_a_snapshot_holds_what_was_before_it_and_replays
a fault that comes back soon | node | no other snapshot, no other diagnosis
    test_node_diagnosis.py::test_it_diagnoses_a_fault_once_with_what_was_before_and_after
a node that is killed beside a diagnosis | node | the diagnosis ends too
    test_node_diagnosis.py::test_a_fault_that_begins_beside_a_diagnosis_has_the_next
a diagnosis that is killed | node | told in `diagnosis_state`; the node lives
    test_node_recording.py::test_diagnoses_that_are_killed_or_outlived
a bit of the journal flipped | fleet | told; that result is judged again
    test_fleet_journal.py::test_a_result_that_has_changed_is_none
a worker killed by its bag | fleet | an error in that row; the others go on
    test_process_pool.py::test_what_kills_its_worker_fails_alone
a FIFO, a socket or a device for a bag | fleet | an error in that row; not opened
    test_cli_fleet.py::test_what_is_no_file_is_reported_and_not_opened
an address that is no scheduler's | fleet | code 2, one line
    test_process_pool.py::test_no_scheduler
Ctrl-C | replay, recover | code 130; the bag is whole as far as it goes
    test_cli_bags.py::test_ctrl_c_leaves_a_whole_bag_and_says_what_there_is
Ctrl-C | fleet | code 130; the same command goes on
    test_cli_fleet.py::test_an_interrupted_run_goes_on
SIGINT, SIGTERM | node | code 0; what was taken is answered and logged
    test_node.py::test_signals_while_messages_wait
a publisher that dies | node | STALE until another comes
    test_node.py::test_a_publisher_that_dies_and_comes_back
a name, a topic or a stamp that a joint waits for in vain | node | STALE says what arrives in its place
    test_node_absences.py::test_stale_says_why_live_and_in_the_replay
a robot description with entities, or another file | topics --urdf | code 2; of the bag itself a warning
    test_robot_description.py::test_what_is_no_description_is_refused_in_one_line
a second publisher of a joint | node | a warning until one goes
    test_node.py::test_a_second_publisher_of_a_joint_is_a_warning_until_it_goes
a publisher of best effort | node | heard likewise
    test_node.py::test_a_best_effort_publisher_that_appears_later
a clock set back | node | state starts again
    test_node.py::test_simulated_time_that_jumps_back
stamps of zero | node, bags | the time of reception stands for them; counted and said
    test_stamps_of_zero.py::test_stamps_of_zero_are_the_time_of_reception_and_that_is_said
effort zero or not a number throughout | node | said in the status
    test_health.py::test_a_torque_that_nothing_measured_is_told
values of a second publisher | node | a warning with the values
    test_health.py::test_values_of_a_second_publisher_are_told_while_they_come
efforts or velocities fewer than names | node, bags | not read; what is mapped by name is refused
    test_stamps_of_zero.py::test_what_is_not_mapped_is_not_checked
a recorder's clock set back | bags | told; what comes after is another recording
    test_recorder_clock.py::test_a_record_begins_another_recording_there
a message without a payload | node | subscribed again after 3.5 s; what is withheld counts as lost; a warning
    test_node_losses.py::test_a_message_without_payload_is_counted_and_skipped
more messages than the node can take | node | all are taken or counted as lost; a warning
    test_node_losses.py::test_all_of_a_flood_is_accounted_for_and_said
requests that make no sense | node | answered or dropped; samples go on
    test_node.py::test_requests_that_make_no_sense_are_survived
metadata that miscounts | verbs on bags | told
    test_incomplete.py::test_counts_of_the_metadata_are_compared
a database that hides rows | verbs on bags | told
    test_incomplete.py::test_a_database_that_hides_rows_is_damaged
another process that sets where the log is written | node | refused
    test_node_log.py::test_no_other_process_chooses_where_it_writes
a recording that is cut off | diagnose | code 0; text, verdict and JSON say that it is not whole
    test_incomplete.py::test_text_verdict_and_json_tell_it
bytes behind a message's last field | verbs on bags | read; nothing is refused
    test_recording.py::test_a_bag_of_what_rclpy_serializes
a torque far off its neighbours | verbs on bags | taken out, counted among the outliers
    test_record.py::test_a_torque_far_off_is_taken_out
a topic in JSON, protobuf, ROS 1's encoding, or of no schema | bags | listed, not read; recover copies it
    test_bag_foreign.py::test_what_cannot_be_read_is_listed_and_left_alone_and_copied
messages that rosbag2 compressed one by one, without metadata | bags | read
    test_bag_foreign.py::test_compressed_messages_need_no_metadata
a count of the file's own that is far too large | verbs on bags | told; takes no memory
    test_incomplete.py::test_a_count_is_but_a_hint
a bit of the summary flipped | verbs on bags | told; the chunks are read
    test_bag_recover.py::test_a_damaged_summary_is_told
a row or a message too long to be read | verbs on bags | left out; told with its size
    test_bag_foreign.py::test_a_row_that_was_too_long_is_told_with_its_size
a limit of the memory (ulimit -v) that does not suffice | verbs | code 2, one line
    test_memory.py::test_a_library_out_of_memory_is_one_line
counts of an encoder for an angle | diagnose | code 2; tells the bits and what to write
    test_record.py::test_counts_of_an_encoder_are_left_to_a_finding
a pipe for a table | diagnose, report, ripple, topics | code 2 at once
    test_text_table.py::test_a_pipe_is_refused_at_once
a time in ms, us or ns that is read as seconds | diagnose, ripple | code 2; asks for its unit
    test_text_table.py::test_a_time_in_another_unit_is_asked_about
both angles in degrees | diagnose | code 2; says so first
    test_signal_findings.py::test_both_angles_in_degrees
a torque that is zero, nan or a placeholder throughout | verbs on records | told; counts as not measured
    test_record.py::test_a_torque_that_is_none_is_told
a record in pieces of a few samples | diagnose, report | code 2; says how many are in pieces long enough
    test_record.py::test_records_that_cannot_be_judged
an output angle that never moves | diagnose | code 2; says where it stands
    test_record.py::test_records_that_cannot_be_judged
an input faster than any drive, by its unit or its stamps | diagnose, report, ripple | code 2; asks for units
    test_record.py::test_records_that_cannot_be_judged
stdout or stderr that is closed or full | verbs | code 0 or 2, no more than one line
    test_cli.py::test_streams_that_are_closed_or_full_or_read_no_more
a torque in another unit, such as N mm | diagnose | code 2; asks for its unit first
    test_signal_findings.py::test_a_torque_that_no_gear_bears
a torque behind a low-pass | ripple | no bound for what the filter takes off: its corner, and how slow to move
    test_ripple_limits.py::test_what_a_filter_takes_off_is_not_denied
a torque that is late | ripple | the delay is said; the lines are given without it
    test_ripple_limits.py::test_a_late_torque_is_said_and_its_lines_repeat
a ratio of the wrong sign | diagnose | code 2; tells the ratio that the angles have
    test_signal_findings.py::test_a_ratio_of_the_wrong_sign_is_not_taken_for_a_late_output
input and output swapped | diagnose | code 2; asks whether they are
    test_record.py::test_records_that_cannot_be_judged
disk full under what is printed | any verb | code 2, one line
    test_cli.py::test_streams_that_are_closed_or_full_or_read_no_more
disk full | watch --json | code 2, one line
    test_watch_live.py::test_a_full_disk_under_its_lines_is_one_line
"""
EVENTS = [
    (*map(str.strip, told.split("|")), proof.strip())
    for told, proof in zip(_EVENTS.splitlines()[::2], _EVENTS.splitlines()[1::2], strict=True)
]


def page() -> str:
    """The table as Markdown."""
    parts = ["## Command line", "Code 2, one line on stderr that holds this; no file is made or changed."]
    for title, commands in COMMANDS.items():
        rows = [(code(f"hd-diag {shortened(words)}"), code(said)) for words, said in commands.items()]
        parts.append(table((title, "the line says"), rows))
    parts += ["## Recordings", "MCAP files; the exit code, and what text or stderr say."]
    rows = [
        (fault, *(f"{told[0]}{': ' * bool(told[1])}{told[1]}" for told in verbs.values()))
        for fault, (_, verbs) in FILES.items()
    ]
    parts.append(table(("file", *VERBS), rows))
    text = (
        "Node and `replay` reject the sample, count it in `samples_rejected`, give the reason in "
        "`last_rejection`, and go on."
    )
    rows = [(what, code(said)) for what, (_, said) in MESSAGES.items()]
    parts += ["## Messages", text, table(("message", "reason"), rows)]
    text = (
        "A running node refuses the change with this reason and stays as it is; of a file with such a value "
        "`check` says the same with code 2."
    )
    rows = [(code(f"{name}: {value}"), code(said)) for given, said in VALUES for name, value in given.items()]
    parts += ["## Values", text, table(("parameter", "reason"), rows)]
    rows = [(what, ", ".join(map(code, said))) for what, (_, _, said) in STARTS.items()]
    text = "Code 2 and one line that holds these words."
    parts += ["## Start of the node", text, table(("fault", "words"), rows)]
    rows = [(what, where, outcome, code(proof.partition("::")[2])) for what, where, outcome, proof in EVENTS]
    head = ("fault", "at", "outcome", "test")
    parts += ["## Machine, network, processes", "Each with its test.", table(head, rows)]
    return "\n\n".join(parts) + "\n"


def shortened(words: str) -> str:
    """A command without the options that only shorten its run."""
    return words.replace(QUICK, "tolerance").replace(" --jobs 1", "").replace(" --duration 0.1", "")


def code(text: str) -> str:
    return f"`{text.strip()}`" if text.strip() else ""


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
