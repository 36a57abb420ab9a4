"""A figure as SVG within a page: no style or script, ids of its own, an alternative text."""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree as Xml

from matplotlib.figure import Figure

from hd_diag.report.pictures.canvas import INK, styled

_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_FONT = re.compile(r"(?:(italic|oblique)\s+)?(?:(bold|\d{3})\s+)?([\d.]+)px\s+.*")
_NUMBER = re.compile(r"-?\d+\.\d+")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_COORDINATES = ("d", "points", "x", "y", "transform", "width", "height", "x1", "y1", "x2", "y2")
# Properties of a style that are also attributes; all others are dropped.
_ATTRIBUTES = re.compile(
    r"clip-(path|rule)|fill(-opacity|-rule)?|image-rendering|opacity|stroke(-\w+)?|text-anchor"
)

Xml.register_namespace("", _SVG)
Xml.register_namespace("xlink", _XLINK)


def inline_svg(figure: Figure, name: str, title: str, description: str) -> str:
    """SVG element for a page. Without styles, so that the page may forbid them; ink is its text colour.

    `name` begins every id, so that pictures of one page share none; it is a letter, then letters, digits and
    hyphens. `description` says what the picture shows, with its numbers, to those who cannot see it.
    """
    buffer = io.BytesIO()
    with styled():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    root = Xml.fromstring(buffer.getvalue())
    for parent in root.iter():
        for child in list(parent):
            if child.tag in (f"{{{_SVG}}}metadata", f"{{{_SVG}}}style"):
                parent.remove(child)
    for element in root.iter():
        _plain(element)
    _own_ids(root, name)
    _described(root, name, title, description)
    return Xml.tostring(root, encoding="unicode")


def _plain(element: Xml.Element) -> None:
    """Turn a style into attributes, round coordinates to 0.01 points, set ink to the page's text colour."""
    for declaration in element.attrib.pop("style", "").split(";"):
        key, _, value = (part.strip() for part in declaration.partition(":"))
        if key == "font" and (found := _FONT.fullmatch(value)):  # the family is the page's
            names = zip(("font-style", "font-weight", "font-size"), found.groups(), strict=True)
            element.attrib |= {name: part for name, part in names if part}
        elif key == "font-size":
            element.set(key, value.removesuffix("px"))
        elif _ATTRIBUTES.fullmatch(key):
            element.set(key, value)
    for key, value in element.attrib.items():
        if value.lower() == INK:
            element.set(key, "currentColor")
        elif key in _COORDINATES:
            element.set(key, _NUMBER.sub(lambda number: f"{float(number[0]):.2f}", value))


def _own_ids(root: Xml.Element, name: str) -> None:
    """Keep only ids that something refers to, and put the picture's name before them."""
    used = set()
    for element in root.iter():
        for key, value in element.attrib.items():
            used.update(_REFERENCE.findall(value))
            if key == f"{{{_XLINK}}}href" and value.startswith("#"):
                used.add(value[1:])
                element.set(key, f"#{name}-{value[1:]}")
            else:
                element.set(key, _REFERENCE.sub(rf"url(#{name}-\1)", value))
    for element in root.iter():
        own = element.attrib.pop("id", "")
        if own in used:
            element.set("id", f"{name}-{own}")


def _described(root: Xml.Element, name: str, title: str, description: str) -> None:
    for key in ("version", "width", "height"):  # the page gives the size
        root.attrib.pop(key, None)
    labels = {"aria-labelledby": f"{name}-title", "aria-describedby": f"{name}-text"}
    root.attrib |= {"role": "img", **labels, "stroke-linejoin": "round", "stroke-linecap": "butt"}
    for place, (tag, suffix, text) in enumerate((("title", "title", title), ("desc", "text", description))):
        element = Xml.Element(f"{{{_SVG}}}{tag}", {"id": f"{name}-{suffix}"})
        element.text = text
        root.insert(place, element)
