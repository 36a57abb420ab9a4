"""The node's log while it runs: fixed when the node starts, complete, and going on after what goes wrong."""

import contextlib
import itertools
import resource
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from live import MS, START, parameters
from logs import content
from rcl_interfaces.srv import DescribeParameters
from rclpy.serialization import deserialize_message
from running import Rig, feed, running, stamp_of, values_of
from sensor_msgs.msg import JointState

from hd_diag.bag import BagReader
from hd_diag.config.parameters import NODE_PARAMETERS
from hd_diag.replay.replay import replay

pytestmark = pytest.mark.usefixtures("ros")

stamps = itertools.count(START, MS)
well: set[int] = set()  # those of samples that came while the log was well, and must be in it
FIXED = tuple(p.name.removeprefix("log.") for p in NODE_PARAMETERS if p.name.startswith("log."))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A node that writes into the folder ``log``; its tests share its time."""
    folder = tmp_path_factory.mktemp("logged")
    log = {
        "log.path": str(folder / "log"),
        "log.overwrite": True,
        "log.flush_period": 0.05,
        "log.sync_period": 0.1,
    }
    with running(folder, parameters(diagnostics_rate=20.0, **log)) as rig:
        rig.folder = folder  # type: ignore[attr-defined]
        yield rig


@pytest.fixture(scope="module")
def publisher(rig: Rig) -> Any:
    return rig.publisher()


def log_of(rig: Rig) -> Path:
    return Path(rig.folder / "log")  # type: ignore[attr-defined]


def predicted(rig: Rig) -> list[int]:
    """Stamps of the predictions in the log [ns]."""
    logged = content(log_of(rig)).get(f"{rig.process.namespace}/hd_diag/transmission_error", [])
    return [stamp_of(deserialize_message(data, JointState)) for _, data in logged]


def test_no_other_process_chooses_where_it_writes(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "link.mcap").symlink_to("precious")
    own = {"path": str(tmp_path / "link.mcap"), "overwrite": True, "split_size": 1}
    together = {f"log__{name}": value for name, value in own.items()}
    for given in (*({name: value} for name, value in together.items()), together):
        (answer,) = rig.set(atomically=True, **given)
        name = next(iter(given)).replace("__", ".")
        assert (answer.successful, answer.reason) == (
            False,
            f"{name}: is fixed when the node starts (read-only)",
        )
    client = rig.node.create_client(
        DescribeParameters, f"{rig.process.namespace}/hd_diag/describe_parameters"
    )
    rig.until(client.service_is_ready, "service")
    asked = client.call_async(DescribeParameters.Request(names=[f"log.{name}" for name in FIXED]))
    rig.until(asked.done, "answer")
    assert [descriptor.read_only for descriptor in asked.result().descriptors] == [True] * len(FIXED)
    assert rig.values("joint_1")["log_state"] == f"writing {log_of(rig)}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.mcap", "precious"]
    assert (tmp_path / "precious").read_text() == "precious"


def feed_well(rig: Rig, publisher: Any) -> None:
    """Publish samples while the log is well, until it has their predictions."""
    sent = list(itertools.islice(stamps, 100))
    feed(publisher, iter(sent), len(sent))
    well.update(sent)
    rig.until(lambda: well <= {*predicted(rig)}, "predictions in the log")


def deleted(rig: Rig) -> Callable[[], None]:
    shutil.rmtree(log_of(rig))
    well.clear()
    return lambda: None


def full(rig: Rig) -> Callable[[], None]:
    """Files of the node may not be longer than some of them are."""
    before = resource.prlimit(rig.process.popen.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(rig.process.popen.pid, resource.RLIMIT_FSIZE, (2000, before[1]))
    return lambda: resource.prlimit(rig.process.popen.pid, resource.RLIMIT_FSIZE, before) and None


@pytest.mark.parametrize(
    ("harm", "reason", "number"), [(deleted, "was deleted or moved", 1), (full, "File too large", 2)]
)
def test_it_goes_on_in_a_new_file_when_writing_works_again(
    rig: Rig, publisher: Any, harm: Callable[[Rig], Callable[[], None]], reason: str, number: int
) -> None:
    """A folder that is deleted, a disk that is full: the node says so, lives on, and logs again by itself.

    Of what comes meanwhile the end may be logged: the node tries again after a second, and a busy machine may
    need longer for the samples.
    """
    assert rig.set(joint_1__runout__magnitude=1e-6)[0].successful
    feed_well(rig, publisher)
    seen, before = len(rig.reports), int(rig.values("joint_1")["log_lost"])

    def failure() -> dict[str, str] | None:
        """Since the harm: a busy machine may have gone on from it while all this was published."""
        every = (values_of(array.status[0]) for array in rig.reports[seen:])
        return next((values for values in every if "LOG_FAILED" in values["fault_codes"]), None)

    mend, sent = harm(rig), [*itertools.islice(stamps, 150)]
    feed(publisher, iter(sent), 100)
    failed = rig.until(failure, "failure of the log")
    assert reason in failed["log_state"]
    feed(publisher, iter(sent[100:]), 50)
    rig.values("joint_1", lambda v: int(v["samples"]) >= int(failed["samples"]) + 50)
    mend()
    values = rig.values("joint_1", lambda values: "LOG_FAILED" not in values["fault_codes"])
    assert values["log_state"] == f"writing {log_of(rig) / f'log_{number}.mcap'}"
    lost = int(values["log_lost"]) - before
    assert lost >= max(1, len({*sent} - {*predicted(rig)}))
    assert rig.set(joint_1__runout__magnitude=2e-6)[0].successful
    feed_well(rig, publisher)


def test_what_it_wrote_is_whole_and_replays(rig: Rig, publisher: Any, tmp_path: Path) -> None:
    """The files after the first begin with all that the node knew: counters, parameters, the map in force."""
    rig.values("joint_1", lambda values: values["samples"] == "700")
    assert rig.process.end() == 0
    assert rig.process.output().count("]: log failed: ") == 2  # a fault of the joint may tell of it too
    with BagReader(log_of(rig)) as reader:
        assert [problem for problem in reader.problems if "log_0.mcap" not in problem] == []
    replay(log_of(rig), tmp_path / "again.mcap")
    found = predicted(rig)
    assert found == sorted({*found} | well)
    live, again = content(log_of(rig)), content(tmp_path / "again.mcap")
    for topic, logged in live.items():
        both = [message for message in logged if message in again[topic]]
        assert [message for message in again[topic] if message in logged] == both, topic
        # Where the disk was full the log may end between a cause and what came of it.
        assert max(len(logged), len(again[topic])) - len(both) <= 1, topic
    assert len(well) == 300


def written(file: Path) -> float:
    return file.stat().st_mtime


@pytest.mark.slow  # 14 s; test_log_retention.py and test_recorded_monitor.py have its parts without a node
def test_every_start_has_a_log_and_what_retention_leaves_replays(tmp_path: Path) -> None:
    """Without the outputs too, which the replay makes; a fault of the log hides none of a joint."""
    given = parameters(
        diagnostics_rate=20.0,
        log__path=str(tmp_path / "arm"),
        log__split_duration=0.5,
        log__max_age=5.0,
        log__topics="inputs",
    )
    starts = []
    for number in range(2):
        with running(tmp_path, given) as rig:
            rig.values("joint_1", lambda values: values["prediction"] == "map")
            errors = rig.hear({"hd_diag/transmission_error": JointState})["hd_diag/transmission_error"]
            starts.append(Path(rig.values("joint_1")["log_state"].removeprefix("writing ")))
            samples, publisher, first = 0, rig.publisher(), starts[-1]
            while not samples or (number and first.exists()):  # until its own first samples are too old
                feed(publisher, stamps, 20, 50.0)
                samples += 20
                rig.until(lambda n=samples, e=errors: len(e) == n, "predictions")  # type: ignore[misc]
                first = first if first != starts[-1] else max(first.glob("*.mcap"), key=written)
            values = rig.values("joint_1")
            assert (values["log_lost"], values["log_warning"]) == ("0", "")
            assert rig.process.end() == 0
    assert {start.parent for start in starts} == {tmp_path / "arm"}
    assert [*(tmp_path / "arm").iterdir()] == [starts[1]]
    with BagReader(starts[1]) as reader:
        assert not reader.problems
        assert not [t.name for t in reader.topics if t.name.endswith("transmission_error")]
    replay(starts[1], tmp_path / "again.mcap")
    again = content(tmp_path / "again.mcap")
    topic = f"{rig.process.namespace}/hd_diag/transmission_error"
    found = [deserialize_message(data, JointState) for _, data in again[topic]]
    assert 0 < len(found) < samples
    assert found == errors[-len(found) :]


def number_of(file: Path) -> int:
    return int(file.stem.rpartition("_")[2])


def bytes_of(folder: Path) -> int:
    """Size of the log's files, without one that is deleted meanwhile."""
    size = 0
    for file in folder.rglob("*.mcap"):
        with contextlib.suppress(FileNotFoundError):
            size += file.stat().st_size
    return size


def test_a_size_bounds_a_log_of_a_fixed_name_which_the_next_start_replaces(tmp_path: Path) -> None:
    """A file is cut at a tenth of the size; of the one that is open a flush may be beyond it."""
    log, most = tmp_path / "arm", 3_000_000
    given = parameters(
        diagnostics_rate=20.0,
        log__path=str(log),
        log__overwrite=True,
        log__max_size=most,
        log__flush_period=0.05,
    )
    given["log.compression"] = "none"
    first: set[int] = set()
    for number in range(2):
        with running(tmp_path, given) as rig:
            assert rig.values("joint_1")["log_state"] == f"writing {log}"
            publisher, sent, sizes = rig.publisher(), list[int](), list[int]()
            begun: Path | None = None
            while not number and (begun is None or begun.exists()):
                sent += itertools.islice(stamps, 100)
                feed(publisher, iter(sent[-100:]), 100)
                rig.drain()
                sizes.append(bytes_of(log))
                begun = begun or max(log.glob("*.mcap"), key=number_of)  # it goes after the first samples
            assert max(sizes, default=0) <= most
            sent += itertools.islice(stamps, 20)
            feed(publisher, iter(sent[-20:]), 20)
            wanted = str(len(sent))
            values = rig.values("joint_1", lambda v, n=wanted: v["samples"] == n)  # type: ignore[misc]
            assert (values["log_lost"], values["log_warning"]) == ("0", "")
            assert rig.process.end() == 0
        assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["arm"]
        (topic,) = (name for name in content(log) if name.endswith("/joint_states"))
        found = [stamp_of(deserialize_message(data, JointState)) for _, data in content(log)[topic]]
        assert found == sent[-len(found) :]
        assert (len(found) < len(sent)) == (number == 0)
        assert not {*found} & first
        first = {*sent}
        replay(log, tmp_path / f"again_{number}.mcap")


def test_a_log_that_cannot_be_hides_no_fault_of_the_joint(tmp_path: Path) -> None:
    with running(tmp_path, parameters(diagnostics_rate=20.0, log__path="/dev/null/log")) as rig:
        publisher = rig.publisher()
        feed(publisher, stamps, 20)
        own, joint = {"LOG_FAILED"}, {"LOG_FAILED", "INTERFERENCE"}

        def status(codes: set[str]) -> Any:
            return rig.status(
                "joint_1", lambda v: {*v["fault_codes"].split()} == codes, lambda: feed(publisher, stamps, 20)
            )

        alone = status(own)
        assert (values_of(alone)["fault_code"], alone.level) == ("LOG_FAILED", DiagnosticStatus.WARN)
        assert rig.set(joint_1__eccentricity__magnitude=60e-6)[0].successful
        both = status(joint)
        assert (values_of(both)["fault_code"], both.level) == ("INTERFERENCE", DiagnosticStatus.ERROR)
        assert "; log failed: /dev/null/log/" in both.message
        assert values_of(both)["fault_codes"] == "INTERFERENCE LOG_FAILED"
