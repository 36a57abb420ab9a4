"""The SROS 2 policy against the names of running nodes."""

import fnmatch
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from live import parameters
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from running import Rig, running

from hd_diag.watch.listener import Listener
from hd_diag.watch.state import Watch

pytestmark = pytest.mark.usefixtures("ros")

ROOT = Path(__file__).resolve().parent.parent
RIGHTS = {
    ("topics", "publish"): "get_publisher_names_and_types_by_node",
    ("topics", "subscribe"): "get_subscriber_names_and_types_by_node",
    ("services", "reply"): "get_service_names_and_types_by_node",
    ("services", "request"): "get_client_names_and_types_by_node",
}


def allowed(enclave: str) -> dict[tuple[str, str], set[str]]:
    """Full names that an enclave's profile allows, resolved like sros2: ~ is the node, / the root."""
    policy = ElementTree.parse(ROOT / "config/sros2_policy.xml").getroot()
    (profile,) = policy.findall(f"contexts/context[@path='{enclave}']/profiles/profile")
    found: dict[tuple[str, str], set[str]] = {right: set() for right in RIGHTS}
    for rule in profile:
        ((action, verdict),) = rule.attrib.items()
        assert verdict == "ALLOW"
        for expression in rule:
            assert expression.tag == rule.tag.removesuffix("s")
            name = (expression.text or "").replace("~", f"/{profile.attrib['node']}")
            found[rule.tag, action].add(name if name.startswith("/") else f"/{name}")
    return found


def used(observer: Node, name: str, namespace: str) -> dict[tuple[str, str], set[str]]:
    """Full names that a running node uses, without its namespace."""
    return {
        right: {one.removeprefix(namespace.rstrip("/")) for one, _ in getattr(observer, ask)(name, namespace)}
        for right, ask in RIGHTS.items()
    }


def differences(enclave: str, names: dict[tuple[str, str], set[str]]) -> Iterator[str]:
    for right, patterns in allowed(enclave).items():
        used_of = {pattern: set(fnmatch.filter(names[right], pattern)) for pattern in patterns}
        yield from (f"{right}: {name} is not allowed" for name in names[right].difference(*used_of.values()))
        yield from (f"{right}: nothing is {pattern}" for pattern, found in used_of.items() if not found)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    given = parameters("shoulder", "elbow", use_sim_time=True)
    with running(tmp_path_factory.mktemp("secured"), given) as rig:
        yield rig


def settled(rig: Rig, name: str, namespace: str, enclave: str, left: set[str]) -> list[str]:
    """Differences except for those in ``left``, once the graph is known."""
    found: list[str] = []

    def is_settled() -> bool:
        if (name, namespace) not in rig.node.get_node_names_and_namespaces():
            found[:] = [f"{name} is not known yet"]  # on a busy machine topics appear before the name
            return False
        found[:] = sorted(set(differences(enclave, used(rig.node, name, namespace))) - left)
        return not found

    try:
        rig.until(is_settled, "graph", 10.0)
    except AssertionError:
        assert found, "the node ended"
    return found


def test_the_node_may_do_what_it_does_and_nothing_else(rig: Rig) -> None:
    assert settled(rig, "hd_diag", rig.process.namespace, "/hd_diag", set()) == []


def test_who_watches_may_read_diagnostics_alone(rig: Rig) -> None:
    listener = Listener(Watch())
    assert settled(rig, listener.get_name(), "/", "/hd_diag/watch", set()) == []
    listener.destroy_node()


def test_who_sets_parameters_may(rig: Rig) -> None:
    """The operator's other rights are for other programs: ros2 param, pictures of the results."""
    node = rclpy.create_node("set_parameters")
    client = AsyncParameterClient(node, "/hd_diag")
    names = {
        "('topics', 'subscribe'): nothing is /diagnostics",
        "('topics', 'subscribe'): nothing is /hd_diag/*",
        "('services', 'reply'): nothing is /_ros2cli_*",
    }
    assert settled(rig, "set_parameters", "/", "/hd_diag/operator", names) == []
    assert client.node is node
    node.destroy_node()


def test_a_right_that_is_missing_or_too_many_is_found() -> None:
    names: dict[tuple[str, str], set[str]] = {right: set() for right in RIGHTS}
    names["topics", "publish"] = {"/diagnostics", "/cmd_vel"}
    found = list(differences("/hd_diag/watch", names))
    assert "('topics', 'publish'): /cmd_vel is not allowed" in found
    assert "('topics', 'subscribe'): nothing is /diagnostics" in found
