"""`treewright demos`: what was demonstrated, what was refused, and leaving a demonstration out.

    list [--task T]   every demonstration, and the recordings in quarantine with their reasons
    show ID           one demonstration, action by action; one in quarantine too, with what contradicts
    undo ID STEP …    take actions back; one in quarantine is judged again
    exclude ID        leave it out of learning
    restore ID        take it back

With --json:

    list      {"demonstrations": [...], "quarantined": [{"file", "sha256", "reason"}]}; each demonstration
              {"demonstration_id", "task", "user", "cell", "outcome", "actions": n, "objects", "start_ns", "sha256",
              "excluded", "relabelled": [step], "taken_back": [step], "warnings", "gaps"}
    show      the same with "actions" as a list [{"step", "stamp_ns", "type", "demonstrated_type", "object",
              "end_effector", "frames", "rest", "rest_seen", "warnings"}], poses in the base frame as
              {"position": [x, y, z], "quaternion_xyzw": [x, y, z, w]}, and "base_frame", "end_effector_frame"
              of one in quarantine {"demonstration_id", "task", "user", "cell", "outcome", "objects", "quarantined":
              reason, "files", "taken_back", "actions": [{"step", "stamp_ns", "type", "demonstrated_type", "object",
              "verdict", "reason"}]}
    undo      {"demonstration_id", "taken_back": [step], "changed", "quarantined": the reason that is left, else null}
    exclude, restore   {"demonstration_id", "excluded", "changed"}
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from pipelines.console import Console
from pipelines.home import Home
from pipelines.options import INDEX

if TYPE_CHECKING:
    from learner.model import DemonstratedAction, Demonstration, Pose
    from learner.observation.corrections import Meant
    from learner.observation.presses import Judgement
    from pipelines.steps.quarantine import QuarantinedDemonstration
    from storage.lake import Entry, Lake


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright demos`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, help_ in (
        ("list", "every demonstration, and what is in quarantine"),
        ("show", "one demonstration, action by action"),
        ("undo", "take back actions of a demonstration"),
        ("exclude", "leave a demonstration out of learning"),
        ("restore", "take an excluded demonstration back"),
    ):
        action = actions.add_parser(name, help=help_, description=f"{help_[0].upper()}{help_[1:]}.")
        # Also after the action, where people write it; not given there, the option before the action stands.
        action.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
        if name == "list":
            action.add_argument("--task", metavar="T", help="only this task's")
        else:
            action.add_argument("id", metavar="ID", help="id of the demonstration")
        if name == "undo":
            numbers = "numbers of actions, as `treewright demos show` tells; of a pick and its release both"
            action.add_argument("steps", metavar="STEP", type=INDEX, nargs="+", help=numbers)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    from pipelines.steps.stores import open_lake

    ACTIONS[arguments.action](open_lake(Home.current()), arguments, console)
    return 0


def _list(lake: Lake, arguments: argparse.Namespace, console: Console) -> None:
    from learner.model import check_name
    from pipelines.steps.quarantine import id_of_quarantined

    task = None if arguments.task is None else check_name("task", arguments.task)
    entries, home = lake.entries(task), Home.current()
    refused = [(each, id_of_quarantined(home, each)) for each in lake.quarantined()]
    quarantined = [
        {"file": each.file, "demonstration_id": name, "sha256": each.sha256, "reason": each.reason}
        for each, name in refused
    ]
    console.emit({"demonstrations": [_summary(entry) for entry in entries], "quarantined": quarantined})
    for entry in entries:
        console.say(_line(entry))
    if not entries:
        console.say("no demonstration is in the lake; `treewright ingest` takes recordings in")
    for each, name in refused:
        console.say(f"quarantined {name or 'a file without an id'} ({each.file}): {each.reason}")


def _show(lake: Lake, arguments: argparse.Namespace, console: Console) -> None:
    found = _quarantined(lake, arguments.id)
    if found is not None:
        _show_quarantined(found, console)
        return
    entry = lake.entry(arguments.id)
    demonstration = entry.demonstration
    actions = [_action(action, entry, demonstration.base_frame) for action in demonstration.actions]
    frames = {"base_frame": demonstration.base_frame, "end_effector_frame": demonstration.end_effector_frame}
    console.emit(_summary(entry) | frames | {"actions": actions})
    console.say(_line(entry))
    for action in demonstration.actions:
        console.say(_action_line(action, entry))
    for warning in (*demonstration.warnings, *demonstration.gaps):
        console.say(f"  warning: {warning}")


def _quarantined(lake: Lake, demonstration_id: str) -> QuarantinedDemonstration | None:
    """The demonstration of this id, if it is in quarantine and none in the lake has the id."""
    from pipelines.steps.quarantine import find_quarantined

    if demonstration_id in lake.known().values():
        return None
    return find_quarantined(Home.current(), lake, demonstration_id)


def _show_quarantined(found: QuarantinedDemonstration, console: Console) -> None:
    from pipelines.steps.quarantine import pressed_type

    recording, judgements = found.recording, found.judgements
    names = ("demonstration_id", "task", "user", "cell", "outcome")
    console.emit(
        {name: getattr(recording, name) for name in names}
        | {"objects": list(recording.objects), "quarantined": found.reason, "files": list(map(str, found.files))}
        | {"taken_back": found.taken_back}
        | {"actions": [_judged(judgement, pressed_type(found, judgement.step)) for judgement in judgements]}
    )
    console.say(f"{recording.demonstration_id}  {recording.task} by {recording.user}: quarantined, {found.reason}")
    for judgement in judgements:
        why = f" ({judgement.reason})" if judgement.reason else ""
        name = judgement.object or judgement.press.signal or "?"
        console.say(f"  {judgement.step}  {judgement.press.type} {name}: {judgement.verdict}{why}")
    for step in found.taken_back:
        console.say(f"  {step}  {pressed_type(found, step)}: taken back")


def _judged(judgement: Judgement, demonstrated_type: str) -> dict[str, Any]:
    return {
        "step": judgement.step,
        "stamp_ns": judgement.press.stamp_ns,
        "type": judgement.press.type,
        "demonstrated_type": demonstrated_type,
        "object": judgement.object,
        "verdict": judgement.verdict,
        "reason": judgement.reason,
    }


def _undo(lake: Lake, arguments: argparse.Namespace, console: Console) -> None:
    found = _quarantined(lake, arguments.id)
    changed, left = True, None
    if found is None:
        changed = lake.undo(arguments.id, arguments.steps)
    else:
        left = judge_again(lake, found, arguments.steps, "undo", console)
    steps = list(dict.fromkeys(arguments.steps))
    said = "taken back" if changed else "taken back already"
    console.say(f"of {arguments.id} {said}: {', '.join(f'step {step}' for step in steps)}")
    console.emit({"demonstration_id": arguments.id, "taken_back": steps, "changed": changed, "quarantined": left})


def judge_again(
    lake: Lake, found: QuarantinedDemonstration, steps: Sequence[int], meant: Meant, console: Console
) -> str | None:
    """Correct a demonstration in quarantine; returns why it is still there, None if it is ingested now."""
    from pipelines.steps.quarantine import correct_quarantined

    result = correct_quarantined(Home.current(), lake, found, steps, meant)
    name = found.recording.demonstration_id
    if not result.quarantined:
        console.say(f"{name} is ingested now; learn from it with: treewright learn {found.recording.task}")
        return None
    console.say(f"{name} stays in quarantine: {result.quarantined[0].reason}")
    return result.quarantined[0].reason


def _exclude(lake: Lake, arguments: argparse.Namespace, console: Console) -> None:
    changed = lake.exclude(arguments.id)
    console.say(f"{arguments.id} {'is now' if changed else 'was already'} left out of learning")
    console.emit({"demonstration_id": arguments.id, "excluded": True, "changed": changed})


def _restore(lake: Lake, arguments: argparse.Namespace, console: Console) -> None:
    changed = lake.restore(arguments.id)
    console.say(f"{arguments.id} {'is learned from again' if changed else 'was not excluded'}")
    console.emit({"demonstration_id": arguments.id, "excluded": False, "changed": changed})


ACTIONS: Final[dict[str, Callable[[Lake, argparse.Namespace, Console], None]]] = {
    "list": _list,
    "show": _show,
    "undo": _undo,
    "exclude": _exclude,
    "restore": _restore,
}


def _summary(entry: Entry) -> dict[str, Any]:
    demonstration = entry.demonstration
    names = ("demonstration_id", "task", "user", "cell", "outcome", "start_ns", "sha256")
    return {name: getattr(demonstration, name) for name in names} | {
        "actions": len(demonstration.actions),
        "objects": list(demonstration.objects),
        "excluded": entry.excluded,
        "relabelled": sorted(entry.demonstrated_types),
        "taken_back": list(entry.taken_back),
        "warnings": list(demonstration.warnings),
        "gaps": list(demonstration.gaps),
    }


def _line(entry: Entry) -> str:
    demonstration: Demonstration = entry.demonstration
    marks = [demonstration.outcome, f"{len(demonstration.actions)} actions"]
    marks += ["excluded"] if entry.excluded else []
    marks += [f"relabelled at step {step}" for step in sorted(entry.demonstrated_types)]
    marks += [f"step {step} taken back" for step in entry.taken_back]
    marks += ["messages were lost near an action"] if demonstration.gaps else []
    return f"{demonstration.demonstration_id}  {demonstration.task} by {demonstration.user}: {', '.join(marks)}"


def _action_line(action: DemonstratedAction, entry: Entry) -> str:
    place = ", ".join(f"{number:.3f}" for number in action.end_effector.position)
    demonstrated = entry.demonstrated_types.get(action.step)
    notes = [f"demonstrated as a {demonstrated}"] if demonstrated else []
    notes += list(action.warnings)
    return f"  {action.step}  {action.type} {action.object} at ({place})" + "".join(f"; {note}" for note in notes)


def _action(action: DemonstratedAction, entry: Entry, base_frame: str) -> dict[str, Any]:
    rest = None if action.rest is None else action.rest.get(base_frame)
    return {
        "step": action.step,
        "stamp_ns": action.stamp_ns,
        "type": action.type,
        "demonstrated_type": entry.demonstrated_types.get(action.step, action.type),
        "object": action.object,
        "end_effector": _pose(action.end_effector),
        "frames": list(action.frames),
        "rest": None if rest is None else _pose(rest),
        "rest_seen": action.rest_seen,
        "warnings": list(action.warnings),
    }


def _pose(pose: Pose) -> dict[str, list[float]]:
    return {"position": list(pose.position), "quaternion_xyzw": list(pose.quaternion_xyzw)}
