"""Debian's Chromium without a display and without a network, for tests of pages."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
needs_browser = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None, reason="no Chromium: apt-get install chromium chromium-driver"
)
_FLAGS = (
    *("--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *(
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
        "--force-prefers-reduced-motion",
        "--disable-dev-shm-usage",
    ),
)


class Page:
    """A page that is open in a browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def run(self, script: str, *arguments: object) -> Any:
        """Return what a script returns."""
        return self.driver.execute_script(script, *arguments)

    def set(self, name: str, value: object) -> None:
        """Give a control a value, as a user does, and wait for the next picture."""
        self.set_all({name: value})

    def set_all(self, values: Mapping[str, object]) -> None:
        """Give controls values, one after the other."""
        self.run(
            "for (const [name, value] of Object.entries(arguments[0])) {"
            "  const e = document.getElementById(name);"
            "  if (e.type === 'checkbox') e.checked = value; else e.value = value;"
            "  e.dispatchEvent(new Event('input', {bubbles: true}));"
            "  e.dispatchEvent(new Event('change', {bubbles: true}));"
            "}",
            dict(values),
        )
        self.settle()

    def settle(self) -> None:
        """Wait until two frames have been drawn."""
        self.driver.execute_async_script("const f = requestAnimationFrame; f(() => f(() => f(arguments[0])))")

    def click_canvas(self, right: float = 0.0, down: float = 0.0) -> None:
        """Click the picture, some pixels from its middle."""
        from selenium.webdriver import ActionChains

        canvas = self.driver.find_element("id", "canvas")
        ActionChains(self.driver).move_to_element_with_offset(canvas, right, down).click().perform()
        self.settle()

    def at_width(self, width: int) -> None:
        """Show the page as a phone or a window of this width does; 0 for the window's own width."""
        if width:
            size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
            self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        else:
            self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        self.settle()

    @property
    def scrolls_sideways(self) -> bool:
        return bool(self.run("return document.documentElement.scrollWidth > window.innerWidth"))

    def text(self, selector: str) -> str:
        return str(self.run("return document.querySelector(arguments[0]).textContent", selector))

    def pixels(self) -> np.ndarray:
        """The canvas as it is seen, (height, width, 3)."""
        import matplotlib.image

        self.run("document.getElementById('canvas').scrollIntoView({block: 'start'})")
        self.settle()
        png = self.driver.find_element("id", "canvas").screenshot_as_png
        return np.asarray(matplotlib.image.imread(io.BytesIO(png))[:, :, :3])

    def screenshot(self, path: Path, height: int | None = None) -> None:
        """Save what is seen; with a height, that much of the page."""
        if height is not None:
            self.driver.set_window_size(1280, height)
            self.settle()
        self.driver.save_screenshot(str(path))

    def complaints(self) -> list[str]:
        """Messages of the console that are warnings or worse."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] in ("WARNING", "SEVERE")]

    def requests(self) -> list[str]:
        """Addresses that the page has asked for, other than itself and data within it."""
        messages = (json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance"))
        sent = [m["params"] for m in messages if m["method"] == "Network.requestWillBeSent"]
        own = [request["request"]["url"] for request in sent if request["documentURL"] == self.driver.current_url]
        assert self.driver.current_url in own  # the log is kept
        return [url for url in own if url != self.driver.current_url and not url.startswith(("data:", "blob:"))]


@contextmanager
def opened(path: Path | str, profile: Path, *more_flags: str) -> Iterator[Page]:
    """Open a file by its ``file://`` address, or an address of this machine."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*_FLAGS, f"--user-data-dir={profile}", "--window-size=1280,1000", *more_flags):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    try:
        driver.execute_cdp_cmd("Network.enable", {})
        driver.get(path if isinstance(path, str) else path.resolve().as_uri())
        page = Page(driver)
        for _ in range(200):
            root = "const root = document.documentElement;"
            if page.run(f"{root} return root.dataset.viewer === 'ready' || root.classList.contains('no-viewer')"):
                break
            if not page.run("return !!document.getElementById('scene')"):
                break
            driver.execute_async_script("setTimeout(arguments[0], 50)")
        yield page
    finally:
        driver.quit()
