"""A headless Chromium for tests: layout of pages, their log and their network requests."""

import importlib.util
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

NEEDED = "needs selenium, axe-core-python and Chromium (Debian: apt install chromium chromium-driver)"
WIDTHS = (390, 1280)  # of a phone and a desktop [CSS px]
_PATIENCE = 120.0  # for axe-core on a long page [s]
_LAYOUT, _CONTRAST = (
    Path(__file__).with_name(name).read_text(encoding="utf-8")
    for name in ("page_faults.js", "page_contrast.js")
)


def unavailable() -> None:
    """Skip the test, or fail on a machine that must have the browser."""
    if os.environ.get("CI"):
        pytest.fail(NEEDED)
    pytest.skip(NEEDED)


@contextmanager
def chromium() -> Iterator[Any]:
    """A driver whose own network use is off."""
    try:
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service
    except ImportError:
        unavailable()
    binary = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if binary is None or driver is None:
        unavailable()
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service(driver))
    browser.set_script_timeout(_PATIENCE)
    try:
        yield browser
    finally:
        browser.quit()


def sized(browser: Any, width: int) -> None:
    """Set the window width [CSS px]; a narrow window is a phone's."""
    metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def requested(browser: Any) -> list[str]:
    """Addresses that pages have requested since the last call."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]


def opened(browser: Any, address: str, width: int = 1280) -> Any:
    """Open a page in the browser and clear the earlier log."""
    browser.get("about:blank")  # a long page still open would be laid out again, which takes seconds
    sized(browser, width)
    browser.get_log("browser")
    browser.get_log("performance")
    browser.get(address)
    return browser


def page_faults(browser: Any, address: str, rules: Sequence[str] = ("color-contrast",)) -> list[str]:
    """Faults that a reader would notice on a page at both widths; a good page has none.

    Found: content wider than the window, cut-off text, text or a mark over other text, complaints in the log,
    files from the network; and by `rules` of axe-core, in light and dark, too little contrast.
    """
    found = []
    for width in WIDTHS:
        opened(browser, address, width)
        found += [f"{width} px: {fault}" for fault in browser.execute_script(_LAYOUT)]
        found += [f"{width} px: logged: {entry['message']}" for entry in browser.get_log("browser")]
    found += [
        f"asked for {other}" for other in requested(browser) if not other.startswith(("file:", "data:"))
    ]
    for scheme in ("light", "dark") if rules else ():
        in_scheme(browser, scheme)
        found += [f"{scheme}: {fault}" for fault in _by_axe(browser, rules)]
    in_scheme(browser, "")
    return found


def in_scheme(browser: Any, scheme: str) -> None:
    """Emulate a dark or light scheme; empty: that of the machine."""
    features = [{"name": "prefers-color-scheme", "value": scheme}] if scheme else []
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})


def _by_axe(browser: Any, rules: Sequence[str]) -> list[str]:
    found = importlib.util.find_spec("axe_core_python")
    if found is None or found.origin is None:
        unavailable()
    browser.execute_script(Path(found.origin).with_name("axe.min.js").read_text(encoding="utf-8"))
    return list(browser.execute_async_script(_CONTRAST, list(rules)))


def contrast(one: Sequence[float], other: Sequence[float]) -> float:
    """Contrast from 1 to 21 (WCAG 2.1) of two colours given as red, green and blue from 0 to 1."""
    darker, brighter = sorted((_luminance(one), _luminance(other)))
    return (brighter + 0.05) / (darker + 0.05)


def _luminance(colour: Sequence[float]) -> float:
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


class Markup(HTMLParser):
    """Tags of a page with their attributes, its text, and its whole source."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.source, self.text = source, ""
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(source)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    def values(self, *keys: str) -> list[str]:
        """Values of these attributes in all tags."""
        return [attributes[key] or "" for _, attributes in self.tags for key in keys if key in attributes]
