"""A browser that tests lead by clicks and keys: the system's chromium."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

expect.set_options(timeout=20_000)  # on a machine that does much else
_CONTEXTS: dict[tuple[Browser, str], BrowserContext] = {}
TABLET, PHONE = (1024, 768), (390, 844)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Without a chromium a test is skipped, but not where the continuous integration runs: it installs one."""
    path = shutil.which("chromium")
    if path is None:
        assert not os.environ.get("CI"), "no chromium is installed"
        pytest.skip("no chromium is installed")
    with sync_playwright() as playwright:
        # As root, in a container, there is no sandbox to be had.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


class Watched:
    """A page, open within a `with` block: what it asks for elsewhere, or what goes wrong in it, fails the test."""

    def __init__(
        self,
        browser: Browser,
        size: tuple[int, int] = TABLET,
        language: str = "en-US",
        context: BrowserContext | None = None,
    ) -> None:
        # Pages of one language share what the browser has loaded and compiled already.
        if context is None:
            context = _CONTEXTS.get((browser, language)) or browser.new_context(locale=language)
            _CONTEXTS[browser, language] = context
        self.page: Page = context.new_page()
        self.page.set_viewport_size({"width": size[0], "height": size[1]})
        self.foreign: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self._note(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.page.close()
        assert error is not None or (self.foreign, self.errors) == ([], [])

    def _note(self, url: str) -> None:
        if urlsplit(url).scheme not in ("data", "blob") and urlsplit(url).hostname != "127.0.0.1":
            self.foreign.append(url)

    @property
    def overflow_px(self) -> int:
        """How much wider than the window the page is."""
        width: int = self.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        return width

    def picture(self, name: str) -> None:
        """Write what is shown at both sizes into the folder that SCREENSHOTS names, if it names one."""
        folder = os.environ.get("SCREENSHOTS")
        for size, (width, height) in {"tablet": TABLET, "phone": PHONE}.items() if folder else ():
            self.page.set_viewport_size({"width": width, "height": height})
            self.page.wait_for_timeout(500)
            self.page.screenshot(path=f"{folder}/panel-{name}-{size}.jpg", type="jpeg", quality=60)

    def overlapping(self) -> list[str]:
        """The texts of buttons and fields that cover each other, or that are wider than their button."""
        found: list[str] = self.page.evaluate(OVERLAPPING)
        return found


OVERLAPPING = """() => {
  const shown = [...document.querySelectorAll("main button:not(.tw-stop), main .q-field, nav a, nav button")]
    .filter((each) => each.offsetParent !== null).map((each) => [each, each.getBoundingClientRect()]);
  const beside = (a, b) => a.right <= b.left + 1 || b.right <= a.left + 1;
  const apart = (a, b) => beside(a, b) || a.bottom <= b.top + 1 || b.bottom <= a.top + 1;
  const covering = shown.flatMap(([one, box], place) => shown.slice(place + 1)
    .filter(([other, its]) => !one.contains(other) && !apart(box, its))
    .map(([other]) => `${one.innerText} / ${other.innerText}`));
  const bursting = shown.filter(([each]) => each.scrollWidth > each.clientWidth + 1).map(([each]) => each.innerText);
  return [...covering, ...bursting];
}"""
"""Which buttons, links and fields of a page cover each other or do not hold their text."""
