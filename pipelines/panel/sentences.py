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
    # login
    "token_wanted": ("Your token", "Ihr Schlüssel"),
    "token_refused": ("This is no token of this panel.", "Das ist kein Schlüssel für diese Tafel."),
    "token_enter": ("Enter", "Eintreten"),
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
    # teach: what came of a demonstration
    "lesson_reading": ("The demonstration is being read.", "Die Vorführung wird gelesen."),
    "lesson_refused": (
        "The demonstration cannot be learned from; show it once more.",
        "Aus der Vorführung kann nicht gelernt werden; bitte noch einmal vormachen.",
    ),
    "lesson_learning": ("The task is being learned.", "Die Aufgabe wird gelernt."),
    "lesson_failed": ("Learning did not succeed.", "Das Lernen ist nicht gelungen."),
    "lesson_learned": ("Learned: {task} version {version}", "Gelernt: {task} Fassung {version}"),
    "lesson_same": ("Nothing new: still {task} version {version}", "Nichts Neues: weiterhin {task} Fassung {version}"),
    "understood_pick": ("{object} was taken.", "{object} wurde gegriffen."),
    "understood_place": ("{object} was placed.", "{object} wurde abgelegt."),
    "understood_drop": ("{object} was dropped.", "{object} wurde fallen gelassen."),
    "understood_place_near": (
        "{object} was placed; it rests {distance} mm from {near}.",
        "{object} wurde abgelegt; es ruht {distance} mm von {near}.",
    ),
    "understood_drop_near": (
        "{object} was dropped; it rests {distance} mm from {near}.",
        "{object} wurde fallen gelassen; es ruht {distance} mm von {near}.",
    ),
    "look_at_it": ("Look at what was learned", "Ansehen, was gelernt wurde"),
    # the tree
    "pick_and_release": (
        "Pick {object} and {kind} at {at} mm in {frame}",
        "{object} greifen und {kind} bei {at} mm in {frame}",
    ),
    "release": ("{kind} {object} at {at} mm in {frame}", "{object} {kind} bei {at} mm in {frame}"),
    "recovery": (
        "Repairs what was not demonstrated ({count} nodes)",
        "Behebt, was nicht vorgemacht wurde ({count} Knoten)",
    ),
    "node_Sequence": ("One after the other", "Eins nach dem anderen"),
    "node_ReactiveSequence": ("One after the other, each kept true", "Eins nach dem anderen, jedes bleibt erfüllt"),
    "node_Fallback": ("The first that works of", "Das Erste, das gelingt, von"),
    "node_ReactiveFallback": ("The first that holds or works of", "Das Erste, das gilt oder gelingt, von"),
    "node_Inverter": ("Not", "Nicht"),
    "node_ForceSuccess": ("Whatever comes of it, go on after", "Was auch daraus wird, weiter nach"),
    "node_ForceFailure": ("Whatever comes of it, look again after", "Was auch daraus wird, noch einmal schauen nach"),
    "node_GripperIs": ("Is the gripper {state}?", "Ist der Greifer {state}?"),
    "node_InGripper": ("Is {object} held?", "Wird {object} gehalten?"),
    "node_InGripper_none": ("Is nothing held?", "Wird nichts gehalten?"),
    "node_ObjectAt": (
        "Does {object} lie within {radius} mm of {at} mm in {frame}?",
        "Liegt {object} innerhalb {radius} mm um {at} mm in {frame}?",
    ),
    "node_ObjectPosedAt": (
        "Does {object} lie within {radius} mm of {at} mm in {frame}, turned as shown?",
        "Liegt {object} innerhalb {radius} mm um {at} mm in {frame}, gedreht wie gezeigt?",
    ),
    "node_ObjectRoughlyAt": (
        "Is {object} above or below {at} mm in {frame}, within {radius} mm?",
        "Ist {object} über oder unter {at} mm in {frame}, innerhalb {radius} mm?",
    ),
    "node_Pick": (
        "Pick {object} with the hand at {at} mm in {frame}",
        "{object} greifen mit der Hand bei {at} mm in {frame}",
    ),
    "node_Place": (
        "Place {object} with the hand at {at} mm in {frame}",
        "{object} ablegen mit der Hand bei {at} mm in {frame}",
    ),
    "node_Drop": (
        "Drop {object} with the hand at {at} mm in {frame}",
        "{object} fallen lassen mit der Hand bei {at} mm in {frame}",
    ),
    "node_SetGripper": ("Make the gripper {state}", "Den Greifer {state} stellen"),
    "node_SignalIs": ("Is the signal {signal} {value}?", "Ist das Signal {signal} gleich {value}?"),
    "node_SetSignal": ("Set the signal {signal} to {value}", "Das Signal {signal} auf {value} setzen"),
    "node_FindObject": (
        "Is there a {kind} to take? It is called {object}",
        "Gibt es etwas von der Art {kind} zu nehmen? Es heißt {object}",
    ),
    "node_CountAt": ("Are there {count} of {kind} at the places?", "Sind {count} von der Art {kind} an den Plätzen?"),
    "node_FindUpon": (
        "Does something lie upon {object}? It is called {found}",
        "Liegt etwas auf {object}? Es heißt {found}",
    ),
    "node_FindUnder": (
        "Does {object} lie upon something? It is called {found}",
        "Liegt {object} auf etwas? Es heißt {found}",
    ),
    "node_FindInTheWay": (
        "Is something in the way of {object} at {at} mm in {frame}? It is called {found}",
        "Ist {object} bei {at} mm in {frame} etwas im Weg? Es heißt {found}",
    ),
    "node_FindHeld": ("Is something held? It is called {object}", "Wird etwas gehalten? Es heißt {object}"),
    "node_FindSpot": ("Is there a free spot for {object}?", "Gibt es einen freien Platz für {object}?"),
    "node_FindGrasp": (
        "Is there a grasp of {object} that was not tried?",
        "Gibt es einen Griff für {object}, der nicht versucht ist?",
    ),
    # understand
    "versions": ("Versions", "Fassungen"),
    "version_line": ("version {version}", "Fassung {version}"),
    "sizes": ("{nodes} nodes, {recovery} that repair", "{nodes} Knoten, {recovery} die beheben"),
    "nothing_learned": ("Nothing is learned yet.", "Noch ist nichts gelernt."),
    "tree": ("What the robot does", "Was der Roboter tut"),
    "show_recovery": ("show what repairs", "zeigen, was behebt"),
    "show_once_more": ("Show it once more", "Noch einmal vormachen"),
    "approve": ("Approve in spite of the doubts", "Trotz der Zweifel freigeben"),
    "set_production": ("Set as production", "Für die Produktion setzen"),
    "approved_now": ("Version {version} is approved by {name}.", "Fassung {version} ist von {name} freigegeben."),
    "production_now": ("Version {version} is what production runs.", "Fassung {version} läuft in der Produktion."),
    "section_goals": ("It brings about", "Es bewirkt"),
    "section_doubtful": ("Doubtful, because", "Zweifelhaft, denn"),
    "section_approved": ("Approved", "Freigegeben"),
    "section_trials": ("How it was tried", "Wie es erprobt wurde"),
    "section_users": ("Users", "Vormachende"),
    "section_questions": ("To show next", "Als Nächstes zu zeigen"),
    "section_notes": ("Notes", "Anmerkungen"),
    "evidence": (
        "shown {samples} times, spread {spread} mm, in {frame} rather than another frame: {certainty} %",
        "{samples}-mal gezeigt, Streuung {spread} mm, in {frame} statt anderem Bezug: {certainty} %",
    ),
    # run
    "version": ("Task and version", "Aufgabe und Fassung"),
    "keep_watching": (
        "go on after success, and repair what is disturbed",
        "nach dem Erfolg weitermachen und Störungen beheben",
    ),
    "stop": ("STOP", "STOPP"),
    "space": ("space bar", "Leertaste"),
    "not_running": ("Nothing runs.", "Nichts läuft."),
    "starting": ("The run is being prepared.", "Der Lauf wird vorbereitet."),
    "running_tree": ("{tree} runs", "{tree} läuft"),
    "doing": ("under way: {action}", "gerade: {action}"),
    "waiting": ("waiting: no action is under way", "wartet: keine Aktion ist im Gange"),
    "holds": ("the goal holds; it waits whether it lasts", "das Ziel gilt; es wird geprüft, ob es so bleibt"),
    "nothing_left": ("the tree finds nothing to do that could help", "der Baum findet nichts, das helfen könnte"),
    "failed": ("{action}: failed {count} times", "{action}: {count}-mal misslungen"),
    "last_failure": ("the last failure: {reason}", "der letzte Fehlschlag: {reason}"),
    "outcome_success": ("{tree}: done", "{tree}: erledigt"),
    "outcome_failure": ("{tree}: not reached", "{tree}: nicht erreicht"),
    "outcome_timeout": ("{tree}: not reached in time", "{tree}: nicht rechtzeitig erreicht"),
    "outcome_stopped": ("{tree}: stopped", "{tree}: angehalten"),
    "outcome_lost": ("{tree}: lost sight of the cell", "{tree}: die Zelle ist nicht mehr zu sehen"),
    # lights
    "recorder": ("Recorder", "Rekorder"),
    "cell_itself": ("Cell", "Zelle"),
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
    "store": ("Store", "Ablage"),
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
