"""Topics of a bag that is written: schema and channel records with unique numbers."""

from __future__ import annotations

import os

from mcap.records import Channel, Schema
from rosbags.interfaces import Qos

from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_file import Stream
from hd_diag.bag.rosbag2 import RELIABLE, dump_offers, plain_offers
from hd_diag.messages.schemas import Definition, definition


class Streams(dict[tuple[str, str], Stream]):
    """Streams by topic and type."""

    def __init__(self) -> None:
        super().__init__()
        self._schemas: dict[tuple[str, str], Schema] = {}

    def add(
        self,
        path: str | os.PathLike[str],
        topic: str,
        type_name: str,
        qos: Qos | str | None = None,
        known: Definition | None = None,
    ) -> Stream:
        """Stream of a topic, which is declared if it is new; BagError for `path` if it cannot be declared.

        `qos` is the offered profile, or the YAML text of another bag's ``offered_qos_profiles``. `known` is
        the type's definition, by default that of ROS 2 Jazzy.
        """
        if (found := self.get((topic, type_name))) is not None:
            return found
        number = len(self) + 1
        if number == 2**16:  # channel numbers have 16 bits
            raise BagError(path, f"{topic}: a bag holds no more than {number - 1} topics")
        try:
            known = known or definition(type_name)
        except KeyError as exc:
            raise BagError(path, f"type {type_name} of topic {topic} has no known definition") from exc
        own = known.text.encode(errors="surrogateescape"), known.encoding, type_name  # text may be binary
        schema = self._schemas.setdefault(own[1:], Schema(len(self._schemas) + 1 if type_name else 0, *own))
        offers = plain_offers(qos) if isinstance(qos, str) else dump_offers([qos or RELIABLE])
        extra = {"offered_qos_profiles": offers, "topic_type_hash": known.type_hash}
        made = Stream(schema, Channel(number, topic, known.messages, extra, schema.id))
        self[topic, type_name] = made
        return made
