"""Everything that the recorder raises.

RecorderError
├── RecordingError                  a file; will not pass
│   ├── NotARecordingError          damaged, no MCAP, no metadata record, unknown contract version
│   ├── TornRecordingError          ends before its end: `treewright recover` completes it
│   └── PartMissingError            a split demonstration of which a part is not there; may pass
├── PayloadError                    a message that is not what its topic carries; will not pass
├── RequestRefusedError             a request on recorder/**; its sentence is the error reply
├── SecondRecorderError             another recorder serves this cell
├── DiskError                       no room, or no right to write; may pass
├── LinkError                       the service does not take a recording now; may pass
├── UploadRefusedError              the service does not take a recording; will not pass
└── ImportRefusedError              a folder of YAML demonstrations, or a bag, that cannot become recordings
"""

from __future__ import annotations

from pathlib import Path

from recorder.paths import shown


class RecorderError(Exception):
    """The root: a message of one sentence that names the thing and says what to do."""


class PayloadError(RecorderError):
    """A message that is not what its topic carries: the sentence begins with its verb, as in "is not JSON"."""


class RecordingError(RecorderError):
    """A file that is not, or not yet, a recording."""


class NotARecordingError(RecordingError):
    """A file that does not hold the part that CONTRACT, section 2, requires."""

    def __init__(self, file: Path, reason: str) -> None:
        super().__init__(f"{shown(file)} is not a recording: {reason}")
        self.file, self.reason = file, reason


class TornRecordingError(RecordingError):
    """A file whose end is missing; every finished chunk of it can be saved."""

    def __init__(self, file: Path) -> None:
        super().__init__(f"{shown(file)} is torn: its end is missing; `treewright recover` saves what is whole")
        self.file = file


class PartMissingError(RecordingError):
    """A split demonstration whose parts are not all there."""

    def __init__(self, demonstration_id: str, there: list[int], missing: int) -> None:
        parts = ", ".join(map(str, there))
        super().__init__(f"the demonstration {demonstration_id} lacks its part {missing}; there are: {parts}")
        self.demonstration_id, self.missing = demonstration_id, missing


class RequestRefusedError(RecorderError):
    """A request that the recorder cannot fulfil; the sentence says why."""


class SecondRecorderError(RecorderError):
    """Two recorders for one cell would each record half of the truth."""

    def __init__(self, cell: str) -> None:
        super().__init__(f"the cell {cell} already has a recorder; stop that one first or record another cell")
        self.cell = cell


class DiskError(RecorderError):
    """The data root is full or cannot be written."""


class LinkError(RecorderError):
    """The service cannot be reached, or cannot take a recording now."""


class UploadRefusedError(RecorderError):
    """The service refuses a recording, such as for a wrong token; the sentence says why."""


class ImportRefusedError(RecorderError):
    """A folder or file of YAML demonstrations, or a bag, that is broken or lacks what is needed."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{shown(path)} cannot be imported: {reason}")
        self.path, self.reason = path, reason
