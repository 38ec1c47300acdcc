"""Every number of the method, gathered: each folder tells its own, and the manifest names all as they were used."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from learner.inference.parameters import InferenceParameters
from learner.paper.parameters import PaperParameters
from learner.planning.parameters import PlanningParameters
from learner.proof.parameters import ProofParameters
from learner.regularities.parameters import RegularityParameters
from learner.rehearsal.parameters import RehearsalParameters


@dataclass(frozen=True)
class Parameters:
    """The numbers of our method by folder; `paper` holds those of the plain method."""

    paper: PaperParameters = field(default_factory=PaperParameters)
    inference: InferenceParameters = field(default_factory=InferenceParameters)
    planning: PlanningParameters = field(default_factory=PlanningParameters)
    regularities: RegularityParameters = field(default_factory=RegularityParameters)
    proof: ProofParameters = field(default_factory=ProofParameters)
    rehearsal: RehearsalParameters = field(default_factory=RehearsalParameters)

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        return asdict(self)
