"""What an object rests upon, and whether it keeps its place until it is moved again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Columns, Samples
from learner.model import Scene
from learner.model.pose import Array, Vector, conjugate, express, multiply, rotate
from learner.model.poses import Mask, Poses, Rows

Support = tuple[str, Vector]
"""An object, and where in its frame [m] another one rests upon it."""


def support_of(samples: Samples, parameters: InferenceParameters) -> Support | None:
    """The nearest object that the object of some releases rests upon, and the median of where; None for none."""
    known = [frame for frame in samples.common_frames if frame != samples.base]
    under = [frame for frame in known if _is_upon(frame, samples, parameters)]
    if not under:
        return None
    nearest = min(under, key=lambda frame: _away_m(frame, samples))
    x, y, z = np.median(samples.rest(nearest).positions, axis=0).tolist()
    return nearest, (x, y, z)


def scene_of_first(samples: Samples) -> Scene | None:
    """The scene of the first sample's demonstration; None where it has none."""
    return samples.columns.demonstrations[int(samples.columns.demonstration[samples.rows[0]])].scene


def _away_m(frame: str, samples: Samples) -> float:
    columns = samples.columns
    away_m = columns.once(("away", frame), lambda: np.linalg.norm(columns.rest(frame).positions, axis=1))
    return float(np.median(away_m[samples.rows]))


def _is_upon(frame: str, samples: Samples, parameters: InferenceParameters) -> bool:
    """Whether the object rests upon the one whose frame this is."""
    x, y, z = np.median(_offsets_in_base(frame, samples), axis=0)
    near = np.hypot(x, y) < parameters.tight_m * parameters.upon_radii
    above = near and z > _top_m(frame, samples, parameters)
    return bool(above and (_sizes_known(frame, samples) or _is_raised(samples, parameters)))


def _offsets_in_base(frame: str, samples: Samples) -> Array:
    """The rests (m, 3) relative to a frame's origin [m], along the base's axes."""
    columns = samples.columns
    inside, outside = columns.rest(frame), columns.rest(columns.base)

    def offsets() -> Array:
        frames = multiply(outside.quaternions_xyzw, conjugate(inside.quaternions_xyzw))
        return rotate(frames, inside.positions)

    return columns.once(("offset", frame), offsets)[samples.rows]


def _top_m(frame: str, samples: Samples, parameters: InferenceParameters) -> float:
    """How far above a frame's origin an object's origin must be to rest upon it: most of both half heights."""
    scene, name = scene_of_first(samples), str(samples.object[0])
    if scene is None or not _sizes_known(frame, samples):
        return parameters.tight_m
    return parameters.upon_heights * (min(scene.objects[frame].size_m) + min(scene.objects[name].size_m))


def _sizes_known(frame: str, samples: Samples) -> bool:
    scene = scene_of_first(samples)
    return scene is not None and {frame, str(samples.object[0])} <= set(scene.objects)


def _is_raised(samples: Samples, parameters: InferenceParameters) -> bool:
    """Whether the object rests higher than where it begins: a box's floor does not raise it, a cube does."""
    begins_m = np.nanmin(samples.begins(str(samples.object[0])).positions[:, 2])
    rests_m = samples.rest(samples.base).positions[samples.rest_known, 2]
    return bool(np.median(rests_m) - begins_m > parameters.tight_m)


def stayed(frame: str, samples: Samples, lost_m: float) -> Mask:
    """Which objects (m,) stayed within `lost_m` of where they rested in the frame, as far as that was seen.

    The samples are releases of one object.
    """
    columns, name = samples.columns, str(samples.object[0])
    return columns.once(("stayed", frame, name, lost_m), lambda: _stayed(frame, name, columns, lost_m))[samples.rows]


def _stayed(frame: str, name: str, columns: Columns, lost_m: float) -> Mask:
    """The same of every release of an object; True in the other rows (n,)."""
    rests, kept = columns.rest(frame).positions, np.ones(len(columns.step), dtype=np.bool_)
    everything = Samples(columns, np.arange(len(columns.step)), np.arange(len(columns.demonstrations)))
    for which, objects, origins in _worlds_after(frame, name, everything):
        at = objects.positions
        if frame != columns.base:
            at = express(at, origins.positions, origins.quaternions_xyzw)
        kept[which] &= ~(np.linalg.norm(at - rests[which], axis=1) > lost_m)
    return kept


def _worlds_after(frame: str, name: str, everything: Samples) -> Iterator[tuple[Rows, Poses, Poses]]:
    """Where an object and the frame were seen at each press after a release up to the next one on the object, and at
    the end if there is none: which rows (k,), and both poses (k,) in the base. An unknown pose is NaN.
    """
    columns, at_end = everything.columns, (everything.final(name), everything.final(frame))
    left, ahead = np.flatnonzero((columns.object == name) & (columns.type != "pick")), 1
    while len(left):
        later = left + ahead
        inside = later < len(columns.step)
        inside[inside] = columns.demonstration[later[inside]] == columns.demonstration[left[inside]]
        ended, going, presses = left[~inside], left[inside], later[inside]
        last = columns.demonstration[ended]
        yield ended, at_end[0][last], at_end[1][last]
        yield going, columns.origin(name)[presses], columns.origin(frame)[presses]
        left, ahead = going[columns.object[presses] != name], ahead + 1
