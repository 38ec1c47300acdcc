"""Other people's bags: a rosbag2 (folder, MCAP or SQLite) becomes one recording of ours (CONTRACT, section 4).

importing writes the recording; bag reads (the one home of `rosbags`); transforms composes chains of tf2; grippers tells
open from closed. Calls go that way alone.
"""
