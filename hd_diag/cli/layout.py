"""``hd-diag layout``: layouts of Foxglove and PlotJuggler for the configured joints.

They are copies of those in config/, which are for one joint of a node, with the names, places and tooth
numbers of the configured joints.
"""

from __future__ import annotations

import copy
import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from hd_diag.cli.examples import installed
from hd_diag.cli.joints import configured
from hd_diag.cli.lines import tell
from hd_diag.cli.options import check_files
from hd_diag.cli.targets import Problem, writing
from hd_diag.config.configuration import JointConfig

FOXGLOVE, PLOTJUGGLER = "foxglove_layout.json", "plotjuggler_layout.xml"
_JOINT, _NODE, _TEETH = "joint_1", "/hd_diag", 200  # of the layouts in config/
_NAME = re.compile(r"(?:/\w+)+", re.ASCII)

Words = Callable[[str], str]


def layout(out: Path, config_file: str | None, node: str) -> None:
    """Run ``hd-diag layout``."""
    joints = configured(config_file).joints
    if not _NAME.fullmatch(node):
        raise Problem(f"--node: expected the node's full name, such as /arm/hd_diag, not {node!a}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{out}: cannot be made: {error.strerror}") from error
    words = {joint.name: partial(_of_joint, joint, place, node) for place, joint in enumerate(joints)}
    texts = {
        FOXGLOVE: foxglove(installed("config", FOXGLOVE).read_text(encoding="utf-8"), words),
        PLOTJUGGLER: plotjuggler(installed("config", PLOTJUGGLER).read_text(encoding="utf-8"), words),
    }
    check_files([out / name for name in texts])
    for name, text in texts.items():
        with writing(out / name) as place:
            place.write_text(text, encoding="utf-8")
        tell(f"{out / name}: {', '.join(words)} of {node}")


def foxglove(template: str, words: Mapping[str, Words]) -> str:
    """The layout with a tab for each joint; `words` has a translation of the template's texts per joint."""
    panels: dict[str, Any] = {}
    tabs: list[Any] = []
    whole = json.loads(template)
    several = len(words) > 1
    for joint, own in words.items():
        mark = f"_{joint}" if several else ""
        ids = {name: f"{name}{mark}" for name in whole["configById"]}

        def renamed(text: str, own: Words = own, ids: dict[str, str] = ids) -> str:
            return ids.get(text) or own(text)

        panels |= {ids[name]: _mapped(panel, renamed) for name, panel in whole["configById"].items()}
        tabs.append({"title": joint, "layout": _mapped(whole["layout"], renamed)})
    place: Any = tabs[0]["layout"]
    if several:
        place = "Tab!joints"
        panels[place] = {"activeTabIdx": 0, "tabs": tabs}
    return json.dumps({**whole, "configById": panels, "layout": place}, indent=2) + "\n"


def plotjuggler(template: str, words: Mapping[str, Words]) -> str:
    """The same for PlotJuggler, with the tabs of each joint one after the other."""
    root = ElementTree.fromstring(template.encode())
    computed = {each.attrib["name"] for each in root.iter("snippet")}
    several = len(words) > 1
    for parent in (_only(root, "tabbed_widget"), _only(root, "customMathEquations")):
        before = [each for each in parent if each.tag in ("Tab", "snippet")]
        rest = [each for each in parent if each not in before]
        parent[:] = []
        for joint, own in words.items():

            def renamed(text: str, own: Words = own, joint: str = joint) -> str:
                return f"{joint} {text}" if several and text in computed else own(text)

            for one in copy.deepcopy(before):
                for element in one.iter():
                    element.text = renamed(element.text) if element.text else element.text
                    for name, value in element.attrib.items():
                        element.set(name, renamed(value))
                if several and one.tag == "Tab":
                    one.set("tab_name", f"{joint}: {one.attrib['tab_name']}")
                parent.append(one)
        parent.extend(rest)
    ElementTree.indent(root, " ")
    head = "<?xml version='1.0' encoding='UTF-8'?>\n"
    return f"{head}{ElementTree.tostring(root, encoding='unicode', short_empty_elements=True)}\n"


def _of_joint(joint: JointConfig, place: int, node: str, text: str) -> str:
    """Translate a text of the template for another joint: its place in messages, its teeth, its name."""
    teeth = joint.drive.mesh.geometry.flexspline_teeth
    ends = {"data[0:199]": f"data[0:{teeth - 1}]", "data[200:399]": f"data[{teeth}:{2 * teeth - 1}]"}
    places = {f"data[{of * _TEETH // 2}]": f"data[{of * teeth // 2}]" for of in range(4)}
    for before, after in (ends | places | {"position[0]": f"position[{place}]"}).items():
        if text.endswith(before):
            text = text.removesuffix(before) + after
            break
    text = re.sub(r"teeth 0 and \d+", f"teeth 0 and {teeth // 2}", text)
    return text.replace(_JOINT, joint.name).replace(f"{_NODE}/", f"{node}/")


def _mapped(value: Any, words: Words) -> Any:
    """A document with all texts translated."""
    if isinstance(value, dict):
        return {words(name): _mapped(each, words) for name, each in value.items()}
    if isinstance(value, list):
        return [_mapped(each, words) for each in value]
    return words(value) if isinstance(value, str) else value


def _only(root: ElementTree.Element, tag: str) -> ElementTree.Element:
    (found,) = root.findall(tag)
    return found
