"""Layouts of other tools: every topic, field, frame, status and key in them exists in the node."""

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from cli_runner import assert_one_line_error, hd_diag
from live import MS, START, Recording, config, message

from hd_diag.config.configuration import Config, dump, resolve
from hd_diag.messages.markers import MARKERS
from hd_diag.messages.publications import (
    DIAGNOSTICS,
    HEADERS,
    JOINT_STATE,
    MULTI_ARRAY,
    published_topics,
    resolved,
)
from hd_diag.messages.schemas import jazzy
from hd_diag.replay.recorded_monitor import Session
from hd_diag.watch.state import PREFIX

FOLDER = Path(__file__).resolve().parent.parent / "config"
JOINT = "joint_1"


class Made(NamedTuple):
    """A node's messages and topics by name, its joints with their teeth, and layouts made for it."""

    node: str
    teeth: dict[str, int]
    messages: dict[str, Any]
    topics: dict[str, str]
    foxglove: Any
    plotjuggler: Any

    @property
    def panels(self) -> dict[str, dict[str, Any]]:
        return self.foxglove["configById"]  # type: ignore[no-any-return]

    def panel(self, name: str, joint: str) -> dict[str, Any]:
        return self.panels[name if len(self.teeth) == 1 else f"{name}_{joint}"]


def kinds_of(node: str, joints: Iterable[str]) -> dict[str, str]:
    return {resolved(topic, node): kind for topic, kind in published_topics([*joints]).items()}


def published(configured: Config, node: str) -> dict[str, Any]:
    recording, joints = Recording(), [joint.name for joint in configured.joints]
    session = Session(configured, recording, node)
    session.start(START)
    for i in range(300):
        angles = {name: 0.001 * i for joint in joints for name in (f"{joint}_motor", joint)}
        outputs = dict.fromkeys(joints, 0.00001 * i)
        data = message(START + i * MS, angles | outputs, dict.fromkeys(joints, 14.0))
        session.joint_state(START + i * MS, data)
    session.tick(START + 300 * MS, START + 300 * MS, {"log_state": "off", "latency_p99_us": "700"})
    found = {resolved(topic, node): rows[-1][1] for topic, rows in recording.topics().items()}
    return {topic: jazzy().deserialize_cdr(found[topic], k) for topic, k in kinds_of(node, joints).items()}


def layouts(folder: Path) -> tuple[Any, Any]:
    panels = json.loads((folder / "foxglove_layout.json").read_text())
    return panels, ElementTree.parse(folder / "plotjuggler_layout.xml").getroot()


@pytest.fixture(scope="module")
def messages() -> dict[str, Any]:
    return published(config(JOINT, mesh_rate=60.0, array_rate=100.0), "/hd_diag")


ARM = {"elbow.gear.size": 20.0, "elbow.gear.ratio": 80.0, "elbow.gear.rated_torque": 34.0}
ARM |= {"elbow.gear.k1": 1.0e4, "elbow.gear.k2": 1.4e4, "elbow.gear.k3": 1.6e4}


@pytest.fixture(scope="module", params=["package", "arm"])
def made(request, messages, tmp_path_factory) -> Made:
    """The package's layouts, and layouts made for two joints with different numbers of teeth."""
    if request.param == "package":
        return Made("/hd_diag", {JOINT: 200}, messages, kinds_of("/hd_diag", [JOINT]), *layouts(FOLDER))
    folder, node = tmp_path_factory.mktemp("arm"), "/left/hd_diag"
    teeth = {"shoulder": 200, "elbow": 160}
    given = resolve({"joints": [*teeth], "mesh_rate": 20.0, "array_rate": 20.0, **ARM})
    (folder / "arm.yaml").write_text(dump(given))
    words = ("layout", "--config", folder / "arm.yaml", "--out", folder / "new", "--node", node)
    assert hd_diag(*words).exit_code == 0
    return Made(node, teeth, published(given, node), kinds_of(node, teeth), *layouts(folder / "new"))


KINDS = {"3D", "Plot", "StateTransitions", "DiagnosticSummary", "DiagnosticStatusPanel", "RawMessages", "Tab"}
# The message path syntax: a name, then an optional slice, then an optional filter.
ELEMENT = re.compile(r'\.(\w+)(?:\[(\d*)(:?)(\d*)\])?(?:\{(\w+)=="([^"]*)"\})?')


def topic_of(path: str) -> str:
    return path.split(".")[0]


def chosen(messages: dict[str, Any], path: str) -> list[Any]:
    """What a message path selects from the message of its topic."""
    found = [messages[topic_of(path)]]
    path = path.removeprefix(topic_of(path))
    while path:
        element = ELEMENT.match(path)
        assert element, f"not a message path: {path}"
        name, low, colon, high, key, wanted = element.groups()
        found = [getattr(item, name) for item in found]
        if low or colon:
            begin = int(low or 0)
            end = begin + 1 if not colon else int(high) + 1 if high else None
            assert end is None or all(end <= len(item) for item in found), f"{path} is beyond its array"
            found = [value for item in found for value in item[begin:end]]
        if key:
            found = [item for item in found if getattr(item, key) == wanted]
        path = path[element.end() :]
    return found


def panels_of(panels: dict[str, dict[str, Any]], node: Any) -> list[str]:
    if isinstance(node, str):
        tabs = panels[node].get("tabs", ())
        return [node, *(one for tab in tabs for one in panels_of(panels, tab["layout"]))]
    assert node["direction"] in ("row", "column")
    assert 0.0 < node.get("splitPercentage", 50) < 100.0
    return panels_of(panels, node["first"]) + panels_of(panels, node["second"])


def test_foxglove_layout_is_complete_and_takes_something_from_real_messages(made: Made) -> None:
    assert set(made.foxglove) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert made.foxglove["globalVariables"] == made.foxglove["userNodes"] == {}
    assert {panel.split("!")[0] for panel in made.panels} <= KINDS
    assert sorted(panels_of(made.panels, made.foxglove["layout"])) == sorted(made.panels)
    if len(made.teeth) > 1:
        assert [tab["title"] for tab in made.panels[made.foxglove["layout"]]["tabs"]] == [*made.teeth]
    paths = {path["value"] for panel in made.panels.values() for path in panel.get("paths", ())}
    for path in paths | {panel["topicPath"] for panel in made.panels.values() if "topicPath" in panel}:
        found = chosen(made.messages, path)
        assert found, f"{path} takes nothing"
        assert len(found) == 1 or topic_of(path) != "/diagnostics" or not path.endswith(".value"), path


def test_foxglove_plots_numbers_and_whole_flanks(made: Made) -> None:
    plotted = set()
    for panel in (made.panels[name] for name in made.panels if name.startswith("Plot!")):
        paths = [path["value"] for path in panel["paths"]]
        assert [float(value) for path in paths for value in chosen(made.messages, path)]
        by_index = panel["xAxisVal"] == "index"
        assert by_index == all(made.topics[topic_of(path)] == MULTI_ARRAY for path in paths)
        plotted |= set(map(topic_of, paths))
    assert plotted == {topic for topic, kind in made.topics.items() if kind not in (MARKERS, HEADERS)}
    for place, (joint, teeth) in enumerate(made.teeth.items()):
        for what in ("backlash", "load"):
            message = made.messages[f"{made.node}/{joint}/{what}"]
            paths = [path["value"] for path in made.panel(f"Plot!{what}", joint)["paths"]]
            parts = [chosen(made.messages, path) for path in paths]
            assert [len(part) for part in parts] == [teeth] * 2 == [message.layout.dim[1].size] * 2
            assert [str(value) for part in parts for value in part] == [str(value) for value in message.data]
        errors = {path["value"] for path in made.panel("Plot!residual", joint)["paths"]}
        assert f"{made.node}/residual.position[{place}]" in errors
        assert made.messages[f"{made.node}/residual"].name[place] == joint


def test_foxglove_panels_find_each_joint_and_its_mesh_in_its_frame(made: Made) -> None:
    known = {(status.hardware_id, status.name) for status in made.messages["/diagnostics"].status}
    for name, panel in made.panels.items():
        if name.startswith("Diagnostic"):
            assert made.topics[panel["topicToRender"]] == DIAGNOSTICS
    statuses = [made.panel("DiagnosticStatusPanel!joint", joint) for joint in made.teeth]
    assert {(each["selectedHardwareId"], each["selectedName"]) for each in statuses} == known
    drawn = {joint: made.panel("3D!mesh", joint) for joint in made.teeth}
    topics = {topic for panel in drawn.values() for topic in panel["topics"]}
    assert topics == {topic for topic, kind in made.topics.items() if kind == MARKERS}
    for joint, panel in drawn.items():
        (topic,) = panel["topics"]
        frames = {marker.header.frame_id for marker in made.messages[topic].markers}
        assert frames == {panel["followTf"]} == {joint}


NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?|nan|-?inf")


def series(topic: str, message: Any) -> Iterator[str]:
    """Names of the curves that PlotJuggler's ROS parsers make of a message."""
    kind = message.__msgtype__
    if kind == JOINT_STATE:
        for field in ("position", "velocity", "effort"):
            if len(getattr(message, field)):
                yield from (f"{topic}/{name}/{field}" for name in message.name)
    elif kind == DIAGNOSTICS:
        for status in message.status:
            owner = "/".join(filter(None, (topic, status.hardware_id, status.name)))
            yield from (f"{owner}/{pair.key}" for pair in status.values if NUMBER.fullmatch(pair.value))
    elif kind == MULTI_ARRAY:
        yield from (f"{topic}/data[{i}]" for i in range(len(message.data)))


def test_plotjuggler_layout_has_the_parts_of_a_saved_one(made: Made) -> None:
    (tabs,) = made.plotjuggler.findall("tabbed_widget")
    assert (made.plotjuggler.tag, tabs.get("parent")) == ("root", "main_window")
    assert len(tabs.findall("Tab")) == 3 * len(made.teeth)
    areas = len(tabs.findall("./Tab/Container/DockSplitter/DockArea/plot"))
    assert areas == len(list(tabs.iter("plot"))) == len(list(tabs.iter("DockArea"))) > 0
    for splitter in tabs.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == len(splitter) == int(splitter.attrib["count"])
        assert sum(sizes) == pytest.approx(1.0)
    (current,) = tabs.findall("currentTabIndex")
    assert 0 <= int(current.attrib["index"]) < len(tabs.findall("Tab"))


def test_plotjuggler_curves_are_those_of_real_messages(made: Made) -> None:
    known = {name for topic, message in made.messages.items() for name in series(topic, message)}
    computed = {snippet.attrib["name"]: snippet for snippet in made.plotjuggler.iter("snippet")}
    curves = {curve.attrib["name"] for curve in made.plotjuggler.iter("curve")}
    assert curves <= known | computed.keys()
    assert computed.keys() <= curves
    for snippet in computed.values():
        assert snippet.findtext("linked_source") in known
        assert snippet.findtext("function") == "return value * 206264.806"  # arcsec per radian
    topics = {snippet.findtext("linked_source") for snippet in computed.values()} | curves
    for topic, kind in made.topics.items():
        is_shown = any(f"{name}/".startswith(f"{topic}/") for name in topics)
        assert is_shown == (kind not in (MARKERS, HEADERS)), topic
    for joint, teeth in made.teeth.items():
        places = {int(name[:-1].rpartition("[")[2]) for name in curves if f"/{joint}/load/" in name}
        assert places == {k * teeth // 2 for k in range(4)}


def test_of_one_joint_the_made_layouts_are_those_of_the_package(tmp_path: Path) -> None:
    """An impossible layout gives a one-line error."""
    assert hd_diag("layout", "--out", tmp_path).exit_code == 0
    (panels, *made), (own, *given) = layouts(tmp_path), layouts(FOLDER)
    assert panels == own
    texts = [ElementTree.canonicalize(ElementTree.tostring(r), strip_text=True) for r in made + given]
    assert texts[0] == texts[1]
    result = hd_diag("layout", "--out", tmp_path, "--node", "arm/<x>")
    assert_one_line_error(result, "expected the node's full name")
    (tmp_path / "file").touch()
    assert_one_line_error(hd_diag("layout", "--out", tmp_path / "file/in"), "cannot be made")


RVIZ = yaml.safe_load((FOLDER / "rviz.rviz").read_text())["Visualization Manager"]


def test_rviz_shows_the_whole_mesh_with_its_legend_in_its_frame(messages: dict[str, Any]) -> None:
    (display,) = RVIZ["Displays"]
    topic = display["Topic"]["Value"]
    assert display["Class"] == "rviz_default_plugins/MarkerArray"
    assert kinds_of("/hd_diag", [JOINT])[topic] == MARKERS
    markers = messages[topic].markers
    assert {marker.header.frame_id for marker in markers} == {RVIZ["Global Options"]["Fixed Frame"]}
    assert {marker.ns: True for marker in markers} == display["Namespaces"]
    view = RVIZ["Views"]["Current"]  # pixels per metre; the window gives the drawing about 800
    assert view["Class"] == "rviz_default_plugins/TopDownOrtho"
    heights = [p.y for marker in markers for p in marker.points]
    heights += [m.pose.position.y - 2.0 * m.scale.z for m in markers if m.text]
    assert max(max(heights) - view["Y"], view["Y"] - min(heights)) * view["Scale"] < 400


AGGREGATOR = yaml.safe_load((FOLDER / "diagnostic_aggregator.yaml").read_text())["analyzers"]
(ANALYZER,) = (value for value in AGGREGATOR["ros__parameters"].values() if isinstance(value, dict))
STRANGERS = ("hd_diagnostics: battery", "hd_diag", "hd_diag_watch: x", "my hd_diag: joint_1", "camera: j", "")


def test_aggregator_shows_this_node_s_joints_alone(messages: dict[str, Any]) -> None:
    """A GenericAnalyzer decides by the start of a name alone."""
    assert set(ANALYZER) == {"type", "path", "timeout", "remove_prefix", "startswith"}
    assert ANALYZER["type"] == "diagnostic_aggregator/GenericAnalyzer"
    (status,), begins = messages["/diagnostics"].status, tuple(ANALYZER["startswith"])
    assert all(name.startswith(begins) for name in (status.name, f"{PREFIX}shoulder pan"))
    assert not any(name.startswith(begins) for name in STRANGERS)
    (prefix,) = ANALYZER["remove_prefix"]
    assert status.name.removeprefix(prefix) == JOINT
    assert isinstance(ANALYZER["timeout"], float)
    assert ANALYZER["timeout"] > 2.0 / config(JOINT).diagnostics_rate


def test_the_page_about_robots_names_every_layout() -> None:
    page = (FOLDER.parent / "docs" / "robot.md").read_text()
    for name in ("foxglove_layout.json", "plotjuggler_layout.xml", "rviz.rviz", "diagnostic_aggregator.yaml"):
        assert f"config/{name}" in page
