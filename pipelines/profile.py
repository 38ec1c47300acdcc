"""The profile of a cell: what stands in it and in which frames, once, so that nobody types it at each start.

A YAML file, `cells/<cell>.yaml` below the data root unless `--profile` names another:

    base_frame: base              # these two are the defaults
    end_effector_frame: tool0
    objects:                      # as in a scene (CONTRACT, section 2)
      A: {size_m: [0.05, 0.05, 0.05], symmetry: cube, kind: cube}
      box: {size_m: [0.3, 0.3, 0.08], symmetry: box, open: true}
    workspace_m: [[0.36, 0.60], [-0.36, 0.36]]
    accuracy_m: 0.003
    accuracy_rad: 0.017

Only `objects` must be there.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pipelines.errors import CommandError
from pipelines.home import Home

if TYPE_CHECKING:
    from learner.model import Scene

FRAMES: Final = {"base_frame": "base", "end_effector_frame": "tool0"}
"""The frames that a profile has where it names none."""
SCENE: Final = ("objects", "workspace_m", "accuracy_m", "accuracy_rad")
SHAPE: Final = ("size_m", "symmetry", "kind", "open", "fixed")
LENGTHS: Final = 3


class ProfileError(CommandError):
    """A file that is no profile of a cell."""

    def __init__(self, file: Path, what: str) -> None:
        super().__init__(f"the profile {file} is refused: {what}")


@dataclass(frozen=True)
class Profile:
    """What stands in a cell: its frames, and its `scene` as JSON (CONTRACT, section 2)."""

    base_frame: str
    end_effector_frame: str
    scene: Mapping[str, Any]

    @property
    def objects(self) -> tuple[str, ...]:
        """The names of its objects, in the order of the file."""
        return tuple(self.scene["objects"])

    def start(self) -> dict[str, Any]:
        """What a request to start a demonstration says of the cell (CONTRACT, section 1)."""
        return {
            "objects": list(self.objects),
            "base_frame": self.base_frame,
            "end_effector_frame": self.end_effector_frame,
            "scene": dict(self.scene),
        }


def profile_of(cell: str, home: Home, file: Path | None = None) -> Profile | None:
    """The profile of a cell: that in `file`, else that below the data root; None where nobody wrote one.

    Raises ProfileError for a file that is none.
    """
    where = file or home.cells / f"{cell}.yaml"
    return None if file is None and not where.exists() else read_profile(where)


def read_profile(file: Path) -> Profile:
    """Raises ProfileError with what is wrong with the file."""
    import yaml

    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ProfileError(file, error.strerror or "it cannot be read") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ProfileError(file, f"it is no YAML: {' '.join(str(error).split())}") from error
    try:
        return _parsed(data)
    except (TypeError, ValueError) as error:
        raise ProfileError(file, str(error)) from error


def _parsed(data: Any) -> Profile:
    """Raises ValueError or TypeError with what is wrong."""
    from learner.errors import LearnerError
    from learner.model import Scene, check_name

    _check_keys("a profile", data, (*FRAMES, *SCENE))
    frames = {name: data.get(name, default) for name, default in FRAMES.items()}
    if not isinstance(data.get("objects"), dict) or not data["objects"]:
        raise ValueError("it names no objects")
    for name, shape in data["objects"].items():
        _check_shape(name, shape)
    try:
        for kind, names in (("frame", frames.values()), ("object", data["objects"])):
            for name in names:
                check_name(kind, name)
    except LearnerError as error:  # elsewhere a refused name is an error of its own; here it is the file's
        raise ValueError(str(error)) from error
    if len({*data["objects"], *frames.values()}) < len(data["objects"]) + len(frames):
        raise ValueError("objects, base frame and end-effector frame need names of their own")
    scene = {name: data[name] for name in SCENE if data.get(name) is not None}
    Scene.of_data(scene)
    return Profile(**frames, scene=scene)


def _check_keys(what: str, data: Any, known: tuple[str, ...]) -> None:
    if not isinstance(data, dict):
        raise TypeError(f"{what} is a mapping, not {str(data)[:80]!r}")
    strange = [str(name) for name in data if name not in known]
    if strange:
        raise ValueError(f"{what} has no {', '.join(strange)[:80]!r}; it may have {', '.join(known)}")


def _check_shape(name: Any, shape: Any) -> None:
    if not isinstance(name, str):
        raise TypeError(f"the name {name!r} is no text to YAML; write it in quotes")
    _check_keys(f"the object {name}", shape, SHAPE)
    size = shape.get("size_m")
    if not isinstance(size, list) or len(size) != LENGTHS:
        raise ValueError(f"size_m of {name} is a list of three lengths in metres, not {size!r}")


def frames_and_scene(arguments: argparse.Namespace, home: Home) -> tuple[str, str, Scene | None]:
    """The base frame, the end-effector frame and the shapes of a cell, as a command was told of them.

    That is as its options say, else as the cell's profile does. Raises ProfileError, NameRefusedError, and CommandError
    for a scene that is none.
    """
    from learner.model import Scene, check_name

    profile = profile_of(check_name("cell", arguments.cell), home, arguments.profile)
    told = FRAMES if profile is None else profile.start()
    base, hand = (check_name("frame", getattr(arguments, name) or told[name]) for name in FRAMES)
    scene = scene_told(arguments.scene) if arguments.scene else None if profile is None else profile.scene
    try:
        return base, hand, None if scene is None else Scene.of_data(scene)
    except ValueError as error:
        raise CommandError(f"--scene: {error}") from error


def scene_told(text: str) -> Any:
    """The JSON of an option, or of the file that it names by @FILE. Raises CommandError for what is none."""
    source = Path(text[1:]).read_text() if text.startswith("@") else text
    try:
        return json.loads(source)
    except ValueError as error:
        raise CommandError(f"the scene is not JSON: {error}") from error


def written(profile: Profile) -> str:
    """The text of a profile, such that reading it gives it again."""
    import yaml

    frames = {name: getattr(profile, name) for name in FRAMES}
    text: str = yaml.safe_dump({**frames, **profile.scene}, sort_keys=False, default_flow_style=None)
    return text
