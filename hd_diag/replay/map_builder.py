"""Builds maps beside the running monitor in one worker thread; only each joint's newest request counts."""

from __future__ import annotations

import queue
import threading
from weakref import WeakValueDictionary

from hd_diag.config.configuration import JointConfig
from hd_diag.extended_model import TORQUE_RANGE
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion_map import BuildCancelled, TorsionMap, build


def map_of(joint: JointConfig) -> TorsionMap:
    """Build the map of a joint now."""
    return build(joint.drive.mesh, map_limit(joint))


def map_limit(joint: JointConfig) -> float:
    """Largest torque of a joint's map [N m]."""
    return TORQUE_RANGE * joint.drive.rated_torque


class MapBuilder:
    """Builds maps in its own thread; `finished` holds joints with their maps, or the error of the build."""

    def __init__(self) -> None:
        self.finished: queue.SimpleQueue[tuple[str, TorsionMap | Exception]] = queue.SimpleQueue()
        self._wanted: dict[str, tuple[Mesh, float]] = {}
        # Joints of the same drive share a map, which takes up to 10 MB.
        self._built: WeakValueDictionary[tuple[Mesh, float], TorsionMap] = WeakValueDictionary()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="map builder", daemon=True)
        self._thread.start()

    def request(self, joint: JointConfig) -> None:
        """Ask for a joint's map; an older request of the same joint is dropped."""
        with self._changed:
            self._wanted[joint.name] = (joint.drive.mesh, map_limit(joint))
            self._changed.notify()

    def close(self) -> None:
        """Cancel the running build and end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or bool(self._wanted))
                if self._closed:
                    return
                name, (mesh, limit) = next(iter(self._wanted.items()))
            self._build(name, mesh, limit)

    def _build(self, name: str, mesh: Mesh, limit: float) -> None:
        result: TorsionMap | Exception
        try:
            known = self._built.get((mesh, limit))
            result = known or build(mesh, limit, lambda fraction: self._is_wanted(name, mesh, limit))
            self._built[mesh, limit] = result
        except BuildCancelled:
            return
        except Exception as error:  # after any error the next map must be built
            result = error
        with self._changed:
            if self._wanted.get(name) == (mesh, limit):
                del self._wanted[name]
                self.finished.put((name, result))

    def _is_wanted(self, name: str, mesh: Mesh, limit: float) -> bool:
        with self._changed:
            return not self._closed and self._wanted.get(name) == (mesh, limit)
