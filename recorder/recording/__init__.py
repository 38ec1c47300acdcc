"""The format of a recording (CONTRACT, section 2): its words, its writer and its reader.

MCAP file
├── metadata `treewright.demonstration`   written first (outcome unknown) and last; the last one wins
├── /poses     protobuf  foxglove.FrameTransforms
├── /gripper   json      treewright.GripperState
├── /action    json      treewright.DemonstratedAction
├── /recorder/…  protobuf  foxglove.SceneUpdate, foxglove.Log: what the recorder shows in Foxglove
└── /…         any other key of the cell, byte for byte; `zenoh_encoding` in the channel's metadata

demonstrated is the metadata record, schemas those of the topics. writer packs messages into chunks, verifies what it
wrote by the reader, and closes with a summary; reader gives a file's messages as they are, decoding what learning needs
of them, parts orders the files of a split demonstration, and reading makes one recording of them. Records, which all
of these use, knows MCAP's bytes and their checksums.
"""

from recorder.recording.decoding import ReadFile
from recorder.recording.demonstrated import CONTRACT, DEMONSTRATION, Demonstrated, parse_scene
from recorder.recording.parts import all_parts, sort_parts
from recorder.recording.reader import messages, read_header, sha256_of
from recorder.recording.reading import join_files, read_recording
from recorder.recording.writer import LIBRARY, UNFINISHED, Finished, RecordingWriter

__all__ = [
    "CONTRACT",
    "DEMONSTRATION",
    "LIBRARY",
    "UNFINISHED",
    "Demonstrated",
    "Finished",
    "ReadFile",
    "RecordingWriter",
    "all_parts",
    "join_files",
    "messages",
    "parse_scene",
    "read_header",
    "read_recording",
    "sha256_of",
    "sort_parts",
]
