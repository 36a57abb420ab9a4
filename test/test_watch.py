"""What a watcher knows and shows, without ROS: state, hostile texts, 80 columns, a pipe."""

import contextlib
import io
import json
import math
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from live import START, Recording, config, sample
from rich.console import Console

from hd_diag.messages.publications import DIAGNOSTICS
from hd_diag.messages.schemas import jazzy
from hd_diag.replay.recorded_monitor import Session
from hd_diag.watch import PREFIX, NodeSeen, ReportedStatus, Watch, as_json
from hd_diag.watch.display import Display, JointTable, plain_line
from hd_diag.watch.numbers import shown_number, spark

TOPIC = "/diagnostics"
HOSTILE = "[red]x[/red]\x1b[2J\x1b]0;t\x07\u202egnp\r\n\t" + "宽" * 300 + "\ud800"


def reported() -> Mapping[str, str]:
    """Values of a real report of one sample."""
    recording = Recording()
    session = Session(config("joint_1", joint_1__eccentricity__magnitude=18e-6), recording)
    session.start(START)
    session.joint_state(START, sample(START, 0.3, 0.003, 14.0))
    session.tick(START + 1, START + 1, {"latency_p99_us": "812.5", "log_state": "writing log.mcap"})
    ((_, data),) = recording.topics()[TOPIC]
    (status,) = jazzy().deserialize_cdr(data, DIAGNOSTICS).status  # type: ignore[attr-defined]
    assert status.name == f"{PREFIX}joint_1"
    return {pair.key: pair.value for pair in status.values}


REAL = reported()


def message(
    joint: str = "joint_1", level: int = 0, text: str = "OK", node: str = "", **values: str
) -> ReportedStatus:
    """A status, of a node or of one that does not say who it is."""
    said = {**REAL, "fault_code": "OK", "fault_codes": "OK", **values}
    return ReportedStatus(PREFIX + joint, level, text, said, f"{node}/{joint}" if node else "")


def watched(*statuses: ReportedStatus, **asked: Any) -> Watch:
    watch = Watch(**asked)
    watch.take(TOPIC, statuses, 0.0)
    return watch


def drawn(watch: Watch, now: float = 0.0, width: int = 80, height: int = 1000, **more: Any) -> str:
    """The table as a terminal shows it."""
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False, **more).print(JointTable(watch, now, height))
    return stream.getvalue()


def lines(watch: Watch, width: int = 80, height: int = 1000, now: float = 0.0) -> list[str]:
    return drawn(watch, now, width, height).splitlines()


def coloured(watch: Watch, now: float = 0.0) -> str:
    return drawn(watch, now, force_terminal=True, color_system="standard")


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


# State ---


def test_the_state_needs_neither_ros_nor_a_terminal() -> None:
    edges = "{'rclpy', 'diagnostic_msgs', 'rich', 'click'}"
    code = f"import sys, hd_diag.watch; print({edges} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "set()\n"


def test_joints_that_are_not_asked_for_and_other_statuses_are_left_out() -> None:
    watch = watched(message("a"), message("b"), joints=("b", "c"))
    assert [view.name for view in watch.view(0.0)] == ["b"]
    assert watch.missing() == ["c"]
    watch = watched(*[ReportedStatus(f"camera {i % 100}", 0, "", {}) for i in range(200)])
    assert watch.view(0.0) == []
    assert watch.others == [f"camera {i}" for i in range(32)]
    assert "other diagnostics: camera 0, camera 1" in " ".join(watch.explanation())


def test_a_flood_of_joints_texts_and_values_is_bounded() -> None:
    watch = watched(*[message(f"j{i}") for i in range(5000)])
    watch.take(TOPIC, [message("j0", **{f"k{i}": "v" for i in range(9999)}, log_state="x" * 10**6)], 1.0)
    watch.take(TOPIC, [message("j0", node=f"/n{i}") for i in range(100)], 1.0)
    views = watch.view(1.0)
    assert len(views) == 1024
    first = next(view for view in views if view.name == "j0")
    assert len(first.status.values) <= 256
    assert max(map(len, first.status.values.values())) <= 2000


def test_the_last_verdict_is_a_line_of_its_own_with_its_time() -> None:
    """Behind it, in a pipe; above it what a diagnosis does that has not ended."""
    own = {"verdict": "As configured; nothing to do.", "verdict_time": "2026-01-02T03:04:05+0000"}
    said = "verdict of 2026-01-02T03:04:05+0000: As configured; nothing to do."
    done = watched(message(diagnosis_state="done: /log/verdict.json", **own))
    assert lines(done)[-1] == f"  {said}"
    assert plain_line(done.view(0.0)[0]).endswith(f"; {said}")
    again = watched(message(diagnosis_state="diagnoses 2 files: /log/v.json", **own))
    assert lines(again)[-2:] == ["  diagnosis diagnoses 2 files: /log/v.json", f"  {said}"]
    assert "verdict of" not in drawn(watched(message()))


@pytest.mark.parametrize(("period", "stale_after"), [(0.1, 3.0), (1.0, 3.0), (10.0, 30.0)])
def test_a_joint_is_silent_after_three_periods(period: float, stale_after: float) -> None:
    watch, last = Watch(), 9 * period
    for i in range(10):
        watch.take(TOPIC, [message()], i * period)
    assert not watch.view(last + 0.99 * stale_after)[0].is_silent
    assert watch.view(last + 1.01 * stale_after)[0].is_silent
    watch.take(TOPIC, [message()], last + 2.0 * stale_after)
    assert not watch.view(last + 2.0 * stale_after)[0].is_silent


def test_a_node_without_samples_is_stale_though_it_reports() -> None:
    (view,) = watched(message(level=2, fault_code="STALE", fault_codes="STALE RESIDUAL")).view(0.0)
    assert (view.is_stale, view.is_silent) == (True, False)


def test_nodes_are_told_apart_by_topic_and_joints() -> None:
    watch = Watch()
    watch.nodes = [
        NodeSeen("/left/hd_diag", TOPIC, frozenset({"a"})),
        NodeSeen("/right/hd_diag", TOPIC, frozenset({"b"})),
        NodeSeen("/far/hd_diag", "/far/diagnostics", frozenset({"a", "c"})),
    ]
    watch.take(TOPIC, [message("a"), message("b")], 0.0)
    watch.take("/far/diagnostics", [message("a", eccentricity_um="5")], 0.0)
    seen = {(*view.nodes, view.name): view.number("eccentricity_um") for view in watch.view(0.0)}
    assert seen == {("/left/hd_diag", "a"): 18.0, ("/right/hd_diag", "b"): 18.0, ("/far/hd_diag", "a"): 5.0}
    assert watch.missing() == ["c"]


@pytest.mark.parametrize("asked", ["arm", "/arm", "/arm/", "/arm/left", "/"])
def test_a_namespace_holds_what_is_below_it(asked: str) -> None:
    nodes = [NodeSeen(f"/{n}/hd_diag", TOPIC, frozenset({j})) for n, j in (("arm/left", "a"), ("army", "b"))]
    watch = watched(message("a"), message("b"), namespaces=(asked,))
    watch.nodes = nodes
    assert watch.wanted_nodes() == (nodes if asked == "/" else nodes[:1])
    assert [view.name for view in watch.view(0.0)] == (["a", "b"] if asked == "/" else ["a"])


def test_two_nodes_that_do_not_say_who_they_are_are_said_to_be_two() -> None:
    watch = watched(message("a"))
    watch.nodes = [NodeSeen(f"/{n}/hd_diag", TOPIC, frozenset({"a"})) for n in "xy"]
    assert watch.view(0.0)[0].nodes == ("/x/hd_diag", "/y/hd_diag")
    assert any("several nodes report a" in line for line in lines(watch))


def test_two_nodes_with_one_joint_on_one_topic_are_two_rows_each_with_its_node() -> None:
    watch = Watch()
    watch.nodes = [NodeSeen(name, TOPIC, frozenset({"a"})) for name in ("/arm/x", "/arm/y")]
    watch.take(TOPIC, [message("a", node="/arm/x", samples="1")], 0.0)
    watch.take(TOPIC, [message("a", node="/arm/y", samples="2", residual_rms_arcsec="7")], 0.5)
    watch.take(TOPIC, [message("a", node="/arm/x", samples="3")], 1.0)
    seen = [(view.nodes, view.number("samples"), view.age, len(view.residuals)) for view in watch.view(1.0)]
    assert seen == [(("/arm/x",), 3.0, 0.0, 2), (("/arm/y",), 2.0, 0.5, 1)]
    assert [joint["hardware_id"] for joint in as_json(watch, 1.0)["joints"]] == ["/arm/x/a", "/arm/y/a"]
    shown = lines(watch)
    assert [line.split()[0] for line in shown if line.startswith("arm/a")] == ["arm/a", "arm/a"]
    assert [line for line in shown if "/arm/x, 3 samples" in line]
    assert [line for line in shown if "/arm/y, 2 samples" in line]
    assert "cannot be distinguished" not in "\n".join(shown)
    assert "/arm/x, " not in "\n".join(lines(watched(message("a", node="/arm/x"))))
    assert [plain_line(view).split(":")[0] for view in watch.view(1.0)] == ["/arm/x a", "/arm/y a"]
    assert watch.missing() == []
    watch.nodes = [*watch.nodes, NodeSeen("/arm/z", TOPIC, frozenset({"a", "b"}))]
    assert watch.missing() == ["/arm/z a", "b"]
    watch.take(TOPIC, [message("a", node="/leg/x")], 1.0)
    watch.namespaces = ("leg",)
    assert [view.nodes for view in watch.view(1.0)] == [("/leg/x",)]


@pytest.mark.parametrize("hardware_id", ["", "robot 7", "/arm/other_joint"])
def test_an_identifier_that_names_no_node_leaves_that_to_the_graph(hardware_id: str) -> None:
    watch = watched(*(message(joint)._replace(hardware_id=hardware_id) for joint in "ab"))
    watch.nodes = [NodeSeen("/hd_diag", TOPIC, frozenset({"a", "b"}))]
    assert [(view.nodes, view.name) for view in watch.view(0.0)] == [(("/hd_diag",), n) for n in "ab"]


def test_what_is_waited_for_and_what_was_seen_instead() -> None:
    watch = Watch(("a",), ("/arm",))
    assert watch.explanation() == ["no hd_diag node is in the ROS graph", "no diagnostics at all"]
    watch.nodes = [NodeSeen("/hd_diag", TOPIC, frozenset({"b"}))]
    watch.take(TOPIC, [message("b")], 0.0)
    assert watch.explanation() == ["no hd_diag node in /arm; there is /hd_diag", "joints reported: b"]
    assert lines(watched(ReportedStatus("camera", 0, "", {}), joints=("a",))) == [
        "waiting for /diagnostics of a ...",
        "  no hd_diag node is in the ROS graph",
        "  other diagnostics: camera",
    ]


# JSON ---


def test_json_holds_every_value_with_its_kind() -> None:
    said = as_json(watched(message(temperature_C="nan", samples="12")), 2.0)
    (joint,) = said["joints"]
    assert said["schema"] == "hd_diag/watch/1"
    assert (joint["joint"], joint["level"], joint["age"]) == ("joint_1", "ok", 2.0)
    values = joint["values"]
    assert set(values) == set(REAL)
    assert values["eccentricity_um"] == 18
    assert values["interference"] is (REAL["interference"] == "true")
    assert (values["temperature_C"], values["samples"], values["log_state"]) == (None, 12, "writing log.mcap")


@given(st.text(), st.text(), st.text(), st.text())
def test_any_text_gives_valid_json_and_is_shown_without_control_characters(
    joint: str, text: str, log: str, number: str
) -> None:
    watch = watched(message(joint, 7, text, log_state=log, residual_rms_arcsec=number))
    said = json.loads(json.dumps(as_json(watch, 0.0), allow_nan=False))
    assert said["joints"][0]["joint"] == joint[:2000]
    assert all(line.isprintable() for line in [*lines(watch), plain_line(watch.view(0.0)[0])])


# In a terminal ---


def test_what_a_joint_s_lines_say() -> None:
    text = drawn(watched(message(level=2, text="the lobes overlap", fault_code="INTERFERENCE")))
    keys = ("eccentricity_um", "minimum_backlash_um", "peak_tooth_load_N", "predicted_te_pp_arcsec")
    numbers = (*(f" {float(REAL[key]):.1f}" for key in keys), f" {float(REAL['lost_motion_arcmin']):.2f}")
    words = ("joint_1", "INTERFERENCE the lobes overlap", "1 samples", "latency 812 µs", "1 with a fault")
    wanted = (*numbers, f" {REAL['loaded_pairs']} ", *words, "log writing log.mcap")
    assert [part for part in wanted if part not in text] == []
    view = message(level=2, text="t", fault_code="STALE", fault_codes="STALE RESIDUAL INTERFERENCE")
    assert "STALE t (also RESIDUAL INTERFERENCE)" in drawn(watched(view))


@pytest.mark.parametrize(("level", "code"), [(0, "32"), (1, "33"), (2, "1;31"), (3, "35"), (200, "35")])
def test_the_fault_has_the_colour_of_its_level(level: int, code: str) -> None:
    assert f"\x1b[{code}mCODE" in coloured(watched(message(level=level, fault_code="CODE")))


def test_a_silent_joint_is_grey_and_says_so() -> None:
    watch = watched(message(level=2, fault_code="INTERFERENCE"))
    fresh, silent = coloured(watch, 1.0), coloured(watch, 60.0)
    assert "\x1b[90m" not in fresh.splitlines()[4]
    assert "no report for 60 s; the last: INTERFERENCE" in silent
    assert "31m" not in silent.split("no report")[1]
    assert "90mjoint_1" in silent.replace("1;", "")


def test_what_is_wrong_is_said_a_line_a_statement() -> None:
    """As the monitor says it; in a pipe it stays one line."""
    said = "residual repeats twice per input turn with 24.4 arcsec (input 2); typical of this; do that"
    watch = watched(message(level=1, text=said, fault_code="RESIDUAL", fault_codes="RESIDUAL STALE"))
    first, second, third, _ = [line.strip() for line in lines(watch, 100)[5:9]]
    assert first == f"RESIDUAL {said.split('; ')[0]} (also STALE)"
    assert (second, third) == ("typical of this", "do that")
    assert len(lines(watched(message(level=1, text="a; " * 1000)))) < 20
    assert f": RESIDUAL {said} (also STALE); configured " in plain_line(watch.view(0.0)[0])


def test_an_order_that_repeats_within_its_limit_is_told_beside_ok() -> None:
    told = {
        "residual_order": "input 2",
        "residual_order_repeats": "true",
        "residual_order_amplitude_arcsec": "6.71794",
        "residual_order_limit_arcsec": "10.3132",
    }
    watch = watched(message(**told))
    assert "; residual repeats 2x per input turn: 6.7 of 10.3 arcsec allowed; " in plain_line(
        watch.view(0.0)[0]
    )
    assert "OK residual" not in drawn(watch)
    assert "residual repeats 2x per input turn" in drawn(watch)
    assert "repeats" not in plain_line(watched(message()).view(0.0)[0])


@pytest.mark.parametrize("width", [20, 40, 79, 80, 81, 120, 300])
@pytest.mark.parametrize("text", ["joint_1", HOSTILE])
def test_no_line_is_wider_than_the_terminal(width: int, text: str) -> None:
    values = {"fault_code": text, "log_state": text, "samples": "9" * 400, "peak_tooth_load_N": "-1e300"}
    shown = lines(watched(message(text, 2, text, **values), joints=(text, text + "?")), width)
    assert max(Console(width=width).measure(line).maximum for line in shown) <= width


def test_at_80_columns_nothing_of_a_usual_report_is_cut_and_markup_is_text() -> None:
    watch = watched(message(), message("a_joint_1234567", level=1, text="peak tooth load 61.0 N"))
    assert "…" not in drawn(watch)
    assert "[red]joint[/red]" in drawn(watched(message("[red]joint[/red]")), width=100)


@pytest.mark.parametrize("width", [40, 60, 100])
def test_no_word_of_a_fault_is_cut(width: int) -> None:
    """Columns that a narrow terminal has no room for are told in words."""
    fault = "residual repeats twice per input turn with 24.5 arcsec (input 2); typical of an eccentricity"
    told = drawn(watched(message(level=1, text=fault, residual_rms_arcsec="17.55")), width=width)
    words = " ".join(told.split())
    assert all(part in words for part in fault.split("; "))
    assert "17.55" in words
    assert "…" not in told


def test_where_not_all_fit_the_worst_are_shown() -> None:
    watch = watched(*[message(f"j{i:02d}", level=2 if i == 17 else 0) for i in range(30)])
    shown = lines(watch, 80, 24)
    assert len(shown) <= 23
    assert any(line.startswith("j17") for line in shown)
    assert any("more joints have no room" in line for line in shown)
    assert len(lines(watch, 80)) > 60


# Numbers and curves ---


@given(st.floats(-1e307, 1e307), st.integers(0, 2), st.integers(1, 15))
def test_every_number_fits_its_column(value: float, digits: int, width: int) -> None:
    shown = shown_number(value, digits, width)
    assert len(shown) <= width
    if "*" not in shown:
        assert float(shown) == pytest.approx(value, rel=0.5, abs=0.5)


@pytest.mark.parametrize(
    ("value", "width", "expected"),
    [
        (18.04, 7, "18.0"),
        (-24.06, 6, "-24.1"),
        (-12345.6, 6, "-12346"),
        (-123456.0, 6, "-1e05"),
        (1e300, 6, "1e300"),
        (-1e300, 5, "*****"),
        (math.nan, 6, "-"),
        (-math.inf, 6, "-"),
    ],
)
def test_numbers_lose_digits_before_they_lose_their_place(value: float, width: int, expected: str) -> None:
    assert shown_number(value, 1, width) == expected


def test_curve() -> None:
    for values, curve in (([], ""), ([0.0, 0.0], "▁▁"), ([math.nan, 8.0, math.inf, 4.0], " █ ▅")):
        assert spark(values, 10) == curve
        assert len(spark(values, 10, is_ascii=True)) == len(curve)
    assert spark([5.0, 1.0, 1.0, 1.0], 3) == "███"


def test_residuals_are_kept_as_a_curve() -> None:
    watch = Watch()
    for i in range(300):
        watch.take(TOPIC, [message(residual_rms_arcsec=str(i % 8))], 0.1 * i)
    assert watch.view(30.0)[0].residuals == tuple(float(i % 8) for i in range(60, 300))
    assert "▁▂▃▄▅▆▇█" in drawn(watch, 30.0, 120)


# Where it goes ---


def test_a_pipe_gets_a_line_a_second_without_codes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    stream, watch = io.StringIO(), Watch()
    with Display(stream) as display:
        display.show(watch, 0.0)
        for i in range(1, 31):
            watch.take(TOPIC, [message()], 0.1 * i)
            display.show(watch, 0.1 * i)
        display.show(watch, 40.0)
        display.show(watch, 50.0)
    said = stream.getvalue().splitlines()
    assert said[0] == "waiting for /diagnostics ..."
    assert 2 <= sum(line.startswith("/diagnostics joint_1: OK") for line in said) <= 4
    assert [line for line in said if "no report for 37 s" in line] == said[-1:]
    assert "\x1b" not in stream.getvalue()


def test_another_fault_is_shown_at_once_with_everything_else() -> None:
    stream, watch = io.StringIO(), Watch()
    with Display(stream) as display:
        for i, code in enumerate(("OK", "OK", "RESIDUAL", "RESIDUAL", "OK")):
            watch.take(TOPIC, [message(fault_code=code)], 0.26 * i)
            display.show(watch, 0.26 * i)
        watch.take(TOPIC, [message(fault_code="STALE")], 1.05)
        display.show(watch, 1.05, is_last=True)
    shown = stream.getvalue().splitlines()
    assert [line.split(": ")[1].split()[0].strip(";") for line in shown] == ["OK", "RESIDUAL", "OK", "STALE"]
    words = ("18.0 µm at 0 deg", "lost motion", "tooth pairs", "arcsec peak to peak", "arcsec rms", "812 µs")
    assert [part for part in words if part not in shown[0]] == []
    assert shown[0].endswith("log writing log.mcap")


def test_a_terminal_gets_one_picture_and_is_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four pictures a second however often reports come, and the cursor again, after Ctrl-C too."""
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "80")
    stream, watch = Terminal(), watched(message())
    with contextlib.suppress(KeyboardInterrupt), Display(stream) as display:
        for i in range(100):
            display.show(watch, 0.01 * i)
        raise KeyboardInterrupt
    written = stream.getvalue()
    assert 3 <= written.count("hd-diag watch") <= 6  # and once more at the end
    assert written.count("\x1b[?25l") == written.count("\x1b[?25h") == 1


def test_a_dumb_terminal_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    stream = Terminal()
    with Display(stream) as display:
        display.show(watched(message()), 0.0)
    assert stream.getvalue().startswith("/diagnostics joint_1: OK; ")


@pytest.mark.parametrize("terminal", [False, True])
def test_an_encoding_without_bars_does_no_harm(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="ascii")
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    watch = Watch()
    for i in range(20):
        watch.take(TOPIC, [message("gelenk_1", residual_rms_arcsec=str(i), log_state="x" * 200)], 0.1 * i)
    with Display(stream) as display:
        display.show(watch, 2.0, is_last=True)
    stream.flush()
    assert b"gelenk_1" in raw.getvalue()
    assert b"um" in raw.getvalue()
