"""The node's log while it runs: fixed at the start, complete, and continued after failures."""

import contextlib
import functools
import itertools
import resource
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from live import MS, START, with_log
from logs import content, replayed
from player import angles
from running import Rig, feed, running, values_of

from hd_diag.bag import BagReader
from hd_diag.replay.replay import replay

pytestmark = pytest.mark.usefixtures("ros")

stamps = itertools.count(START, MS)
well: set[int] = set()  # stamps of samples from times without failure; the log must contain them


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A node that writes into the folder ``log``; its tests share one time."""
    folder = tmp_path_factory.mktemp("logged")
    given = with_log(folder / "log", overwrite=True, flush_period=0.05, sync_period=0.1)
    with running(folder, given) as rig:
        rig.folder = folder  # type: ignore[attr-defined]
        yield rig


@pytest.fixture(scope="module")
def publisher(rig: Rig) -> Any:
    return rig.publisher()


def log_of(rig: Rig) -> Path:
    return Path(rig.folder / "log")  # type: ignore[attr-defined]


def predicted(rig: Rig) -> list[int]:
    return [stamp for stamp, _ in angles(log_of(rig), f"{rig.process.namespace}/hd_diag/transmission_error")]


def test_no_other_process_chooses_where_it_writes(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "link.mcap").symlink_to("precious")
    own = {"log__path": str(tmp_path / "link.mcap"), "log__overwrite": True, "log__split_size": 1}
    for given in (*({name: value} for name, value in own.items()), own):
        (answer,) = rig.set(atomically=True, **given)
        said = f"{next(iter(given)).replace('__', '.')}: is fixed when the node starts (read-only)"
        assert (answer.successful, answer.reason) == (False, said)
    assert rig.values("joint_1")["log_state"] == f"writing {log_of(rig)}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.mcap", "precious"]
    assert (tmp_path / "precious").read_text() == "precious"


def publish(publisher: Any, count: int) -> list[int]:
    """Publish ``count`` samples and return their stamps [ns]."""
    sent = [*itertools.islice(stamps, count)]
    feed(publisher, iter(sent), count)
    return sent


def feed_well(rig: Rig, publisher: Any) -> None:
    """Publish samples while the log works, until it contains their predictions."""
    well.update(publish(publisher, 100))
    rig.until(lambda: well <= {*predicted(rig)}, "predictions in the log")


def deleted(rig: Rig) -> Callable[[], None]:
    shutil.rmtree(log_of(rig))
    well.clear()
    return lambda: None


def full(rig: Rig) -> Callable[[], None]:
    """Limit the size of the node's files below the size of some."""
    limit = functools.partial(resource.prlimit, rig.process.popen.pid, resource.RLIMIT_FSIZE)
    before = limit()
    limit((2000, before[1]))
    return lambda: limit(before)


@pytest.mark.parametrize(
    ("harm", "reason", "number"), [(deleted, "was deleted or moved", 1), (full, "File too large", 2)]
)
def test_it_goes_on_in_a_new_file_when_writing_works_again(rig, publisher, harm, reason, number) -> None:
    """After a deleted folder or a full disk the node reports it, lives on, and logs again by itself.

    The last samples of the failure may be logged: the node tries again after a second, and on a busy machine
    publishing may take longer.
    """
    assert rig.set(joint_1__runout__magnitude=1e-6)[0].successful
    feed_well(rig, publisher)
    seen, before = len(rig.reports), int(rig.values("joint_1")["log_lost"])

    def failure() -> dict[str, str] | None:
        """Search all reports since the harm: the log may have recovered while samples were published."""
        every = (values_of(array.status[0]) for array in rig.reports[seen:])
        return next((values for values in every if "LOG_FAILED" in values["fault_codes"]), None)

    mend = harm(rig)
    sent = publish(publisher, 100)
    failed = rig.until(failure, "failure of the log")
    assert reason in failed["log_state"]
    sent += publish(publisher, 50)
    rig.values("joint_1", lambda v: int(v["samples"]) >= int(failed["samples"]) + 50)
    mend()
    values = rig.values("joint_1", lambda values: "LOG_FAILED" not in values["fault_codes"])
    assert values["log_state"] == f"writing {log_of(rig) / f'log_{number}.mcap'}"
    lost = int(values["log_lost"]) - before
    assert lost >= max(1, len({*sent} - {*predicted(rig)}))
    assert rig.set(joint_1__runout__magnitude=2e-6)[0].successful
    feed_well(rig, publisher)


def test_what_it_wrote_is_whole_and_replays(rig: Rig, publisher: Any, tmp_path: Path) -> None:
    """Each later file begins with all that the node knew: counters, parameters, the map in force."""
    rig.values("joint_1", lambda values: values["samples"] == "700")
    assert rig.process.end() == 0
    assert rig.process.output().count("]: log failed: ") == 2  # a fault of the joint may report it, too
    with BagReader(log_of(rig)) as reader:
        assert [problem for problem in reader.problems if "log_0.mcap" not in problem] == []
    replay(log_of(rig), tmp_path / "again.mcap")
    found = predicted(rig)
    assert found == sorted({*found} | well)
    live, again = content(log_of(rig)), content(tmp_path / "again.mcap")
    for topic, logged in live.items():
        both = [message for message in logged if message in again[topic]]
        assert [message for message in again[topic] if message in logged] == both, topic
        # A full disk may end the log between the inputs of one batch (64 at most) and their outputs.
        assert len(logged) - len(both) <= 1, topic
        missing = [place for place, message in enumerate(again[topic]) if message not in logged]
        first = min(missing, default=0)
        assert missing == [*range(first, first + min(len(missing), 64))], topic
    assert len(well) == 300


def bytes_of(folder: Path) -> int:
    """Size of the log's files [byte]; a file that is being deleted does not count."""
    size = 0
    for file in folder.rglob("*.mcap"):
        with contextlib.suppress(FileNotFoundError):
            size += file.stat().st_size
    return size


def test_a_size_bounds_a_log_of_a_fixed_name_which_the_next_start_replaces(tmp_path: Path) -> None:
    """Files are cut at a tenth of the size; the open file may exceed that by one flush.

    The remaining files replay without the deleted ones.
    """
    log, most = tmp_path / "arm", 3_000_000
    given = with_log(log, overwrite=True, max_size=most, flush_period=0.05, compression="none")
    first: set[int] = set()
    for number in range(2):
        with running(tmp_path, given) as rig:
            assert rig.values("joint_1")["log_state"] == f"writing {log}"
            publisher, sent, sizes = rig.publisher(), list[int](), list[int]()
            begun: Path | None = None
            while not number and (begun is None or begun.exists()):
                sent += publish(publisher, 100)
                rig.drain()
                sizes.append(bytes_of(log))
                if begun is None:  # the first file is deleted later
                    begun = max(log.glob("*.mcap"), key=lambda file: int(file.stem.rpartition("_")[2]))
            assert max(sizes, default=0) <= most
            sent += publish(publisher, 20)
            wanted = str(len(sent))
            values = rig.values("joint_1", lambda v, n=wanted: v["samples"] == n)
            assert (values["log_lost"], values["log_warning"]) == ("0", "")
            assert rig.process.end() == 0
        assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["arm"]
        found = [stamp for stamp, _ in angles(log, f"{rig.process.namespace}/joint_states")]
        assert found == sent[-len(found) :]
        assert (len(found) < len(sent)) == (number == 0)
        assert not {*found} & first
        first = {*sent}
        replayed(log)


def test_a_log_that_cannot_be_hides_no_fault_of_the_joint(tmp_path: Path) -> None:
    """A diagnosis, too, says why it has no log."""
    with running(tmp_path, with_log("/dev/null/log")) as rig:
        publisher = rig.publisher()
        feed(publisher, stamps, 20)

        def status(*codes: str) -> DiagnosticStatus:
            condition = lambda v: {*v["fault_codes"].split()} == {*codes}  # noqa: E731
            return rig.status("joint_1", condition, lambda: feed(publisher, stamps, 20))

        alone = status("LOG_FAILED")
        assert (values_of(alone)["fault_code"], alone.level) == ("LOG_FAILED", DiagnosticStatus.WARN)
        assert rig.set(joint_1__eccentricity__magnitude=60e-6)[0].successful
        both = status("LOG_FAILED", "INTERFERENCE")
        assert (values_of(both)["fault_code"], both.level) == ("INTERFERENCE", DiagnosticStatus.ERROR)
        assert "; log failed: /dev/null/log/" in both.message
        assert values_of(both)["fault_codes"] == "INTERFERENCE LOG_FAILED"
        ok, said = rig.call("diagnose")
        assert not ok
        assert said.startswith("~/diagnose: there is no log: failed: /dev/null/log")
        assert said.endswith(": Not a directory")
