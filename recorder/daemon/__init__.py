"""The recorder of a cell: between the network, the open recording and the operator.

recorder puts the parts together and is what others use. Requests come to the desk, which has them checked (requests)
and fulfilled by the machine or by the buttons: machine decides what is recorded and when (take is the demonstration
being recorded, writing its way to the disk), buttons judges what is pressed. upkeep does what has to be done without
anybody asking. All of them speak by the voice; the board shows in the recording what is to be seen of it later. Calls
go that way alone.
"""

from recorder.daemon.machine import Options
from recorder.daemon.recorder import Recorder

__all__ = ["Options", "Recorder"]
