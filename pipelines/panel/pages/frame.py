"""What every page has: its head with the navigation, the language of who looks, keys, and how errors are told."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from nicegui import ui
from starlette.requests import Request

from pipelines.panel.access.login import LANGUAGE
from pipelines.panel.lights import Light
from pipelines.panel.sentences import LANGUAGES, Voice

HERE: Final = Path(__file__).parent
STYLE: Final = f"<style>{(HERE / 'page.css').read_text()}</style>"
KEYS: Final = f"<script>{(HERE / 'keys.js').read_text()}</script>"
STOPS: Final = '<meta name="treewright-space" content="stop">'
"""On a page with this the space bar stops the run, before anything else of the page is there."""
PAGES: Final = {"teach": "/", "understand": "/understand", "run": "/run"}
REFRESH_S: Final = 0.2
"""Time between two looks at what has changed [s]."""


def voice_of(request: Request) -> Voice:
    """In the language that the person chose before, else that of the browser."""
    return Voice.wanted(request.cookies.get(LANGUAGE), request.headers.get("accept-language", ""))


@contextmanager
def page(here: str, cell: str, voice: Voice) -> Iterator[None]:
    """The head of a page, and below it what the block builds."""
    ui.add_head_html(STYLE + KEYS)
    ui.page_title(f"{voice(here)} · {cell}")
    with ui.element("nav").classes("tw-bar"):
        for name, path in PAGES.items():
            ui.link(voice(name), path).classes("tw-here" if name == here else "")
        ui.label(voice("cell", cell=cell)).classes("tw-cell")
        for code, name in LANGUAGES.items():
            if code != voice.language:
                ui.button(name, on_click=lambda code=code: _speak(code)).props("flat dense no-caps color=white")
    with ui.element("main").classes("tw-page"):
        yield


def _speak(code: str) -> None:
    ui.run_javascript(
        f"document.cookie = '{LANGUAGE}={code}; path=/; max-age=31536000; samesite=strict'; location.reload()"
    )


class KeyButton:
    """A large button, which its key presses too; the key is written on it, as `shown` where it has no letter.

    What it does for the server it does once its page has a connection; so it is disabled until a page enables it.
    """

    def __init__(
        self,
        text: str,
        key: str,
        press: Callable[[], Awaitable[None]] | None,
        color: str,
        style: str = "",
        shown: str = "",
    ) -> None:
        self.element = ui.button(on_click=press, color=color).props(f'unelevated data-key="{key}"').classes(style)
        with self.element:
            self.text = ui.label(text)
            ui.label(shown or key.upper()).classes("tw-key")
        self.element.set_enabled(press is None)


class LightRow:
    """The lights, always in view."""

    def __init__(self) -> None:
        self._row = ui.element("div").classes("tw-card tw-lights tw-across")
        self._lights: tuple[Light, ...] = ()

    def show(self, lights: tuple[Light, ...]) -> None:
        """Show lights where they have changed."""
        if lights == self._lights:
            return
        self._lights = lights
        self._row.clear()
        with self._row:
            for light in lights:
                ui.label(f"{light.name}: {light.text}").classes(f"tw-light {light.color}")
