"""Every sentence of the pages, in English and German. What recorder, learner and controller say is English as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

LANGUAGES: Final[Mapping[str, str]] = {"en": "English", "de": "Deutsch"}
"""The languages by their codes, each under its own name; the first is spoken to those who want another."""

SENTENCES: Final[Mapping[str, tuple[str, str]]] = {
    # pages
    "teach": ("Teach", "Vormachen"),
    "understand": ("Understand", "Verstehen"),
    "run": ("Run", "Ausführen"),
    "cell": ("cell {cell}", "Zelle {cell}"),
    # teach: what is chosen
    "task": ("Task", "Aufgabe"),
    "user": ("Your name", "Ihr Name"),
    "objects": ("Objects", "Gegenstände"),
    "nearest": ("the nearest, or the one held", "der nächste, oder der gehaltene"),
    "object": ("Object", "Gegenstand"),
    # teach: buttons
    "start": ("Start", "Start"),
    "pick": ("Pick", "Greifen"),
    "place": ("Place", "Ablegen"),
    "drop": ("Drop", "Fallen lassen"),
    "undo": ("Undo", "Zurück"),
    "pause": ("Pause", "Pause"),
    "resume": ("Go on", "Weiter"),
    "keep": ("Stop, keep", "Stopp, behalten"),
    "discard": ("Stop, throw away", "Stopp, verwerfen"),
    # teach: what came of a press
    "step": ("{number}. {type} {object}", "{number}. {type} {object}"),
    "accepted": ("good", "gut"),
    "doubtful": ("doubtful", "zweifelhaft"),
    "contradicts": ("contradicts what was seen", "widerspricht dem Gesehenen"),
    "taken_back": ("taken back", "zurückgenommen"),
    "taken_back_now": ("Action {number} is taken back.", "Aktion {number} ist zurückgenommen."),
    "what_to_do": (
        "Press Undo, see to it, and show the step once more.",
        "Zurück drücken, es beheben und den Schritt noch einmal zeigen.",
    ),
    "begun": (
        "Recording. Lead the hand to the first object.",
        "Aufnahme läuft. Die Hand zum ersten Gegenstand führen.",
    ),
    "kept": ("The demonstration is kept.", "Die Vorführung ist behalten."),
    "thrown_away": ("The demonstration is thrown away.", "Die Vorführung ist verworfen."),
    "paused": ("Paused; nothing is recorded.", "Pause; nichts wird aufgenommen."),
    "resumed": ("Recording again.", "Die Aufnahme läuft wieder."),
    "no_steps": ("No action yet.", "Noch keine Aktion."),
    "ready": ("Name the task and press Start.", "Die Aufgabe benennen und Start drücken."),
    # lights
    "recorder": ("Recorder", "Rekorder"),
    "silent": ("does not answer", "antwortet nicht"),
    "state_idle": ("ready", "bereit"),
    "state_recording": ("recording", "nimmt auf"),
    "state_paused": ("paused", "Pause"),
    "gripper": ("Gripper", "Greifer"),
    "gripper_open": ("open", "offen"),
    "gripper_closed": ("closed", "geschlossen"),
    "unknown": ("unknown", "unbekannt"),
    "disk": ("Disk", "Platte"),
    "free": ("{gigabytes} GB free", "{gigabytes} GB frei"),
    "losses": ("Losses", "Verluste"),
    "lost": ("{count} messages lost", "{count} Nachrichten verloren"),
    "lost_none": ("none", "keine"),
    "lost_unknown": ("not counted", "nicht gezählt"),
    "seen": ("seen", "gesehen"),
    "not_seen": ("not seen", "nicht gesehen"),
    "seen_before": ("seen {seconds} s ago", "vor {seconds} s gesehen"),
    "not_on_table": (
        "No poses arrive from the cell.",
        "Von der Zelle kommen keine Posen an.",
    ),
}
"""By a key the sentence in each of the LANGUAGES, in their order; {words} in braces are filled in."""


@dataclass(frozen=True)
class Voice:
    """The sentences in one language."""

    language: str

    def __call__(self, key: str, **facts: object) -> str:
        """The sentence of a key with its facts filled in. Raises KeyError for a sentence that nobody wrote."""
        return SENTENCES[key][list(LANGUAGES).index(self.language)].format(**facts)

    @staticmethod
    def wanted(cookie: str | None, accepted: str) -> Voice:
        """In the language that was chosen, else in the first known one of the header Accept-Language."""
        asked = [cookie or "", *(part.strip()[:2].lower() for part in accepted.split(","))]
        return Voice(next((language for language in asked if language in LANGUAGES), next(iter(LANGUAGES))))
