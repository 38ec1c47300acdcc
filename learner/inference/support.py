"""What an object rests upon."""

from __future__ import annotations

import numpy as np

from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Samples
from learner.model import Scene
from learner.model.pose import Array, Vector, conjugate, multiply, rotate

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
    return samples.demonstrations[int(samples.demonstration[0])].scene


def _away_m(frame: str, samples: Samples) -> float:
    return float(np.median(np.linalg.norm(samples.rest(frame).positions, axis=1)))


def _is_upon(frame: str, samples: Samples, parameters: InferenceParameters) -> bool:
    """Whether the object rests upon the one whose frame this is."""
    x, y, z = np.median(_offsets_in_base(frame, samples), axis=0)
    near = np.hypot(x, y) < parameters.tight_m * parameters.upon_radii
    above = near and z > _top_m(frame, samples, parameters)
    return bool(above and (_sizes_known(frame, samples) or _is_raised(samples, parameters)))


def _offsets_in_base(frame: str, samples: Samples) -> Array:
    """The rests (m, 3) relative to a frame's origin [m], along the base's axes."""
    inside, outside = samples.rest(frame), samples.rest(samples.base)
    frames = multiply(outside.quaternions_xyzw, conjugate(inside.quaternions_xyzw))
    return rotate(frames, inside.positions)


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
