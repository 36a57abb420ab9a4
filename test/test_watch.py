"""State and output of a watcher without ROS: hostile texts, narrow terminals, a pipe."""

import contextlib
import io
import json
import subprocess
import sys
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from live import START, Recording, config, sample
from rich.cells import cell_len
from rich.console import Console

from hd_diag.messages.publications import DIAGNOSTICS
from hd_diag.messages.schemas import jazzy
from hd_diag.replay.recorded_monitor import Session
from hd_diag.watch.display import Display, in_words, picture
from hd_diag.watch.state import PREFIX, Watch

TOPIC = "/diagnostics"
HOSTILE = "[red]x[/red]\x1b[2J\x1b]0;t\x07\u202egnp\r\n\t" + "宽" * 300 + "\ud800"


def reported() -> dict[str, str]:
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


def status(name: str, level: int = 0, text: str = "", identifier: str = "", **values: str) -> SimpleNamespace:
    """A DiagnosticStatus as rclpy gives it."""
    pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
    own = {"name": name, "level": bytes([level]), "message": text, "hardware_id": identifier}
    return SimpleNamespace(**own, values=pairs)


def message(joint="joint_1", level=0, text="OK", node="/hd_diag", **values: str) -> SimpleNamespace:
    said = {**REAL, "fault_code": "OK", "fault_codes": "OK", **values}
    return status(PREFIX + joint, level, text, f"{node}/{joint}", **said)


def take(watch: Watch, now: float, *statuses: SimpleNamespace) -> None:
    watch.take(TOPIC, SimpleNamespace(status=statuses), now)


def watched(*statuses: SimpleNamespace, **asked) -> Watch:
    watch = Watch(**asked)
    take(watch, 0.0, *statuses)
    return watch


def drawn(watch: Watch, now: float = 0.0, width: int = 80, **more) -> str:
    console = Console(file=io.StringIO(), width=width, highlight=False, **more)
    console.print(picture(watch, now))
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_state_needs_neither_ros_nor_a_terminal() -> None:
    edges = "{'rclpy', 'diagnostic_msgs', 'rich', 'click'}"
    code = f"import sys, hd_diag.watch.state; print({edges} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "set()\n"


def test_only_joints_that_are_asked_for_are_shown() -> None:
    watch = Watch(("b", "c"))
    assert drawn(watch) == "no report of b, c yet: no diagnostics: same ROS_DOMAIN_ID?\n"
    take(watch, 0.0, status("camera"))
    assert watch.lack("yet") == "no report of b, c yet: only diagnostics of others came"
    take(watch, 0.0, message("a"), message("b"), status("camera"))
    assert [view.joint for view in watch.view(0.0)] == ["b"]
    assert watch.missing() == ["c"]
    assert drawn(watch).startswith("no report of c yet: there is /hd_diag a, /hd_diag b\n")
    take(watch, 0.0, message("c"))
    assert watch.lack("yet") == ""


def test_a_namespace_holds_what_is_below_it() -> None:
    statuses = message("a", node="/arm/left/hd_diag"), message("b", node="/army/hd_diag")
    for asked in ("arm", "/arm", "/arm/", "/arm/left", "/"):
        views = watched(*statuses, namespaces=(asked,)).view(0.0)
        assert [view.joint for view in views] == (["a", "b"] if asked == "/" else ["a"]), asked


def test_two_nodes_with_one_joint_on_one_topic_are_two_rows() -> None:
    watch = watched(message("a", node="/x", samples="1"))
    take(watch, 0.5, message("a", node="/y", samples="2"))
    take(watch, 1.0, message("a", node="/x", samples="3"))
    seen = [(view.node, view.values["samples"], view.age) for view in watch.view(1.0)]
    assert seen == [("/x", 3.0, 0.0), ("/y", 2.0, 0.5)]
    assert all(words in drawn(watch) for words in ("/x a: OK; 3 samples", "/y a: OK; 2 samples"))


def test_a_flood_of_joints_texts_and_values_is_bounded() -> None:
    watch = watched(*[message(f"j{i}") for i in range(5000)])
    many = {f"k{i}": "v" for i in range(9999)}
    take(watch, 1.0, message("j0", **many, log_state="x" * 10**6))
    take(watch, 1.0, *[message("j0", node=f"/n{i}") for i in range(100)])
    views = watch.view(1.0)
    values = next(view for view in views if view.joint == "j0").values
    assert (len(views), len(values) <= 256) == (1024, True)
    assert max(len(str(value)) for value in values.values()) <= 2000


@pytest.mark.parametrize(("period", "silent_after"), [(0.1, 3.0), (1.0, 3.0), (10.0, 30.0)])
def test_a_joint_is_silent_after_three_periods(period: float, silent_after: float) -> None:
    watch = watched(message(level=2, fault_code="INTERFERENCE"))
    take(watch, period, message(level=2, fault_code="INTERFERENCE"))
    assert not watch.view(period + 0.99 * silent_after)[0].silent
    silent = watch.view(period + 1.01 * silent_after)[0]
    assert silent.silent
    assert f"no report for {silent.age:.0f} s; the last: INTERFERENCE" in in_words(silent)
    take(watch, 100.0, message())
    assert not watch.view(100.0)[0].silent
    (view,) = watched(message(level=2, fault_code="STALE", fault_codes="STALE RESIDUAL")).view(0.0)
    assert (view.stale, view.silent) == (True, False)  # a node without samples still reports


def test_json_holds_every_value_with_its_kind() -> None:
    said = watched(message(temperature_C="nan", samples="12")).as_json(2.0)
    (joint,) = said["joints"]
    assert said["schema"] == "hd_diag/watch/1"
    assert (joint["joint"], joint["node"], joint["level"], joint["age"]) == ("joint_1", "/hd_diag", "ok", 2.0)
    values = joint["values"]
    assert set(values) == set(REAL)
    assert values["eccentricity_um"] == 18
    assert values["interference"] is (REAL["interference"] == "true")
    assert (values["temperature_C"], values["samples"], values["log_state"]) == (None, 12, "writing log.mcap")


@given(st.text(), st.text(), st.text(), st.text())
@example(HOSTILE, HOSTILE, HOSTILE, "9" * 400)
@example("joint_1", "joint_1", "joint_1", "-1e300")
def test_any_text_gives_valid_json_and_printable_lines(joint: str, text: str, log: str, number: str) -> None:
    """No line is wider than the terminal."""
    own = {"fault_code": text, "log_state": log, "residual_rms_arcsec": number, "samples": number}
    watch = watched(message(joint, 7, text, **own), joints=(joint, joint + "?"))
    said = json.loads(json.dumps(watch.as_json(0.0), allow_nan=False))
    assert said["joints"][0]["joint"] == joint[:2000]
    assert in_words(watch.view(0.0)[0]).isprintable()
    for width in (20, 79, 80, 120, 300):
        lines = drawn(watch, width=width).splitlines()
        assert all(line.isprintable() and cell_len(line) <= width for line in lines)


@pytest.mark.parametrize("width", [80, 160])
def test_a_terminal_shows_all_that_a_report_says(width: int) -> None:
    """Numbers in columns; fault and verdict are wrapped, not cut."""
    fault = "residual repeats twice per input turn with 24.5 arcsec (input 2); typical of an eccentricity"
    own = {"fault_code": "RESIDUAL", "fault_codes": "RESIDUAL STALE", "residual_rms_arcsec": "17.55"}
    own |= {"verdict": "As configured.", "verdict_time": "2026-01-02T03:04:05"}
    own |= {"diagnosis_state": "diagnoses v"}
    told = " ".join(drawn(watched(message(level=1, text=fault, **own)), width=width).split())
    keys = ("eccentricity_um", "minimum_backlash_um", "peak_tooth_load_N", "predicted_te_pp_arcsec")
    numbers = (*(f" {float(REAL[key]):.1f}" for key in keys), f" {float(REAL['lost_motion_arcmin']):.2f}")
    words = (f"joint_1: RESIDUAL {fault} (also STALE); 1 samples; latency 812 µs; log writing log.mcap",)
    verdict = ("; diagnosis diagnoses v; verdict of 2026-01-02T03:04:05: As configured.",)
    wanted = (*numbers, f" {REAL['loaded_pairs']}", " 17.55", *words, *verdict)
    assert [part for part in wanted if part not in told] == []
    assert "…" not in told


def test_an_order_that_repeats_within_its_limit_is_told_beside_ok() -> None:
    order = {"amplitude_arcsec": "6.71794", "limit_arcsec": "10.3132", "repeats": "true"}
    told = {f"residual_order_{key}": value for key, value in order.items()}
    shown = drawn(watched(message(residual_order="input 2", **told)), width=300)
    assert "; residual repeats with input 2: 6.7 of 10.3 arcsec allowed; " in shown
    assert "repeats" not in drawn(watched(message()))


@pytest.mark.parametrize(("level", "code"), [(0, "32"), (1, "33"), (2, "1;31"), (3, "35"), (200, "35")])
def test_a_fault_has_the_colour_of_its_level_and_a_silent_joint_none(level: int, code: str) -> None:
    watch = watched(message(level=level, fault_code="CODE"))
    fresh, silent = (drawn(watch, t, force_terminal=True, color_system="standard") for t in (1.0, 60.0))
    assert f"\x1b[{code}mCODE" in fresh
    assert f"\x1b[{code}m" not in silent
    assert "\x1b[90mCODE" in silent


def test_where_not_all_fit_the_worst_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """The final picture shows all joints."""
    for name, value in {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}.items():
        monkeypatch.setenv(name, value)
    stream = Terminal()
    watch = watched(*[message(f"j{i:02d}", level=2 if i == 17 else 0) for i in range(30)])
    with Display(watch, stream) as display:
        display.show(0.0)
        shown = stream.getvalue().splitlines()
    assert (len(shown), "j17" in shown[4], "..." in shown[-1]) == (24, True, True)
    assert sum(f"/hd_diag j{i:02d}: " in stream.getvalue() for i in range(30)) == 30


def test_numbers_without_a_value_or_too_large() -> None:
    others = dict.fromkeys(("residual_rms_arcsec", "predicted_te_pp_arcsec"), "0.25")
    for value, expected in {"-24.06": "-24.1", "-1e300": "-1e+300", "nan": "-", "": "-"}.items():
        assert f" {expected} " in drawn(watched(message(peak_tooth_load_N=value, **others)))


def test_a_pipe_gets_a_table_a_second_and_another_fault_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    stream, watch = io.StringIO(), Watch()
    with Display(watch, stream) as display:
        display.show(0.0)
        for i in range(1, 31):
            take(watch, 0.25 * i, message(fault_code="RESIDUAL" if i == 20 else "OK"))
            display.show(0.25 * i)
        display.show(40.0)
        display.show(50.0)
    assert stream.getvalue().startswith("no report of an hd_diag node yet: ")
    said = [words for words in stream.getvalue().splitlines() if words.startswith("/hd_diag joint_1: ")]
    codes = [words.split(": ")[1].split()[0].strip(";") for words in said[:-1]]
    # At 0.25, 1.25, ... 4.25 s; the fault at 5, its end at 5.25, then 6.25 and 7.25 s.
    assert (len(codes), codes.count("RESIDUAL")) == (9, 1)
    assert [words for words in said if "no report for 32 s" in words] == said[-1:]
    assert "\x1b" not in stream.getvalue()


def test_a_terminal_is_drawn_four_times_a_second_and_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cursor is back, also after Ctrl-C. A dumb terminal gets no codes."""
    monkeypatch.setenv("COLUMNS", "80")
    for kind in ("xterm-256color", "dumb"):
        monkeypatch.setenv("TERM", kind)
        stream = Terminal()
        with contextlib.suppress(KeyboardInterrupt), Display(watched(message()), stream) as display:
            for i in range(100):
                display.show(0.01 * i)
            raise KeyboardInterrupt
        written = stream.getvalue()
        if kind == "dumb":
            assert written.count("/hd_diag joint_1: OK") == 1
            assert "\x1b" not in written
        else:
            assert 3 <= written.count("hd-diag watch") <= 6  # one more at the end
            assert written.count("\x1b[?25l") == written.count("\x1b[?25h") == 1


@pytest.mark.parametrize("terminal", [False, True])
def test_an_encoding_without_its_characters_does_no_harm(terminal: bool, monkeypatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    stream = io.TextIOWrapper(raw := io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    with Display(watched(message("gelenk_1", log_state="x" * 200)), stream) as display:
        display.show(2.0)
    stream.flush()
    assert b"gelenk_1" in raw.getvalue()
